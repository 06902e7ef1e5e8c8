import numpy as np
import pytest
import torch

from napari_deltamic import GaussianPSF, Grid, InputError, Mesh, fit, render
from napari_deltamic.fitting.model.likelihood import match
from napari_deltamic.fitting.objective.convergence import Remaining
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import expected_image
from synthetic import (
    CENTER,
    GRID,
    OPTICS,
    RADIUS,
    SHORT,
    TRUTH,
    VOXEL,
    apart,
    fitted,
    measured,
    start,
)


@pytest.fixture(scope="module")
def image():
    return measured()


@pytest.fixture(scope="module")
def states(image):
    """Every state of one fit, with copies of the vertices as they were when it was yielded."""
    return [(s, s.mesh.vertices_numpy().copy()) for s in fit(image, GRID, start(), OPTICS)]


# ------------------------------------------------------------------------------- convergence


def test_finds_the_sphere_and_ends_by_itself(states):
    last = states[-1][0]
    assert last.converged
    assert last.message == "converged"
    assert last.loss < 1e-5
    assert apart(last.mesh) < 0.05


def test_finds_the_sphere_in_noise():
    last = fitted(measured(noise=0))
    assert last.converged
    assert last.moving is None
    assert apart(last.mesh) < 0.15


def test_the_place_that_still_moves_is_that_of_the_verdict(monkeypatch):
    monkeypatch.setattr(Remaining, "moves", lambda *given: True)
    last = fitted(measured(noise=0), settings=FitSettings(levels=(1.0,)))
    z, y, x = last.moving
    where = f"at ({z:.1f}, {y:.1f}, {x:.1f}) um"
    assert last.message == f"converged, except {where}, where the surface still moves"
    assert (last.mesh.vertices_numpy() == last.moving).all(axis=1).any()


def test_anisotropic_voxels_and_an_origin():
    grid = Grid((14, 28, 30), (0.25, 0.1, 0.12), (-3.0, 40.0, 7.5))
    optics = GaussianPSF((0.3, 0.13, 0.15))
    center = np.add(grid.origin, (1.6, 1.35, 1.75))
    truth = sphere(center, (1.0, 0.75, 0.85), subdivisions=5)
    image = measured(grid, truth, optics)
    last = fitted(
        image, sphere(np.add(center, (0.2, 0.1, -0.1)), 0.7, subdivisions=2), grid, optics
    )
    assert last.converged
    assert apart(last.mesh, truth) < 0.1


@pytest.mark.parametrize("likelihood", ["gaussian", pytest.param("paper", marks=pytest.mark.slow)])
def test_other_likelihoods_find_the_sphere(image, likelihood):
    settings = FitSettings(likelihood=likelihood, levels=(2.0, 1.0))
    last = fitted(image, start(2), settings=settings)
    assert last.converged
    assert apart(last.mesh) < 0.05


@pytest.mark.parametrize("wrong", [1.5, pytest.param(1 / 1.5, marks=pytest.mark.slow)])
def test_fits_the_psf(image, wrong):
    optics = GaussianPSF(0.13 * wrong)
    last = fitted(image, start(2), optics=optics, settings=FitSettings(fit_psf=True))
    assert last.converged
    np.testing.assert_allclose(last.optics.sigma_um, 0.13, rtol=0.02)
    assert apart(last.mesh) < 0.05


def test_the_psf_is_held_where_that_is_asked(image):
    last = fitted(image, start(), settings=FitSettings(fit_psf=False))
    assert last.optics.sigma_um == OPTICS.sigma_um


# ------------------------------------------------------------------------- generator contract


def test_states_count_from_one(states):
    states = [state for state, _ in states]
    assert [s.iteration for s in states] == list(range(1, len(states) + 1))
    levels = [s.level for s in states]
    assert levels == sorted(levels)
    assert levels[-1] == states[-1].levels
    assert states[-1].blur == 1
    assert all(isinstance(s.loss, float) for s in states)
    assert states[-1].loss < states[0].loss
    assert not any(s.converged for s in states[:-1])


def test_states_own_their_meshes(states):
    for state, vertices in states[::20]:
        np.testing.assert_array_equal(state.mesh.vertices_numpy(), vertices)


def test_the_first_state_is_the_start(image):
    mesh = start()
    first = next(fit(image, GRID, mesh, OPTICS))
    np.testing.assert_array_equal(first.mesh.vertices_numpy(), mesh.vertices_numpy())
    assert not np.shares_memory(first.mesh.vertices_numpy(), mesh.vertices_numpy())


def test_rendered_shows_the_image(states, image):
    rendered = states[-1][0].rendered()
    assert rendered.shape == GRID.shape
    assert rendered.dtype == np.float32
    assert np.sqrt(np.mean((rendered - image) ** 2)) < 0.01 * image.max()


def test_rendered_is_of_its_own_state(states):
    # Asked of an early state after the fit: amplitude and mesh are those of that moment.
    early, vertices = states[0]
    given = early.mesh.with_vertices(vertices), GRID, early.optics, 1e-3
    scale = early.amplitude, early.background
    expected = expected_image(*given, *scale, density=early.density, light=early.light)
    np.testing.assert_allclose(early.rendered(), expected, rtol=1e-5)


def test_the_start_is_not_moved(image):
    mesh = start(2)
    before = mesh.vertices_numpy().copy()
    fitted(image, mesh, settings=SHORT)
    np.testing.assert_array_equal(mesh.vertices_numpy(), before)


def test_double_precision(image):
    """Exact sums, and the same in double precision: a fit goes the same way, to more digits."""
    settings = FitSettings(levels=(1.0,), max_iterations=3)  # exact sums are slow
    exact, double, single = (
        fitted(image, start(1), settings=settings, accuracy=accuracy)
        for accuracy in (0, 1e-5, 1e-2)
    )
    ours, theirs = (
        np.abs(one.mesh.vertices_numpy() - exact.mesh.vertices_numpy()).max()
        for one in (double, single)
    )
    assert ours < 1e-4 * RADIUS
    assert ours < theirs / 10


@pytest.mark.parametrize("accuracy", [-1, 1, 2, float("nan")])
def test_refuses_accuracy_at_the_call(image, accuracy):
    with pytest.raises(InputError, match="accuracy"):
        fit(image, GRID, start(1), OPTICS, accuracy)


def test_refuses_unknown_effects_at_the_call(image):
    with pytest.raises(InputError, match="effect"):
        fit(image, GRID, start(1), OPTICS, effects=("magic",))


def test_says_when_it_gave_up(image):
    last = fitted(image, start(1), settings=FitSettings(max_iterations=7))
    assert (last.iteration, last.converged) == (7, False)
    assert last.message == "stopped after 7 iterations, before it converged"


# ----------------------------------------------------------------------------- reproducibility


@pytest.mark.slow
def test_two_runs_agree(states, image):
    again = fitted(image)
    assert again.iteration == len(states)
    np.testing.assert_allclose(again.mesh.vertices_numpy(), states[-1][1], rtol=0, atol=1e-6)


def test_one_and_two_threads_agree(states, image):
    threads = torch.get_num_threads()
    ends = []
    try:
        for n in (1, 2):
            torch.set_num_threads(n)
            ends.append(fitted(image, start(2), settings=FitSettings(max_iterations=30)))
    finally:
        torch.set_num_threads(threads)
    one, two = ends
    assert one.iteration == two.iteration
    np.testing.assert_allclose(
        one.mesh.vertices_numpy(), two.mesh.vertices_numpy(), rtol=0, atol=1e-6
    )


# ------------------------------------------------------------------------ what is in the image


def test_missing_voxels(image):
    # A block that hides an eighth of the sphere.
    image = image.copy()
    image[12:, 16:, 16:] = np.nan
    last = fitted(image, start(2))
    assert last.converged
    assert np.isfinite(last.rendered()).all()
    z, y, x = last.mesh.vertices_numpy().T
    seen = ~((z > 1.1) & (y > 1.5) & (x > 1.5))
    off = np.linalg.norm(last.mesh.vertices_numpy()[seen] - CENTER, axis=1) - RADIUS
    assert np.abs(off).mean() < 0.1 * VOXEL


def neighbours():
    """The sphere beside another that is three times as bright; where the first one's ground is."""
    grid = Grid((24, 32, 56), GRID.voxel_size)
    z, y, x = CENTER
    other = sphere((z, y, x + 2.0), RADIUS, subdivisions=5)
    both = Mesh.merge([TRUTH, other])
    density = np.where((both.regions == 2).any(1), 3.0, 1.0)
    own = np.zeros(grid.shape, bool)
    own[:, :, :25] = True
    return grid, measured(grid, both, density=density), own


@pytest.mark.slow
def test_ground_that_does_not_count_does_not_pull():
    grid, image, own = neighbours()
    kept = fitted(image, start(2), grid, counted=own)
    assert kept.converged
    assert apart(kept.mesh) < 0.15
    pulled = fitted(image, start(2), grid, settings=FitSettings(max_iterations=150))
    assert apart(pulled.mesh) > 1


def test_tells_of_a_leak_at_the_last_level_too(image, monkeypatch):
    alarm = "napari_deltamic.fitting.surface.growth_alarm.GrowthAlarm.check"
    monkeypatch.setattr(alarm, lambda *_: "it leaks")
    settings = FitSettings(levels=(1.0,), max_iterations=24)
    messages = [s.message for s in fit(image, GRID, start(1), OPTICS, settings=settings)]
    assert messages[9] == "it leaks"
    assert messages[-1].endswith("; it leaks")


def test_a_fit_that_finds_nothing_does_not_say_converged():
    noise = np.random.default_rng(0).poisson(np.full(GRID.shape, 5.0))
    last = fitted(noise, start(2))
    assert not last.converged
    assert last.message.startswith("stuck")


@pytest.mark.slow
def test_a_cell_that_has_shrunk_does_not_make_the_others_stuck():
    lost = sphere((0.25, 0.25, 0.25), 0.12, subdivisions=1)  # where the image is dark
    settings = FitSettings(levels=(1.5, 1.0))
    last = fitted(measured(), Mesh.merge([start(), lost]), settings=settings)
    assert last.converged
    assert last.message.startswith("converged; cell 2 has shrunk to a point: place it anew")
    assert apart(last.mesh.region_surface(1)) < 0.05


def test_counted_may_be_any_mask(image):
    mask = np.ones(GRID.shape, bool)
    mask[:4] = False
    one = fitted(image, start(1), settings=SHORT, counted=mask)
    other = fitted(image, start(1), settings=SHORT, counted=mask.astype(np.uint8) * 255)
    np.testing.assert_allclose(one.mesh.vertices_numpy(), other.mesh.vertices_numpy(), atol=1e-9)


def test_refuses_an_image_with_nothing_to_go_by(image):
    nothing = np.zeros(GRID.shape, bool)
    with pytest.raises(InputError, match="voxel"):
        fitted(image, start(1), counted=nothing)
    with pytest.raises(InputError, match="shape"):
        fit(image, GRID, start(1), OPTICS, counted=nothing[1:])


def test_levels_without_voxels_are_left_out():
    grid = Grid((6, 7, 8), GRID.voxel_size)
    truth = sphere((0.25, 0.3, 0.35), 0.2, subdivisions=3)
    image = measured(grid, truth)
    mesh = sphere((0.25, 0.3, 0.35), 0.17, subdivisions=2)
    first = next(fit(image, grid, mesh, OPTICS))
    assert (first.iteration, first.level) == (1, 4)
    last = fitted(image, mesh, grid)
    assert last.converged
    assert apart(last.mesh, truth) < 0.1


def test_a_start_in_the_dark_is_no_crash():
    # Background-subtracted images hold exact zeros: nothing varies near this start.
    grid = Grid((24, 32, 64), GRID.voxel_size)
    image = (measured(grid) - 4).clip(0)
    far = sphere((1.15, 1.55, 5.2), 0.4, subdivisions=1)
    for likelihood in ("poisson", "gaussian", "paper"):
        settings = FitSettings(levels=(1.0,), likelihood=likelihood, max_iterations=5)
        with pytest.raises(InputError, match="image"):
            fitted(image, far, grid, settings=settings)


# --------------------------------------------------------------------------------- hard meshes


def test_degenerate_faces_and_slivers(image):
    mesh = start(2)
    vertices, faces = mesh.vertices_numpy(), mesh.faces
    a, b, c = faces[0]
    middle = (vertices[a] + vertices[b]) / 2
    needle = vertices[c] + 1e-9 * (vertices[a] - vertices[c])
    n = len(vertices)
    extra = [[a, b, n], [c, n + 1, b], [a, a, b], [b, b, b], faces[1]]
    mesh = Mesh(np.vstack([vertices, middle, needle]), np.vstack([faces, extra]))
    last = fitted(image, mesh)
    assert np.isfinite(last.mesh.vertices_numpy()).all()
    assert np.isfinite(last.loss)


def test_a_mesh_without_area_is_refused(image):
    with pytest.raises(InputError, match="area"):
        fitted(image, Mesh([CENTER] * 3, [[0, 1, 2]]), settings=SHORT)


# ------------------------------------------------------------------------------------ gradient


def test_gradient_of_the_whole_loss():
    # Amplitude and background are solved for anew in every difference: they hide nothing.
    target = torch.from_numpy(measured(noise=1).astype(np.float64))
    mesh = start(1)
    weights = 1 / (target.reshape(-1) + 1)

    def loss(vertices):
        image = render(mesh.with_vertices(vertices), GRID, OPTICS, accuracy=0)
        return match(image.reshape(-1), target.reshape(-1), weights)[0]

    vertices = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    loss(vertices).backward()
    way = torch.from_numpy(np.random.default_rng(0).normal(size=vertices.shape))
    step = 1e-5
    with torch.no_grad():
        slope = (loss(vertices + step * way) - loss(vertices - step * way)) / (2 * step)
    np.testing.assert_allclose(float((vertices.grad * way).sum()), float(slope), rtol=1e-6)


def test_noise_does_not_make_the_psf_vanish():
    noise = np.random.default_rng(3).poisson(40, size=GRID.shape)
    settings = FitSettings(fit_psf=True, levels=(1.0,), tolerance=1e-9, max_iterations=150)
    last = fitted(noise, start(2), settings=settings)
    assert min(last.optics.sigma_um) > 0.13 / 4.01
    assert max(last.optics.sigma_um) < 0.13 * 4.01
