"""Tracking from the command line: what it writes, how it goes on, and what it refuses."""

import csv
import json

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import write_image
from napari_deltamic.results import judged as judged_results
from napari_deltamic.results.track_report import FILES, read_results
from napari_deltamic.runs.track_run import TrackRun
from napari_deltamic.tracking import track

SIZE, SHAPE, CENTER = (0.3, 0.2, 0.2), (20, 24, 24), (2.9, 2.3, 2.3)

VOXELS = ("--voxel-size", *map(str, SIZE))
FAST = (
    "--sigma", "0.36", "0.24", "0.24", "--levels", "1.5", "1", "--accuracy", "2e-2",
    "--no-collisions",
)  # fmt: skip
STEP = np.array([0.0, 0.1, -0.1])  # um a frame


@pytest.fixture(scope="session")
def series(tmp_path_factory):
    """A folder with three frames of a cell that drifts, as one file and as three, and seeds."""
    folder = tmp_path_factory.mktemp("series")
    grid, optics = nd.Grid(SHAPE, SIZE), nd.GaussianPSF((0.36, 0.24, 0.24))
    rng, frames = np.random.default_rng(0), []
    (folder / "frames").mkdir()
    for t in range(3):
        cell = sphere(CENTER + t * STEP, (1.2, 1.1, 1.1), edge_length=0.3)
        image = nd.render(cell, grid, optics).numpy()
        frames.append(rng.poisson(100 + 400 * image / image.max()).astype(np.float32))
        write_image(folder / "frames" / f"t{t}.tif", frames[-1], SIZE)
    np.save(folder / "movie.npy", np.array(frames))
    nd.save_mesh(sphere(CENTER, 1.1, edge_length=0.5), folder / "start.ply")
    nd.save_mesh(sphere((50, 50, 50), 1.1, edge_length=0.5), folder / "far.ply")
    return folder


def arguments(series, *more):
    return ("track", series / "movie.npy", *VOXELS, "--seeds", series / "start.ply", *FAST, *more)


def test_everything_is_written(series, tmp_path, run, judged):
    folder = tmp_path / "out"
    code, out, err = run(*arguments(series, "--time-step", "30", "-o", folder))
    assert code == 0, err
    meshes = [f"mesh_t00{t}.ply" for t in range(3)]
    assert [line.rsplit("/", 1)[1] for line in out] == [*meshes, *FILES]
    for t, name in enumerate(meshes):
        mesh = nd.load_mesh(folder / name)
        np.testing.assert_allclose(mesh.vertices_numpy().mean(axis=0), CENTER + t * STEP, atol=0.08)
        assert (folder / name).with_suffix(".vtk").is_file()
    rows = list(csv.DictReader((folder / "tracks.csv").read_text().splitlines()))
    assert [(r["frame"], r["time_s"], r["cell"], r["parent"]) for r in rows] == [
        ("0", "0.0", "1", "0"), ("1", "30.0", "1", "0"), ("2", "60.0", "1", "0"),
    ]  # fmt: skip
    assert rows[0]["displacement_um"] == ""
    assert float(rows[1]["displacement_um"]) == pytest.approx(0.14, abs=0.05)
    assert {r["grade"] for r in rows} <= {"good", "fair"}
    assert all(0 < float(r["shape_error_um"]) < 0.2 for r in rows)
    assert "shapes: " in err
    report = json.loads((folder / "report.json").read_text())
    assert all(f["judgement"].startswith(f["grade"]) for f in report["frames"])
    assert [r.judged[1].grade for r in read_results(folder)] == [r["grade"] for r in rows]
    assert [f["used"] for f in report["frames"]] == [True] * 3
    assert report["lineage"] == [{"cell": 1, "parent": 0, "first": 0, "last": 2, "end": ""}]
    with np.load(folder / "surface.npz") as surface:
        assert surface["vertices"].shape[1] == 4
        assert set(surface["vertices"][:, 0]) == {0, 1, 2}
        assert len(surface["cells"]) == len(surface["vertices"])
    assert TrackRun.from_toml(folder / "run.toml").track.time_step == 30


def test_run_toml_runs_again_identically(series, tmp_path, run, one_thread):
    first = run(*arguments(series, "--frames", "1:3", "--no-divisions", "-o", tmp_path / "a"))
    second = run("track", "--settings", tmp_path / "a" / "run.toml", "-o", tmp_path / "b")
    assert first[0] == second[0] == 0, first[2] + second[2]
    for name in ("run.toml", "mesh_t001.ply", "mesh_t002.ply", "tracks.csv", "surface.npz"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_a_folder_of_files_gives_the_same(series, tmp_path, run):
    run(*arguments(series, "--frames", "0:2", "-o", tmp_path / "a"))
    files = ("track", series / "frames" / "t*.tif", "--seeds", series / "start.ply", *FAST)
    code, _, err = run(*files, "--frames", "0:2", "-o", tmp_path / "b")
    assert code == 0, err
    assert "from the metadata" in err
    a, b = (tmp_path / d / "mesh_t001.ply" for d in "ab")
    np.testing.assert_allclose(
        nd.load_mesh(a).vertices_numpy(), nd.load_mesh(b).vertices_numpy(), atol=1e-4
    )


def test_an_interrupted_run_is_kept_and_can_go_on(series, tmp_path, run, monkeypatch):
    def interrupted(*arguments, **options):
        for state in track(*arguments, **options):
            if state.frame == 2:
                raise KeyboardInterrupt
            yield state

    folder = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(judged_results, "track", interrupted)
        code, out, err = run(*arguments(series, "-o", folder))
    assert code == 130
    assert "interrupted; to go on: napari-deltamic track --settings" in err
    assert [line.rsplit("/", 1)[1] for line in out][:2] == ["mesh_t000.ply", "mesh_t001.ply"]
    kept = (folder / "mesh_t001.ply").read_bytes()
    words = err.split("to go on: napari-deltamic ")[1].split()
    code, _, err = run(*words)
    assert code == 0, err
    assert [r.frame for r in read_results(folder)] == [0, 1, 2]
    assert (folder / "mesh_t001.ply").read_bytes() == kept


def test_a_bad_frame_is_noted_and_left_out(series, tmp_path, run):
    movie = np.load(series / "movie.npy")
    movie[1] = 0
    np.save(tmp_path / "movie.npy", movie)
    code, out, err = run(
        "track", tmp_path / "movie.npy", *VOXELS, "--seeds", series / "start.ply", *FAST,
        "-o", tmp_path / "out",
    )  # fmt: skip
    assert code == 0, err
    assert "note: frame 1 skipped: it is flat" in err
    assert [line.rsplit("/", 1)[1] for line in out][:2] == ["mesh_t000.ply", "mesh_t002.ply"]
    assert [r.mesh is None for r in read_results(tmp_path / "out")] == [False, True, False]


def saved(path, array):
    np.save(path, array)
    return path


def with_hole(movie):
    movie = movie.astype(np.float32)
    movie[0, 1, 2, 3] = np.nan
    return movie


REFUSED = {
    "3D": (lambda s, t: saved(t / "a.npy", np.load(s / "movie.npy")[0]), "single 3D image"),
    "one frame": (lambda s, t: saved(t / "a.npy", np.load(s / "movie.npy")[:1]), "two frames"),
    "missing": (lambda s, t: t / "none.tif", "no such file"),
    "NaN": (lambda s, t: saved(t / "a.npy", np.full((3, *SHAPE), np.nan)), "is missing"),
    "a hole": (
        lambda s, t: saved(t / "a.npy", with_hole(np.load(s / "movie.npy"))),
        "frame 0 holds 1 NaN voxel; --missing-nan leaves them out",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_series_that_cannot_be_tracked(name, series, tmp_path, fails):
    make, message = REFUSED[name]
    path = make(series, tmp_path)
    asked = ("track", path, *VOXELS, "--seeds", series / "start.ply", *FAST)
    assert message in fails(*asked, "-o", tmp_path / "out")


def test_a_series_without_any_good_frame(series, tmp_path, run):
    path = saved(tmp_path / "a.npy", np.ones((3, *SHAPE)))
    asked = ("track", path, *VOXELS, "--seeds", series / "start.ply", *FAST)
    code, out, err = run(*asked, "-o", tmp_path / "out")
    assert (code, out) == (2, [])
    assert "error: no frame can be used; the first one: it is flat" in err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--frames", "2"), "--frames must be A:B"),
        (("--frames", "a:b"), "--frames must be A:B"),
        (("--frames", "2:3"), "too few"),
        (("--frames", "7:"), "frame 7 is not there"),
        (("--time-step", "0"), "time_step"),
        (("--velocity", "2"), "velocity"),
        (("--resume", "nowhere"), "cannot read"),
    ],
)
def test_options_that_cannot_be(more, message, series, tmp_path, fails):
    assert message in fails(*arguments(series, *more, "-o", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_seeds_outside_of_the_image(series, tmp_path, fails):
    asked = ("track", series / "movie.npy", *VOXELS, "--seeds", series / "far.ply", *FAST)
    assert "lies outside the image" in fails(*asked, "-o", tmp_path / "out")


def test_results_are_not_replaced_unasked(series, tmp_path, fails):
    (tmp_path / "tracks.csv").write_text("precious")
    assert "--overwrite" in fails(*arguments(series, "-o", tmp_path))


def test_other_frames_of_an_earlier_run_go(series, tmp_path, run):
    """Viewers play all meshes of a folder as one series."""
    folder = tmp_path / "out"
    assert run(*arguments(series, "-o", folder))[0] == 0
    before = {path.name for path in folder.glob("mesh_t*")}
    (folder / "mesh_thesis.ply").write_text("mine")
    fewer = ("--frames", "1:3", "--overwrite", "-o", folder)
    code, _, err = run(*arguments(series, *fewer))
    assert code == 0, err
    left = {path.name for path in folder.glob("mesh_t*")}
    kinds = (".ply", ".vtk")
    assert left == {f"mesh_t00{k}{kind}" for k in (1, 2) for kind in kinds} | {"mesh_thesis.ply"}
    assert left - before == {"mesh_thesis.ply"}
    assert (folder / "surface.npz").is_file()
