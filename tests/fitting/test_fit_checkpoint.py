"""Checkpoints of fits: written, resumed, refused."""

import json

import numpy as np
import pytest

from napari_deltamic import GaussianPSF, InputError, fit
from napari_deltamic.fitting.model.state import load_checkpoint
from napari_deltamic.runs.settings import FitSettings
from synthetic import GRID, OPTICS, apart, fitted, measured, start


@pytest.fixture(scope="module")
def image():
    return measured()


def test_a_checkpoint_is_of_the_state_or_shortly_before(image, tmp_path):
    path = tmp_path / "checkpoint.npz"
    states = fit(image, GRID, start(2), OPTICS)
    state = [next(states) for _ in range(33)][-1]
    state.save(path)
    again = next(fit(image, GRID, start(2), OPTICS, resume=path))
    assert 0 <= state.iteration - again.iteration < 20
    assert again.level == state.level
    assert apart(again.mesh, state.mesh) < 0.5


@pytest.mark.parametrize(
    ("at", "settings", "within"),
    [
        pytest.param(25, FitSettings(levels=(2.0, 1.0)), 1e-6, marks=pytest.mark.slow),
        (45, FitSettings(levels=(1.5, 1.0), fit_psf=True), 1e-6),
        pytest.param(
            20, FitSettings(levels=(1.5, 1.0), density="uniform"), 1e-6, marks=pytest.mark.slow
        ),
    ],
)
def test_a_resumed_fit_ends_as_the_uninterrupted_one(image, tmp_path, at, settings, within):
    optics = GaussianPSF(0.15)
    path = tmp_path / "checkpoint.npz"
    for state in fit(image, GRID, start(2), optics, settings=settings):
        if state.iteration == at:
            state.save(path)
    resumed = fitted(image, start(2), optics=optics, settings=settings, resume=path)
    assert resumed.iteration == state.iteration
    np.testing.assert_allclose(
        resumed.mesh.vertices_numpy(), state.mesh.vertices_numpy(), rtol=0, atol=within
    )


def test_what_small_cells_show_is_asked_once(image, tmp_path):
    """Also where the checkpoint is of the first state, before any step."""
    optics, path = GaussianPSF(0.5), tmp_path / "checkpoint.npz"
    settings = FitSettings(levels=(1.0,), structure="auto", max_iterations=12)
    states = fit(image, GRID, start(2), optics, settings=settings)
    next(states).save(path)
    *_, last = states
    resumed = fitted(image, start(2), optics=optics, settings=settings, resume=path)
    assert (resumed.iteration, resumed.evaluations) == (last.iteration, last.evaluations)


@pytest.fixture
def checkpoint(image, tmp_path):
    path = tmp_path / "checkpoint.npz"
    states = fit(image, GRID, start(1), OPTICS)
    [next(states) for _ in range(30)][-1].save(path)
    return path


def resume(image, path, mesh=None, optics=OPTICS, **settings):
    mesh = start(1) if mesh is None else mesh
    return fit(image, GRID, mesh, optics, settings=FitSettings(**settings), resume=path)


PLAIN = (
    "changed_at",
    "density_now",
    "effects",
    "first_effects",
    "objective",
    "looks",
    "rounds",
    "slivers",
    "structure",
)


@pytest.mark.parametrize("name", ["first_optics", "insides", "light", "pinned", "run", "seed"])
def test_what_a_checkpoint_lacks_is_told_in_one_sentence(image, checkpoint, tmp_path, name):
    kept = load_checkpoint(checkpoint)
    del kept[name]
    np.savez(tmp_path / "less.npz", **kept)
    with pytest.raises(InputError, match=f"checkpoint is damaged .there is no '{name}'.$"):
        resume(image, tmp_path / "less.npz")


@pytest.mark.parametrize("name", PLAIN)
def test_what_its_run_lacks_is_told_in_one_sentence(image, checkpoint, tmp_path, name):
    kept = load_checkpoint(checkpoint)
    run = json.loads(str(kept["run"]))
    for values in (run, run["policy"], run["upkeep"]):
        values.pop(name, None)
    np.savez(tmp_path / "less.npz", **{**kept, "run": np.array(json.dumps(run))})
    with pytest.raises(InputError, match=f"checkpoint is damaged .there is no '{name}'.$"):
        resume(image, tmp_path / "less.npz")


def test_effects_that_are_not_known_are_named(image, checkpoint, tmp_path):
    kept = load_checkpoint(checkpoint)
    run = {**json.loads(str(kept["run"])), "effects": {"magic": {}}}
    np.savez(tmp_path / "more.npz", **{**kept, "run": np.array(json.dumps(run))})
    with pytest.raises(InputError, match="unknown effect 'magic'"):
        resume(image, tmp_path / "more.npz")


def test_refuses_the_checkpoint_of_another_fit(image, checkpoint):
    with pytest.raises(InputError, match="another mesh"):
        resume(image, checkpoint, start(2))
    with pytest.raises(InputError, match="checkpoint"):
        resume(image, checkpoint, levels=(1.0,))
    with pytest.raises(InputError, match="checkpoint"):
        resume(image, checkpoint, density="uniform")
    with pytest.raises(InputError, match="checkpoint"):
        resume(image, checkpoint, optics=GaussianPSF(covariance=np.eye(3) * 0.13**2))


def test_refuses_a_file_that_is_no_checkpoint(image, checkpoint, tmp_path):
    whole = checkpoint.read_bytes()
    damaged = bytearray(whole)
    damaged[len(whole) // 3 : len(whole) // 3 + 50] = bytes(50)
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "archive.npz", vertices=start(1).vertices, level=0)
    files = {
        "empty": b"",
        "text": b"z,y,x\n",
        "half": whole[: len(whole) // 2],
        "damaged": bytes(damaged),
        "array": (tmp_path / "array.npy").read_bytes(),
        "archive": (tmp_path / "archive.npz").read_bytes(),
    }
    for name, content in files.items():
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match="checkpoint"):
            resume(image, path)
    with pytest.raises(InputError, match="nowhere"):
        resume(image, tmp_path / "nowhere")
