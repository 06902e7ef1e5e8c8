"""The command line: what it writes and says, and how it ends early."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.cli import fit_command
from napari_deltamic.fitting import fit
from napari_deltamic.fitting.rivals.light_cone import confocal_of, widefield_of
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import read_image
from napari_deltamic.results.report import FILES
from napari_deltamic.runs.settings import RunSettings

SIZE = (0.3, 0.2, 0.2)
SHAPE = (20, 24, 24)
CENTER = (2.9, 2.3, 2.3)
VOXELS = ("--voxel-size", *map(str, SIZE))
SIGMA = ("--sigma", "0.36", "0.24", "0.24")
SHORT = ("--max-iterations", "4")
FIT = "napari_deltamic.fitting.job.fit"


# What works -----------------------------------------------------------------------------------


@pytest.mark.usefixtures("judged")
def test_fit_writes_everything(data, tmp_path, run):
    folder = tmp_path / "deep" / "out"
    code, out, err = run(
        "fit", data / "cell.tif", "--seeds", data / "start.ply", *SHORT, "-o", folder
    )
    assert code == 0, err
    assert [Path(line).name for line in out] == [*FILES, "checkpoint.npz"]
    assert all(Path(line).is_file() for line in out)
    assert sorted(os.listdir(folder)) == sorted([*FILES, "checkpoint.npz"])
    assert "note: voxel size 0.3 0.2 0.2 um (Z Y X), from the metadata of cell.tif" in err
    assert "note: no sigma given: " in err
    assert re.search(r"level \d/5", err)
    report = json.loads((folder / "report.json").read_text())
    assert report["iterations"] == len(report["loss"]) == 4
    assert report["converged"] is False
    settings = RunSettings.from_toml(folder / "run.toml")
    assert settings.scene.sigma == pytest.approx((0.36, 0.24, 0.24), rel=0.1)
    assert Path(settings.image).is_absolute()


def test_cells_of_a_size_are_looked_for(data, tmp_path, run, fails):
    given = ("fit", data / "cell.tif", *SHORT, "-o", tmp_path / "out")
    code, _, err = run(*given, "--seeds", "auto:2.5")
    assert code == 0, err
    assert RunSettings.from_toml(tmp_path / "out" / "run.toml").seeds == "auto:2.5"
    assert re.search(r"note: 1 cell was found, about [2-3][.0-9]* um across \(auto:12 looks", err)
    again = (*given, "--overwrite", "--seeds")
    assert "'wide' is not a cell size" in fails(*again, "auto:wide")
    assert "must be positive (um), not -1" in fails(*again, "auto:-1")
    np.save(tmp_path / "flat.npy", np.random.default_rng(0).poisson(9, SHAPE).astype(np.float32))
    nothing = ("fit", tmp_path / "flat.npy", *VOXELS, "-o", tmp_path / "out2")
    assert "(auto:12 looks for cells of about 12 um)" in fails(*nothing, "--seeds", "auto")


def test_run_toml_runs_again_identically(data, tmp_path, run):
    options = ("--fit-psf", "--accuracy", "1e-2", "--likelihood", "gaussian", "--effects")
    first = run(
        "fit", data / "cell.npy", *VOXELS, "--seeds", data / "start.ply", *SIGMA, *SHORT,
        *options, "pixel-integration", "-o", tmp_path / "a",
    )  # fmt: skip
    toml = tmp_path / "a" / "run.toml"
    second = run("fit", "--settings", toml, "-o", tmp_path / "b")
    assert first[0] == second[0] == 0, first[2] + second[2]
    assert toml.read_bytes() == (tmp_path / "b" / "run.toml").read_bytes()
    assert (tmp_path / "a/mesh.ply").read_bytes() == (tmp_path / "b/mesh.ply").read_bytes()
    settings = RunSettings.from_toml(toml)
    assert settings.fit.fit_psf
    assert settings.fit.accuracy == 1e-2
    assert settings.fit.likelihood == "gaussian"
    assert settings.scene.effects.names == ("pixel_integration",)


@pytest.mark.usefixtures("judged")
@pytest.mark.parametrize("made", [widefield_of, confocal_of])
def test_run_toml_has_the_psf_that_a_fit_went_on_with(data, tmp_path, run, monkeypatch, made):
    begun = []

    def states(job, resume=None):
        begun.append(job.optics.sigma_um)  # stderr rounds it
        few = job.settings.fit.model_copy(update={"max_iterations": 2})
        given = job.image, job.grid, job.mesh
        yield next(iter(fit(*given, job.optics, settings=few)))
        yield from fit(*given, made(job.optics.sigma_um), settings=few)

    monkeypatch.setattr(fit_command, "CHECKPOINT_EVERY", -1.0)
    monkeypatch.setattr(fit_command, "start", states)
    arguments = "fit", data / "cell.tif", "--seeds", data / "start.ply", "-o", tmp_path
    code, _, err = run(*arguments)
    assert code == 0, err
    found = RunSettings.from_toml(tmp_path / "run.toml").scene
    assert found.sigma is None
    built, started = found.optics.build(), made(begun[0])
    assert built.parameters().tolist() == pytest.approx(started.parameters().tolist(), rel=1e-3)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["optics"]["model"] == type(started).__name__


def test_options_prevail_over_settings(data, tmp_path, run, seen):
    arguments = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA, "--fit-psf")
    run(*arguments, "-o", tmp_path / "a")
    toml = tmp_path / "a" / "run.toml"
    code, _, _ = run(
        "fit", "--settings", toml, "--no-fit-psf", "--density", "smooth",
        "-o", tmp_path / "b",
    )  # fmt: skip
    assert code == 0
    settings = seen[1][1]["settings"]
    assert not settings.fit_psf
    assert settings.density == "smooth"


@pytest.mark.parametrize("seeds", ["start.ply", "labels.tif", "points.csv", "balls.csv"])
def test_kinds_of_seeds(data, tmp_path, run, seen, seeds):
    arguments = ("fit", data / "cell.tif", "--seeds", data / seeds, *SIGMA)
    code, _, err = run(*arguments, "-o", tmp_path / "out")
    assert code == 0, err
    ((_, grid, mesh, _), options) = seen[0]
    assert grid.voxel_size == pytest.approx(SIZE, rel=1e-6)
    assert np.linalg.norm(mesh.vertices.mean(axis=0) - CENTER) < 0.15
    assert options["counted"] is not None  # ground that is nobody's is left out for each


@pytest.mark.usefixtures("judged")
def test_missing_voxels(data, tmp_path, run, seen):
    for name in ("nan", "inf"):
        arguments = ("fit", data / f"{name}.tif", "--seeds", data / "points.csv", *SIGMA)
        code, _, err = run(*arguments, "--missing-nan", "-o", tmp_path / name)
        assert code == 0
        assert "of 11520 voxels are treated as missing" in err
    for (image, *_), _ in seen:
        assert np.isnan(image).sum() == 2
        assert not np.isinf(image).any()


def test_effects_auto_says_what_it_does(data, tmp_path, run, seen):
    # What shines is not known after one iteration.
    held = *SIGMA, "--structure", "membrane"
    arguments = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *held)
    _, _, err = run(*arguments, "--effects", "auto", "-o", tmp_path / "out")
    assert "note: effects: the image calls for none" in err
    assert seen[0][1]["effects"].names == ()


def test_repairs_are_notes(data, tmp_path, run, seen):
    mesh = sphere(CENTER, 1.0, edge_length=0.5)
    lines = [f"v {x} {y} {z}" for z, y, x in [*mesh.vertices.tolist(), (0, 0, 0)]]
    lines += [f"f {i} {j} {k}" for i, j, k in (mesh.faces + 1).tolist()]
    path = tmp_path / "start.obj"
    path.write_text("\n".join(lines))
    arguments = ("fit", data / "cell.tif", "--seeds", path, *SIGMA, "-o", tmp_path / "out")
    code, _, err = run(*arguments)
    assert code == 0
    assert "note: start.obj: " in err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert any("start.obj" in text for text in report["warnings"])


def test_a_voxel_size_against_the_metadata_is_told(data, tmp_path, run, seen):
    arguments = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA)
    _, _, err = run(*arguments, "--voxel-size", "0.3", "0.2", "0.25", "-o", tmp_path)
    assert "0.3 0.2 0.25 um, as given, is used" in err
    assert seen[0][0][1].voxel_size == (0.3, 0.2, 0.25)


def test_render(data, tmp_path, run, fails):
    path = tmp_path / "image.tif"
    arguments = ("render", data / "start.ply", "--shape", *SHAPE, *VOXELS, *SIGMA, "-o", path)
    assert run(*arguments, "--effects", "pixel-integration") == (0, [str(path)], "")
    image, voxel_size = read_image(path)
    assert voxel_size == pytest.approx(SIZE, rel=1e-6)
    wanted = nd.render(
        nd.load_mesh(data / "start.ply"),
        nd.Grid(SHAPE, SIZE),
        nd.GaussianPSF((0.36, 0.24, 0.24)),
        effects=("pixel_integration",),
    )
    assert np.array_equal(image, wanted.numpy())
    assert "--overwrite" in fails(*arguments)
    assert "unknown effect 'magic'" in fails(*arguments, "--effects", "magic", "--overwrite")
    assert run(*arguments, "--overwrite")[0] == 0
    assert not np.array_equal(read_image(path)[0], image)


def test_help_and_version(run):
    for arguments in (["--help"], ["fit", "--help"], ["render", "-h"], ["--version"]):
        code, out, err = run(*arguments)
        assert (code, err) == (0, "")
        assert out
    assert out == [f"napari-deltamic {nd.__version__}"]


# What ends early ------------------------------------------------------------------------------


def stops(monkeypatch, after, error):
    """Make the fit raise an error after some iterations."""

    def broken(*arguments, **options):
        for state in fit(*arguments, **options):
            if state.iteration > after:
                raise error
            yield state

    monkeypatch.setattr(FIT, broken)


def test_interrupt_saves_and_says_how_to_go_on(data, tmp_path, run, monkeypatch):
    folder = tmp_path / "out"
    with monkeypatch.context() as patch:
        stops(patch, 2, KeyboardInterrupt())
        arguments = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA, *SHORT)
        code, out, err = run(*arguments, "-o", folder)
    assert code == 130
    assert [Path(line).name for line in out] == [*FILES, "checkpoint.npz"]
    report = json.loads((folder / "report.json").read_text())
    assert (report["iterations"], report["converged"]) == (2, False)
    assert report["message"] == "interrupted"
    command = err.split("to go on: napari-deltamic ")[1].split()
    code, out, err = run(*command)
    assert code == 0, err
    assert json.loads((folder / "report.json").read_text())["iterations"] >= 4


def test_interrupt_before_the_first_iteration(data, tmp_path, run, monkeypatch):
    stops(monkeypatch, 0, KeyboardInterrupt())
    arguments = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA)
    code, out, err = run(*arguments, "-o", tmp_path / "out")
    assert (code, out) == (130, [])
    assert "nothing to save" in err


def test_checkpoints_while_it_runs(data, tmp_path, run, monkeypatch):
    monkeypatch.setattr("napari_deltamic.cli.fit_command.CHECKPOINT_EVERY", 0.0)
    found = []

    def watched(*arguments, **options):
        for state in fit(*arguments, **options):
            yield state
            found.append(sorted(os.listdir(tmp_path)))

    monkeypatch.setattr(FIT, watched)
    arguments = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA, *SHORT)
    run(*arguments, "-o", tmp_path)
    assert found[0] == ["checkpoint.npz", "run.toml"]


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (FloatingPointError("a number that is not finite"), "a number that is not finite"),
        (ZeroDivisionError("oh\nno"), "ZeroDivisionError: oh no"),
        (
            RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate "
                         "8589934592 bytes. Error code 12 (Cannot allocate memory)"),
            "not enough memory (8 GiB more were needed): a coarser accuracy",
        ),
        (
            MemoryError("Unable to allocate 5.96 GiB for an array with shape (2000, 400000)"),
            "not enough memory (5.96 GiB more were needed)",
        ),
        (MemoryError(), "an image of 20 x 24 x 24 voxels needs about"),
    ],
)  # fmt: skip
def test_engine_failure(data, tmp_path, run, monkeypatch, error, says):
    stops(monkeypatch, 1, error)
    arguments = ("fit", data / "cell.npy", *VOXELS, *SIGMA, "--seeds", data / "start.ply")
    code, out, err = run(*arguments, "-o", tmp_path / "out")
    assert (code, out) == (1, [])
    last = err.splitlines()[-1]
    assert last.startswith("napari-deltamic: error: ")
    assert says in last
    assert "Traceback" not in err
    checkpoint = tmp_path / "out" / "checkpoint.npz"
    assert checkpoint.is_file()
    assert f"the state after 1 iterations is in {checkpoint}" in last


def test_no_memory_before_the_fit(data, tmp_path, fails, monkeypatch):
    def none_left(*arguments, **options):
        raise MemoryError

    monkeypatch.setattr(FIT, none_left)
    arguments = ("fit", data / "cell.npy", *VOXELS, *SIGMA, "--seeds", data / "start.ply")
    assert "cropped image" in fails(*arguments, "-o", tmp_path / "out", code=1)
    assert not (tmp_path / "out").exists()


# doctor ---------------------------------------------------------------------------------------


def test_doctor(run):
    code, out, err = run("doctor")
    assert (code, err) == (0, "")
    text = "\n".join(out)
    for word in ("versions", "devices", "engines", "threads", "used", "problems", "particle-mesh"):
        assert word in text
    code, out, _ = run("doctor", "--json")
    assert json.loads("\n".join(out))["versions"]["napari-deltamic"] == nd.__version__


def test_doctor_without_the_extension(run, monkeypatch):
    monkeypatch.setattr("napari_deltamic.cli.doctor_command.native", lambda: None)
    code, out, err = run("doctor")
    assert (code, err) == (0, "")
    assert any("the compiled extension is missing" in line for line in out)


def test_doctor_tells_of_a_wrong_setting(run, monkeypatch):
    if nd.fourier.native() is None:
        pytest.skip("needs the compiled extension")
    monkeypatch.setenv("DELTAMIC_SIMD", "abacus")
    code, out, _ = run("doctor")
    assert code == 0
    assert any("DELTAMIC_SIMD=abacus: choose one of" in line for line in out)
