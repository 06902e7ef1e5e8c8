"""``measure``: of meshes, sessions and folders of fits; what it refuses."""

import csv
import json

import numpy as np
import pytest
import tifffile
from benchmarks.double_bubble import DoubleBubble

import napari_deltamic as nd
from napari_deltamic.fitting.history import History
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.results.measured_files import MEASURED
from napari_deltamic.results.session_file import save_session
from napari_deltamic.results.session_parts import SavedImage, SavedResult, Session
from napari_deltamic.results.track_report import write_frame, write_tracks
from napari_deltamic.runs.settings import RunSettings, SceneSettings
from napari_deltamic.runs.track_run import TrackRun
from napari_deltamic.tracking import FrameResult

SIZE = (0.3, 0.2, 0.2)
GRID = nd.Grid((20, 24, 24), SIZE)
OPTICS = nd.GaussianPSF((0.36, 0.24, 0.24))


def rows(path):
    with path.open() as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def bubble(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "bubble.rec"
    nd.save_mesh(DoubleBubble(2.0, (1.0, 0.9, 1.2)).mesh(0.5).translated((5, 5, 5)), path)
    return path


@pytest.fixture
def fitted(data, run, seen, tmp_path):
    """The folder of a fit of one iteration, and its image."""
    image = tmp_path / "cell.tif"
    image.write_bytes((data / "cell.tif").read_bytes())
    folder = tmp_path / "fitted"
    code, _, err = run("fit", image, "--seeds", data / "start.ply", "--residual", "-o", folder)
    assert code == 0, err
    return folder, image


def test_voxels_that_are_not_finite_are_missing(data, run, seen, tmp_path):
    folder = tmp_path / "fitted"
    image = data / "inf.tif"
    given = ("--seeds", data / "start.ply", "--missing-nan", "-o", folder)
    assert run("fit", image, *given)[0] == 0
    further = ("--images", "tif", "--other-channel", image, "-o", tmp_path / "out")
    code, _, err = run("measure", folder, *further)
    assert code == 0, err
    left, _ = read_image(tmp_path / "out" / "residual.ome.tif")
    assert np.array_equal(np.isnan(left), ~np.isfinite(read_image(image)[0]))


def test_a_mesh_without_an_image(bubble, run, tmp_path):
    code, out, err = run("measure", bubble, "-o", tmp_path / "out")
    assert code == 0, err
    names = [name for name in MEASURED if name != "labels.ome.tif"]
    assert out == [str(tmp_path / "out" / name) for name in names]
    assert "no image" in err
    one, two = rows(tmp_path / "out" / "cells.csv")
    assert (one["neighbours"], two["neighbours"]) == ("2", "1")
    assert one["cut_by_border"] == ""
    assert len(rows(tmp_path / "out" / "walls.csv")) == 3
    assert len(rows(tmp_path / "out" / "junctions.csv")) == 1


def test_files_of_the_user_are_not_replaced(run, fails, tmp_path):
    """Meshes are often called as what is written: the mesh itself, and others beside it."""
    mesh = tmp_path / "cells.ply"
    nd.save_mesh(sphere((2, 2, 2), 1.0), mesh)
    before = mesh.read_bytes()
    assert "holds cells.ply; --overwrite" in fails("measure", mesh, "-o", tmp_path)
    told = fails("measure", mesh, "--overwrite", "-o", tmp_path)
    assert f"{mesh} would be replaced by the results: choose another folder" in told
    assert mesh.read_bytes() == before
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "labels.ome.tif").write_text("mine")
    assert "holds labels.ome.tif" in fails("measure", mesh, "-o", tmp_path / "out")
    assert run("measure", mesh, "--overwrite", "-o", tmp_path / "out")[0] == 0


def test_what_is_of_an_image_needs_one(data, run, fails, tmp_path):
    mesh = data / "start.ply"
    out = ("-o", tmp_path / "out")
    for option in (("--voxel-size", *SIZE), ("--channel", 1)):
        assert "need --image: leave them out" in fails("measure", mesh, *option, *out)
    small = tmp_path / "mm.ply"
    nd.save_mesh(sphere((2e-3, 2e-3, 2e-3), 1e-3), small)
    code, _, err = run("measure", small, *out)
    assert code == 0
    assert "the mesh is 0.002 um wide: check that its coordinates are in um" in err


def test_labels_at_a_voxel_size(bubble, run, tmp_path):
    options = ("--label-voxel", 0.5, 0.25, 0.25)
    code, out, _ = run("measure", bubble, *options, "-o", tmp_path / "out")
    assert code == 0
    labels, size = read_image(out[-2])
    assert size == pytest.approx((0.5, 0.25, 0.25))
    assert set(np.unique(labels)) == {0, 1, 2}


def test_labels_say_where_they_begin(data, run, tmp_path):
    """Where that is not the first voxel of the image: for a mesh that begins before it, say."""
    mesh = tmp_path / "ball.ply"
    nd.save_mesh(sphere((-3, 2.3, 2.3), 1.0), mesh)
    size = (0.5, 0.25, 0.25)
    code, out, err = run("measure", mesh, "--label-voxel", *size, "-o", tmp_path / "a")
    assert code == 0, err
    assert (
        "the first voxel of the labels lies at -5 0 0 um (Z Y X), from the origin of the mesh"
        in err
    )
    labels, _ = read_image(out[-2])
    with tifffile.TiffFile(out[-2]) as file:
        pixels = tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]["Pixels"]
    first = pixels["Plane"][0]
    origin = [float(first[f"Position{axis}"]) for axis in "ZYX"]
    middle = np.argwhere(labels).mean(0) * size + origin
    assert middle == pytest.approx((-3, 2.3, 2.3), abs=0.02)
    # Larger voxels of the block of an image begin deeper in it.
    nd.save_mesh(sphere((2.9, 2.3, 2.3), 1.0), mesh)
    given = ("--image", data / "cell.tif", "--label-voxel", 0.6, 0.4, 0.4)
    code, out, err = run("measure", mesh, *given, "-o", tmp_path / "b")
    assert "the first voxel of the labels lies at 0.15 0.1 0.1 um" in err


def test_an_image_says_what_its_border_cuts(run, tmp_path):
    both = Mesh.merge([sphere((2, 2, 2), 1.0), sphere((3, 2, 4.5), 1.0)])
    nd.save_mesh(both, tmp_path / "both.ply")
    write_image(tmp_path / "image.tif", np.ones(GRID.shape, np.float32), SIZE)
    arguments = ("measure", tmp_path / "both.ply", "--image", tmp_path / "image.tif")
    code, out, err = run(*arguments, "-o", tmp_path / "out")
    assert code == 0, err
    assert [row["cut_by_border"] for row in rows(tmp_path / "out" / "cells.csv")] == ["no", "yes"]
    labels, size = read_image(out[-2])
    assert labels.shape == GRID.shape
    assert size == pytest.approx(SIZE)


@pytest.mark.usefixtures("judged")
def test_the_folder_of_a_fit(fitted, run, tmp_path):
    folder, image = fitted
    fit_row = rows(folder / "measurements.csv")[0]
    code, out, err = run("measure", folder, "-o", tmp_path / "out")
    assert code == 0, err
    assert [path.rsplit("/")[-1] for path in out] == list(MEASURED)
    page = (tmp_path / "out" / "measurements.html").read_text()
    assert "data:image/png;base64," in page
    assert "explains" in page
    row = rows(tmp_path / "out" / "cells.csv")[0]
    assert list(row) == list(fit_row)
    same = ("volume_um3", "sphericity", "handles", "cut_by_border", "explained", "grade")
    for name in same:
        assert row[name] == fit_row[name] != "", name
    assert row["shape_error_um"] == fit_row["shape_error_um"]
    assert f"shapes: {row['grade']}" in page
    image.unlink()
    kept = (folder / "report.json").read_text()
    code, out, err = run("measure", folder, "-o", tmp_path / "again")
    assert code == 0
    assert "no longer exists" in err
    assert rows(tmp_path / "again" / "cells.csv") == [row]  # the folder still tells all that it did
    assert [path.rsplit("/")[-1] for path in out] == list(MEASURED)
    report, told = folder / "report.json", json.loads((folder / "report.json").read_text())
    told["residual"]["cells"], told["verdict"]["cells"][0]["region"] = 5, "first"
    report.write_text(json.dumps(told))
    assert run("measure", folder, "--overwrite", "-o", tmp_path / "again")[0] == 0
    (damaged,) = rows(tmp_path / "again" / "cells.csv")
    assert damaged == {
        **row,
        "explained": "",
        "grade": "",
        "shape_error_um": "",
        "note": damaged["note"],
    }
    report.write_text(json.dumps(told | {"verdict": json.loads(kept)["verdict"]}))
    (folder / "rendered.tif").unlink()
    _, _, err = run("measure", folder, "-o", tmp_path / "once more")
    assert "nothing is known of its border" in err
    (bare,) = rows(tmp_path / "once more" / "cells.csv")
    assert (bare["grade"], bare["cut_by_border"]) == (row["grade"], "")


def test_a_session(data, run, tmp_path):
    mesh = sphere((2.9, 2.3, 2.3), 1.1, edge_length=0.4)
    bright = 400 / float(nd.render(mesh, GRID, OPTICS).max())
    state = nd.FitState(
        iteration=3, level=1, levels=1, mesh=mesh, optics=OPTICS, density=np.ones(len(mesh.faces)),
        loss=0.5, amplitude=bright, background=100.0, blur=1.0,
    )  # fmt: skip
    settings = RunSettings(
        image="", seeds="", scene=SceneSettings(voxel_size=SIZE, sigma=OPTICS.sigma_um)
    )
    pixels, _ = read_image(data / "cell.tif")
    image = SavedImage("cell", pixels, SIZE, SIZE, (0.0,) * 3, ("um",) * 3)
    whole = Session(settings, image, result=SavedResult(settings, state, History()))
    save_session(tmp_path / "a.deltamic", whole)
    given = ("measure", tmp_path / "a.deltamic", "-o", tmp_path / "out")
    assert "holds its voxel size: leave out" in run(*given, "--voxel-size", *SIZE)[2]
    code, _, err = run(*given, "--errors")
    assert code == 0, err
    row = rows(tmp_path / "out" / "cells.csv")[0]
    found = float(row["volume_um3"]) + float(row["volume_bias_um3"])
    assert found == pytest.approx(state.mesh.volumes()[1], rel=1e-7)
    assert float(row["density"]) == pytest.approx(1)
    assert 0.5 < float(row["explained"]) < 1
    # The surface is not where a fit would end: that is part of the error.
    assert 0 < float(row["volume_se_um3"]) < 0.2 * float(row["volume_um3"])
    assert row["cut_by_border"] == "no"
    save_session(tmp_path / "b.deltamic", Session(settings, image))
    code, _, err = run("measure", tmp_path / "b.deltamic", "-o", tmp_path / "none")
    assert code == 2
    assert "no result to measure" in err


@pytest.mark.parametrize("kind", ["tif", "zarr"])
def test_the_images_of_a_fit(fitted, run, tmp_path, kind):
    """Rendered, residual and labels come back as they were, with their voxel size."""
    if kind == "zarr":
        pytest.importorskip("zarr")
    folder, _ = fitted
    out = tmp_path / "out"
    code, lines, err = run("measure", folder, "--images", kind, "-o", out)
    assert code == 0, err
    read = {}
    for name in ("rendered", "residual", "labels"):
        path = out / f"{name}.ome.{kind}"
        assert str(path) in lines
        read[name], size = read_image(path)
        assert size == pytest.approx(SIZE)
    np.testing.assert_array_equal(read["rendered"], read_image(folder / "rendered.tif")[0])
    np.testing.assert_array_equal(np.unique(read["labels"]), [0, 1])
    expected = read_image(folder / "residual.tif")[0]
    np.testing.assert_allclose(read["residual"], expected, rtol=1e-4, atol=1e-4)


BAD = {
    "missing": (("none.ply",), "there is no such file"),
    "no mesh": (("image.tif",), "unknown mesh extension"),
    "an empty folder": (("empty",), "holds no mesh.ply"),
    "far away": (("far.ply", "--image", "image.tif"), "outside of the image"),
    "image without sizes": (("ball.ply", "--image", "plain.npy"), "give --voxel-size"),
    "voxels": (("ball.ply", "--label-voxel", 0, 1, 1), "--label-voxel must be three positive"),
    "images of a mesh": (("ball.ply", "--images", "tif"), "give --image"),
    "images without a fit": (
        ("ball.ply", "--image", "image.tif", "--images", "zarr"),
        "needs a session, or the folder of a fit",
    ),
    "errors of a mesh": (("ball.ply", "--errors"), "need a session"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_measured(fails, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    nd.save_mesh(sphere((3, 2, 2), 1.0), "ball.ply")
    nd.save_mesh(sphere((300, 2, 2), 1.0), "far.ply")
    write_image("image.tif", np.ones(GRID.shape, np.float32), SIZE)
    np.save("plain.npy", np.ones(GRID.shape, np.float32))
    arguments, says = BAD[name]
    assert says in fails("measure", *arguments, "-o", "out")
    assert not (tmp_path / "out").exists()


def test_tables_are_not_replaced_unasked(bubble, run, fails, tmp_path):
    arguments = ("measure", bubble, "-o", tmp_path / "out")
    assert run(*arguments)[0] == 0
    assert "--overwrite" in fails(*arguments)
    assert run(*arguments, "--overwrite")[0] == 0


def test_another_channel(bubble, run, fails, tmp_path):
    mesh = nd.load_mesh(bubble)
    grid = nd.Grid((34, 34, 44), (0.3, 0.3, 0.3))
    light = 2000 * nd.render(mesh, grid, OPTICS).double().numpy() + 3
    noisy = np.random.default_rng(0).poisson(light).astype(np.float32)
    write_image(tmp_path / "channel.tif", noisy, grid.voxel_size)
    arguments = ("measure", bubble, "--other-channel", tmp_path / "channel.tif")
    assert "give --image" in fails(*arguments, "-o", tmp_path / "a")
    arguments = (*arguments, "--image", tmp_path / "channel.tif")
    assert "give --other-channel-sigma" in fails(*arguments, "-o", tmp_path / "b")
    arguments = (
        *arguments,
        "--other-channel-sigma",
        *OPTICS.sigma_um,
        "--other-channel-on",
        "walls",
    )
    code, out, err = run(*arguments, "-o", tmp_path / "out")
    assert code == 0, err
    assert "the channel is shifted by" in err
    assert str(tmp_path / "out" / "channel_walls.csv") in out
    found = {
        (row["region_a"], row["region_b"]): float(row["light_per_um2"])
        for row in rows(tmp_path / "out" / "channel_walls.csv")
    }
    # Two membranes where the cells touch.
    expected = {("1", "0"): 2000, ("2", "0"): 2000, ("2", "1"): 4000}
    assert found == pytest.approx(expected, rel=0.03)
    assert "gives a voxel size" not in err
    image = tmp_path / "image.tif"
    image.write_bytes((tmp_path / "channel.tif").read_bytes())
    write_image(tmp_path / "channel.tif", noisy, (0.6, 0.3, 0.3))
    given = [image if a == arguments[5] else a for a in arguments[4:]]
    code, _, err = run(*arguments[:4], *given, "-o", tmp_path / "other")
    assert code == 0, err
    assert "channel.tif gives a voxel size of 0.6 0.3 0.3 um (Z Y X)" in err
    assert "that of the image, 0.3 0.3 0.3 um, is used instead" in err


def test_an_open_surface_and_a_channel_of_another_shape(run, fails, tmp_path):
    """A number or a reason, in every row; nowhere NaN."""
    ball = sphere((2.9, 2.3, 2.3), 1.2)
    nd.save_mesh(Mesh(ball.vertices, ball.faces[5:]), tmp_path / "open.ply")
    arguments = ("measure", tmp_path / "open.ply", "-o", tmp_path / "out")
    code, _, err = run(*arguments)
    assert code == 0, err
    (row,) = rows(tmp_path / "out" / "cells.csv")
    assert row["volume_um3"] == row["handles"] == ""
    assert float(row["area_um2"]) > 0
    assert "open" in row["note"]
    for name in ("cells", "walls", "junctions"):
        assert "nan" not in (tmp_path / "out" / f"{name}.csv").read_text().lower()
    for name, shape in (("image", GRID.shape), ("other", (5, 6, 7))):
        write_image(tmp_path / f"{name}.tif", np.ones(shape, np.float32), SIZE)
    options = ("--image", tmp_path / "image.tif", "--other-channel", tmp_path / "other.tif")
    said = fails(
        *arguments[:2], *options, "--other-channel-sigma", 0.3, 0.2, 0.2, "-o", tmp_path / "b"
    )
    assert "other.tif" in said
    assert "shape" in said
    assert not (tmp_path / "b").exists()


def test_the_folder_of_tracks(run, fails, tmp_path):
    pytest.importorskip("geff")
    results = [
        FrameResult(k, 10.0 * k, sphere((2, 2, 2 + 0.2 * k), 1.0, subdivisions=2)) for k in range(3)
    ]
    folder = tmp_path / "tracks"
    folder.mkdir()
    for result in results:
        write_frame(folder, result)
    scene = SceneSettings(voxel_size=SIZE, sigma=OPTICS.sigma_um)
    write_tracks(folder, results, GRID, TrackRun(image="a.tif", seeds="b.ply", scene=scene), 1.0)
    code, out, err = run("measure", folder, "-o", tmp_path / "out")
    assert code == 0, err
    assert out == [str(tmp_path / "out" / name) for name in ("tracks.geff", "tracks.csv")]
    assert (tmp_path / "out" / "tracks.csv").read_text() == (folder / "tracks.csv").read_text()
    said = fails("measure", folder, "--images", "tif", "-o", tmp_path / "none")
    assert "leave out --images" in said
    assert "--overwrite" in fails("measure", folder, "-o", tmp_path / "out")
