"""Changes that a user makes while a fit runs."""

import numpy as np
import pytest

from napari_deltamic import Change, GaussianPSF, Grid, InputError, Mesh, fit, render
from napari_deltamic.fitting.job import assemble
from napari_deltamic.fitting.pending import usable
from napari_deltamic.geometry import remesh, sphere
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects, Halo, Missing
from synthetic import CENTER, GRID, OPTICS, RADIUS, VOXEL, apart, measured, start

QUICK = FitSettings(levels=(2.0, 1.0))


@pytest.fixture(scope="module")
def image():
    return measured()


def begun(image, iterations=15, settings=QUICK, mesh=None):
    """A fit that has done some iterations, and its last state."""
    states = fit(image, GRID, mesh or start(2), OPTICS, settings=settings)
    for _ in range(iterations):
        state = next(states)
    return states, state


def finished(states, state):
    return [state, *states][-1]


@pytest.mark.slow
def test_an_empty_change_does_no_harm(image):
    states, _ = begun(image)
    state = states.send(Change())
    assert state.iteration == 16
    assert finished(states, state).converged


def test_goes_on_from_moved_vertices(image):
    states, state = begun(image)
    moved = state.mesh.translated((0.0, 0.3, 0.0))
    after = states.send(Change(mesh=moved))
    np.testing.assert_array_equal(after.mesh.vertices_numpy(), moved.vertices)
    assert after.iteration == state.iteration + 1
    last = finished(states, after)
    assert last.converged
    assert apart(last.mesh) < 0.05


@pytest.mark.slow
def test_goes_on_with_other_triangles(image):
    settings = QUICK.model_copy(update={"density": "smooth"})
    states, state = begun(image, 20, settings)
    finer = remesh(state.mesh, 0.6 * state.mesh.median_edge()).mesh
    pinned = np.arange(len(finer.vertices)) == 0
    after = states.send(Change(mesh=finer, pinned=pinned))
    np.testing.assert_array_equal(after.mesh.vertices_numpy(), finer.vertices)
    assert after.density.shape == (len(finer.faces),)
    last = finished(states, after)
    np.testing.assert_array_equal(last.mesh.vertices_numpy()[0], finer.vertices[0])
    assert last.converged
    assert apart(last.mesh) < 0.05


def test_pinned_vertices_stay_until_they_are_freed(image):
    small = sphere(CENTER, 0.8 * RADIUS, subdivisions=2)
    states, state = begun(image, mesh=small)
    pinned = state.mesh.vertices_numpy()[:, 0] > CENTER[0] + 0.5 * RADIUS
    state = states.send(Change(pinned=pinned))
    there = state.mesh.vertices_numpy()[pinned]
    last = finished(states, state)
    np.testing.assert_array_equal(last.mesh.vertices_numpy()[pinned], there)
    radius = np.linalg.norm(last.mesh.vertices_numpy() - CENTER, axis=1)
    assert abs(radius[~pinned].max() - RADIUS) < 0.5 * VOXEL
    # The surface between the two is not torn: no edge is much longer than those elsewhere.
    a, b = last.mesh.vertices_numpy()[last.mesh.edges()].transpose(1, 0, 2)
    lengths = np.linalg.norm(a - b, axis=1)
    assert lengths.max() < 3 * np.median(lengths)
    freed = finished(states_after(last, states_for(image, last)), last)
    assert apart(freed.mesh) < 0.1


def states_for(image, last):
    return fit(image, GRID, last.mesh, OPTICS, settings=FitSettings(levels=(1.0,)))


def states_after(last, states):
    state = next(states)
    pinned = np.ones(len(last.mesh.vertices), bool)
    held = states.send(Change(pinned=pinned))
    again = next(states)
    np.testing.assert_array_equal(again.mesh.vertices_numpy(), held.mesh.vertices_numpy())
    states.send(Change(pinned=~pinned))
    assert not np.array_equal(next(states).mesh.vertices_numpy(), state.mesh.vertices_numpy())
    return states


def test_takes_another_psf(image):
    states, _ = begun(image)
    wide = GaussianPSF(0.2)
    held = QUICK.model_copy(update={"fit_psf": False})
    state = states.send(Change(optics=wide, settings=held))
    assert state.optics.sigma_um == wide.sigma_um
    assert finished(states, state).optics.sigma_um == wide.sigma_um


def test_takes_other_settings(image):
    states, _ = begun(image)
    loose = QUICK.model_copy(update={"accuracy": 3e-2, "fit_psf": True})
    state = states.send(Change(optics=GaussianPSF(0.17), settings=loose))
    last = finished(states, state)
    assert last.converged
    np.testing.assert_allclose(last.optics.sigma_um, OPTICS.sigma_um, rtol=0.05)


@pytest.mark.slow
def test_takes_another_density_model(image):
    states, _ = begun(image)
    state = states.send(Change(settings=QUICK.model_copy(update={"density": "smooth"})))
    state = next(states)
    assert finished(states, state).density.std() > 0


def test_a_fit_that_has_ended_goes_on(image):
    short = QUICK.model_copy(update={"max_iterations": 10})
    states, state = begun(image, 10, short)
    assert "before it converged" in state.message
    state = states.send(Change(mesh=state.mesh))
    assert not state.message
    # Its patience starts anew.
    assert finished(states, state).iteration == 20


@pytest.mark.slow
def test_a_change_is_part_of_the_checkpoint(image, tmp_path):
    states, state = begun(image, 30)
    moved = state.mesh.vertices_numpy() * 1.01
    pinned = np.arange(len(moved)) < 5
    state = states.send(Change(mesh=state.mesh.with_vertices(moved), pinned=pinned))
    state.save(tmp_path / "kept.npz")
    again = fit(image, GRID, start(2), OPTICS, settings=QUICK, resume=tmp_path / "kept.npz")
    np.testing.assert_array_equal(next(again).mesh.vertices_numpy(), moved)
    np.testing.assert_array_equal(finished(again, None).mesh.vertices_numpy()[:5], moved[:5])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "effects"),
    [
        (Change(optics=GaussianPSF(0.2)), ()),
        (Change(effects=Effects.of(Halo(fraction=0.1, width=0.6))), (Halo(width=0.2),)),
    ],
)
def test_a_fit_that_was_changed_and_resumed_is_the_one_that_went_on(tmp_path, change, effects):
    """Its priors lie around what was given last, and its patience begins there."""
    image = measured(noise=0)
    settings = QUICK.model_copy(update={"fit_psf": True, "max_iterations": 25})
    given = image, GRID, start(2), OPTICS
    options = {"settings": settings, "effects": Effects.of(*effects)}
    states = fit(*given, **options)
    for _ in range(8):
        next(states)
    state = states.send(change)
    state.save(tmp_path / "kept.npz")
    last = finished(states, state)
    resumed = [*fit(*given, **options, resume=tmp_path / "kept.npz")][-1]
    assert resumed.iteration == last.iteration == 8 + 25
    np.testing.assert_allclose(resumed.optics.sigma_um, last.optics.sigma_um, rtol=1e-9)
    np.testing.assert_allclose(
        resumed.mesh.vertices_numpy(), last.mesh.vertices_numpy(), rtol=0, atol=1e-6
    )


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (Change(mesh=Mesh.merge([start(1), start(1)])), "regions"),
        (Change(mesh=start(1), pinned=np.zeros(162, bool)), "42 vertices"),
        (Change(pinned=np.zeros(3, bool)), "pinned"),
        (Change(settings=FitSettings(levels=(1.0,))), "levels"),
        (Change(optics=GaussianPSF(covariance=0.01 * np.eye(3))), "parameters"),
    ],
)
def test_what_cannot_be_used_is_refused(image, change, reason):
    states, _ = begun(image, 1)
    with pytest.raises(InputError, match=reason):
        states.send(change)


def test_a_psf_so_wide_that_its_blur_leaves_no_voxel_is_taken_at_the_blur_before():
    grid = Grid((20, 24, 24), (0.3, 0.2, 0.2))
    center = [1.4 * (n - 1) * d / 2.8 for n, d in zip(grid.shape, grid.voxel_size, strict=True)]
    narrow, wide = GaussianPSF((0.3, 0.2, 0.2)), GaussianPSF((1.2, 0.8, 0.8))
    image = render(sphere(center, 1.2), grid, narrow).numpy()
    states = fit(image, grid, sphere(center, 1.0), narrow)
    next(states)
    state = states.send(Change(optics=wide))
    assert state.optics.sigma_um == wide.sigma_um
    assert np.isfinite(next(states).loss)


def test_effects_that_leave_too_few_voxels_are_refused_before_a_fit_takes_them(image):
    scene = SceneSettings(voxel_size=GRID.voxel_size, sigma=OPTICS.sigma_um)
    run = RunSettings(image="", seeds="", scene=scene)
    job = assemble(run, image, GRID, start(2), "rough")
    change = Change(effects=Effects.of(Missing(slices=tuple(range(GRID.shape[0])))))
    with pytest.raises(InputError, match="only 0 voxels count"):
        usable(change, job.mesh, job.optics, job)
    usable(Change(effects=Effects.of("halo")), job.mesh, job.optics, job)
