"""``napari-deltamic accuracy``: its table, its files, and what it refuses."""

import json

import numpy as np
import pytest
from PIL import Image

import napari_deltamic as nd
from napari_deltamic.accuracy import machine_costs
from napari_deltamic.accuracy.tradeoff import measure_ways
from napari_deltamic.fitting.shape_dial import Dialled
from napari_deltamic.fourier.cost import BUILT_IN

SHAPE = ("--shape", "20", "24", "24")
VOXELS = ("--voxel-size", "0.3", "0.2", "0.2")
SIGMA = ("--sigma", "0.36", "0.24", "0.24")


@pytest.fixture(autouse=True)
def known_costs(monkeypatch):
    """Costs that need no measuring, and nothing slow."""
    monkeypatch.setattr("napari_deltamic.cli.accuracy_command.costs", lambda again: BUILT_IN)
    monkeypatch.setattr(machine_costs, "_known", {})


def row(out, *words):
    (line,) = [line for line in out if all(w in line for w in words)]
    return line


def test_a_mesh(data, tmp_path, run):
    folder = tmp_path / "deep" / "out"
    scene = (data / "start.ply", *SHAPE, *VOXELS, *SIGMA)
    code, out, err = run("accuracy", *scene, "--accuracy", "1e-2", "-o", folder)
    assert code == 0, err
    assert out[0].startswith("start.ply: 20 x 24 x 24 voxels, ")
    assert "accuracy in use: 1e-2" in out
    assert "in use" in row(out, "asked 1e-2")
    assert "reference" in row(out, "closed form, full grid, float64")
    assert out[-2:] == [str(folder / "accuracy.json"), str(folder / "accuracy.png")]
    facts = json.loads((folder / "accuracy.json").read_text())
    assert facts["version"] == nd.__version__
    assert facts["accuracy_in_use"] == 1e-2
    assert facts["scene"]["shape"] == [20, 24, 24]
    assert facts["shape"] is facts["forecast"] is facts["noise"] is None
    (used,) = [w for w in facts["ways"] if w["in_use"]]
    assert 0 < used["error"] < 1e-2
    assert any(w["on_front"] for w in facts["ways"])
    with Image.open(folder / "accuracy.png") as picture:
        assert picture.size == (1000, 620)
    assert "--overwrite" in run("accuracy", *scene, "-o", folder)[2]


@pytest.mark.parametrize(
    ("lacks", "says"),
    [
        ("no NVIDIA GPU is found", "measured on the CPU: no NVIDIA GPU is found"),
        ("", "measured on the CPU: fits use the GPU, whose times are not measured here"),
    ],
)
def test_it_says_what_was_measured_where_there_is_a_gpu_or_none(
    data, run, monkeypatch, lacks, says
):
    monkeypatch.setattr("napari_deltamic.cli.accuracy_command.missing", lambda: lacks)
    scene = (data / "start.ply", *SHAPE, *VOXELS, *SIGMA)
    code, out, err = run("accuracy", *scene, "--budget", "0.05")
    assert code == 0, err
    assert says in out


def test_an_image_with_seeds(data, run):
    code, out, err = run("accuracy", data / "cell.tif", "--seeds", data / "points.csv", *SIGMA)
    assert code == 0, err
    assert any(line.startswith("noise of a voxel: 0.0") for line in out)
    assert "accuracy in use: 2e-2" in out
    assert any(line.startswith("a fit from these seeds: about ") for line in out)
    assert "in use" in row(out, "asked 2e-2")


def test_what_takes_too_long_is_told(data, run):
    scene = (data / "start.ply", *SHAPE, *VOXELS, *SIGMA)
    code, out, err = run("accuracy", *scene, "--budget", "1e-6")
    assert code == 0, err
    assert row(out, "closed form, full grid, float64").rstrip().endswith(("ms", " s"))
    assert sum("not measured: about" in line for line in out) > 20


def test_shape_error(data, tmp_path, run, monkeypatch):
    from napari_deltamic.cli import accuracy_command as module

    asked = {}

    def few(truth, grid, optics, photons, **options):
        asked.update(options, photons=photons)
        took = Dialled(0.4, 1e-2, 0.02, 0.012)
        given = ("quick", 0.02), ("normal", 0.0102), ("careful", 0.01)
        for n, (choice, error) in enumerate(given):
            yield module.ShapeError(choice, took, (error, error * 1.1), 40, 0.5 + n)

    monkeypatch.setattr(module, "shape_errors", few)
    monkeypatch.setattr(module, "measure_ways", lambda *a, **k: list(measure_ways(*a, **k))[:2])
    scene = (data / "start.ply", *SHAPE, *VOXELS, *SIGMA)
    code, out, err = run(
        "accuracy", *scene, "--shape-error", "--photons", "50", "--draws", "2", "-o", tmp_path
    )
    assert code == 0, err
    assert (asked["photons"], asked["draws"]) == (50, 2)
    assert (
        "normal is the fastest choice within 5 % of the least error, given this noise (2 draws)."
        in out
    )
    assert row(out, "careful").split()[1:5] == ["12", "nm", "10.5", "nm"]
    assert (tmp_path / "shape.png").is_file()
    facts = json.loads((tmp_path / "accuracy.json").read_text())["shape"]
    assert facts["enough"] == "normal"
    assert facts["choices"][2]["mean_nm"] == pytest.approx(10.5)
    assert facts["choices"][2]["predicted_nm"] == pytest.approx(12)
    assert facts["choices"][2]["mean_voxels"] == pytest.approx(0.0525)


@pytest.mark.slow
def test_shape_error_of_an_image_is_at_its_noise(data, run, monkeypatch):
    from napari_deltamic.cli import accuracy_command as module

    asked = {}

    def one(truth, grid, optics, photons, **options):
        asked.update(truth=truth, photons=photons)
        yield module.ShapeError("normal", Dialled(0.4, 1e-2, 0.02, 0.01), (0.01,), 40, 0.5)

    monkeypatch.setattr(module, "shape_errors", one)
    monkeypatch.setattr(module, "measure_ways", lambda *a, **k: list(measure_ways(*a, **k))[:1])
    arguments = ("accuracy", data / "cell.npy", "--seeds", data / "start.ply", *VOXELS, *SIGMA)
    code, _, err = run(*arguments, "--shape-error", "--draws", "1")
    assert code == 0, err
    # 100 to 500 counts, of which 400 are signal: a background of a quarter, so more noise.
    assert 100 < asked["photons"] < 1000
    # The fitted surface, not the seeds: theirs is a sphere of radius 1.
    assert np.ptp(asked["truth"].vertices[:, 0]) > 2.2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("start.ply", *VOXELS, *SIGMA), "--shape Z Y X"),
        (("start.ply", *SHAPE, *SIGMA), "--voxel-size Z Y X"),
        (("start.ply", *SHAPE, *VOXELS), "--sigma Z Y X"),
        (("start.ply", *SHAPE, *VOXELS, *SIGMA, "--seeds", "x"), "--seeds goes with an image"),
        (("start.ply", *SHAPE, *VOXELS, *SIGMA, "--shape-error"), "--photons P"),
        (("start.ply", *SHAPE, *VOXELS, *SIGMA, "--accuracy", "1"), "accuracy must be"),
        (("start.ply", *SHAPE, *VOXELS, *SIGMA, "--budget", "0"), "budget must be"),
        (("start.ply", *SHAPE, *VOXELS, *SIGMA, "--draws", "0"), "--draws must be"),
        (("cell.tif", *SIGMA), "--seeds FILE"),
        (("cell.tif", "--seeds", "points.csv", *SHAPE), "--shape goes with a mesh"),
        (("cell.tif", "--seeds", "points.csv", "--photons", "3"), "--photons goes with a mesh"),
        (("cell.npy", "--seeds", "start.ply"), "voxel size"),
        (("points.csv", *SIGMA), "unknown extension '.csv'"),
        (("none.ply", *SHAPE, *VOXELS, *SIGMA), "there is no such file"),
        (("none.tif", "--seeds", "points.csv"), "there is no such file"),
    ],
)
def test_bad_usage(data, fails, arguments, says):
    files = ("start.ply", "cell.tif", "cell.npy", "points.csv", "none.ply", "none.tif")
    words = [data / a if a in files else a for a in arguments]
    assert says in fails("accuracy", *words)


def test_a_folder_that_is_a_file(data, tmp_path, fails):
    (tmp_path / "file").write_text("")
    scene = (data / "start.ply", *SHAPE, *VOXELS, *SIGMA)
    assert "is a file" in fails("accuracy", *scene, "-o", tmp_path / "file")
