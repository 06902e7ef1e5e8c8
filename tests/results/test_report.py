"""What a fit leaves on disk: all files, plain JSON, a picture that shows the contours."""

import csv
import io
import json
from math import nan

import numpy as np
import pytest
from PIL import Image

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fitting import FitState
from napari_deltamic.fitting.history import History
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.images.stacks import read_image
from napari_deltamic.results.colouring import COLOURS
from napari_deltamic.results.picture import picture, picture_png
from napari_deltamic.results.report import FILES, write_results
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects, Halo

GRID = nd.Grid((12, 18, 20), (0.4, 0.2, 0.2), (1.0, 2.0, 3.0))
OPTICS = nd.GaussianPSF((0.48, 0.24, 0.24))
RUN = RunSettings(
    image="/data/cell.tif",
    seeds="/data/start.ply",
    scene=SceneSettings(voxel_size=GRID.voxel_size, origin=GRID.origin, sigma=OPTICS.sigma_um),
    fit=FitSettings(),
)


@pytest.fixture(scope="module")
def mesh():
    return Mesh.merge(
        [sphere((3, 3, 4), 0.6, subdivisions=2), sphere((3.4, 4.2, 5.4), 0.6, subdivisions=2)]
    )


@pytest.fixture(scope="module")
def rendered(mesh):
    return nd.render(mesh, GRID, OPTICS).numpy()


def a_state(mesh, rendered, **changes):
    facts = dict(
        iteration=3,
        level=2,
        levels=5,
        mesh=mesh,
        optics=OPTICS,
        density=np.ones(len(mesh.faces)),
        loss=0.25,
        amplitude=np.float64(2.0),
        background=100.0,
        blur=3.2,
        converged=True,
        message="converged",
        _image=rendered,
    )
    return FitState(**{**facts, **changes})


def a_history(mesh, rendered):
    history = History()
    for i, (level, loss) in enumerate([(1, 0.9), (1, 0.5), (2, 0.25)], 1):
        history.add(a_state(mesh, rendered, iteration=i, level=level, loss=loss))
    return history


def test_all_files(tmp_path, mesh, rendered):
    folder = tmp_path / "new" / "results"
    state, history = a_state(mesh, rendered), a_history(mesh, rendered)
    paths = write_results(folder, state, rendered, GRID, RUN, history, 1.5, warnings=["mind this"])
    assert [path.name for path in paths] == list(FILES)
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    for name in ("mesh.ply", "mesh.rec"):
        again = nd.load_mesh(folder / name)
        assert np.array_equal(again.vertices, mesh.vertices)
        assert np.array_equal(again.regions, mesh.regions)
    image, voxel_size = read_image(folder / "rendered.tif")
    assert np.array_equal(image, rendered)
    assert voxel_size == pytest.approx(GRID.voxel_size, rel=1e-6)
    with (folder / "measurements.csv").open() as stream:
        assert [row["region"] for row in csv.DictReader(stream)] == ["1", "2"]
    assert RunSettings.from_toml(folder / "run.toml") == RUN


def test_the_numbers_that_decide_are_kept_with_a_result(tmp_path, mesh, rendered):
    state, history = a_state(mesh, rendered), a_history(mesh, rendered)
    write_results(tmp_path, state, rendered, GRID, RUN, history, 1.5)
    rules = json.loads((tmp_path / "report.json").read_text())["rules"]
    assert rules["topology"]["certain"] == 3.0
    assert rules["schedule"]["window"] == 5
    assert rules["cells"]["enclosed"] == 0.6


def test_report_tells_what_became_of_the_effects(tmp_path, mesh, rendered):
    scene = RUN.scene.model_copy(update={"effects": Effects.of("halo", "pixel_integration")})
    run = RUN.model_copy(update={"scene": scene})
    found = Effects.of(Halo(fraction=0.1, width=2.0), "pixel_integration", "attenuation")
    state, history = a_state(mesh, rendered, effects=found), a_history(mesh, rendered)
    write_results(tmp_path, state, rendered, GRID, run, history, 1.5)
    pixels, late, halo = json.loads((tmp_path / "report.json").read_text())["effects"]
    assert pixels == {
        "name": "pixel_integration",
        "where": "fourier",
        "fitted": False,
        "numbers": [],
    }
    assert halo["fitted"]
    assert halo["numbers"] == [
        {"name": "fraction", "unit": "1", "start": 0.02, "value": 0.1},
        {"name": "width", "unit": "um", "start": 1.0, "value": 2.0},
    ]
    assert late["numbers"][0]["start"] == 0.0  # it came on the way


def test_report(tmp_path, mesh, rendered):
    state = a_state(mesh, rendered, background=nan)
    history = a_history(mesh, rendered)
    write_results(tmp_path, state, rendered, GRID, RUN, history, 1.5, warnings=["mind this"])

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    report = json.loads((tmp_path / "report.json").read_text(), parse_constant=refuse)
    assert report["version"] == nd.__version__
    assert report["engine"].startswith("cpu, ")
    assert report["accuracy"] == 1e-3
    assert report["iterations"] == 3
    assert report["seconds"] == 1.5
    assert report["loss"] == [0.9, 0.5, 0.25]
    assert report["optics"] == {
        "model": "GaussianPSF",
        "sigma_um": pytest.approx([0.48, 0.24, 0.24]),
        "parameters": {
            f"sigma_{axis}": {"value": pytest.approx(value), "unit": "um", "fitted": True}
            for axis, value in zip("zyx", (0.48, 0.24, 0.24), strict=True)
        },
        "fitted": True,
    }
    assert report["effects"] == []
    assert report["converged"] is True
    assert report["message"] == "converged"
    assert report["amplitude"] == 2.0
    assert report["background"] is None
    assert report["warnings"] == ["mind this"]
    assert report["first_iteration"] == 1
    assert report["levels"] == [
        {"level": 1, "blur": 3.2, "iterations": 2, "loss": 0.5},
        {"level": 2, "blur": 3.2, "iterations": 1, "loss": 0.25},
    ]
    assert RunSettings(**report["settings"]) == RUN


def test_a_folder_that_is_a_file(tmp_path, mesh, rendered):
    (tmp_path / "a").write_text("")
    state, history = a_state(mesh, rendered), a_history(mesh, rendered)
    with pytest.raises(InputError, match="cannot be written"):
        write_results(tmp_path / "a", state, rendered, GRID, RUN, history, 1.0)


def colours_near(array, colour):
    return (np.abs(array.astype(int) - colour).sum(axis=-1) < 30).sum()


def drawn(*scene):
    """(H, W, 3) of a picture."""
    return np.asarray(Image.open(io.BytesIO(picture_png(*scene))).convert("RGB"))


def test_picture(mesh, rendered):
    measured = rendered.copy()
    measured[:, :2] = nan
    pixels = drawn(measured, rendered, mesh, GRID)
    assert 900 <= pixels.shape[1] <= 2600
    upper, lower = np.array_split(pixels, 2)
    for colour in COLOURS[:2]:
        assert colours_near(upper, colour) > 100
        assert colours_near(lower, colour) == 0
    violet = (50, 0, 60)
    assert colours_near(upper, violet) > 1000
    assert colours_near(lower, violet) == 0


def test_contours_lie_where_the_membrane_is():
    """Seen at the finest: bright voxels under the line, in both directions."""
    grid = nd.Grid((21, 21, 21), (0.4, 0.2, 0.2))
    image = np.zeros(grid.shape, np.float32)
    image[:, 5, 5:16] = image[:, 15, 5:16] = image[:, 5:16, 5] = image[:, 5:16, 15] = 1000
    from benchmarks.shapes import box

    mesh = box((4, 2, 2), (6, 2, 2), edge_length=0.5)
    pixels = drawn(image, image, mesh, grid).astype(int)
    line = np.argwhere(np.abs(pixels - COLOURS[0]).sum(axis=-1) < 30)
    half = pixels.shape[0] // 2
    first = line[(line[:, 1] < pixels.shape[1] // 4) & (line[:, 0] < half)]
    assert len(first) > 100
    for y, x in first[::7]:
        near = pixels[y - 6 : y + 7, x - 6 : x + 7].reshape(-1, 3)
        assert (near.min(axis=1) > 240).any()


@pytest.mark.parametrize("shape", [(2, 2, 300), (40, 4, 4), (1, 8, 8), (3, 400, 5)])
def test_pictures_of_odd_shapes(shape):
    grid = nd.Grid(shape, (1.0, 0.1, 0.1))
    image = np.zeros(shape, np.float32)
    mesh = sphere(np.mean(grid.extent, axis=0), 0.3, subdivisions=1)
    height, width, _ = drawn(image, image, mesh, grid).shape
    assert 900 <= width <= 3000
    assert height <= 2200


def test_images_that_do_not_fit(mesh, rendered):
    with pytest.raises(InputError, match="shape"):
        picture(rendered[1:], rendered, mesh, GRID)
