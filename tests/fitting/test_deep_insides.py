"""What is read deep inside of cells, and dark insides that the image does not show."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting.model_choice import ModelChoice
from napari_deltamic.fitting.objective.deep_insides import (
    UNKNOWN,
    Cells,
    cells_in_their_box,
    dark_insides_shown,
    deep_brightness,
    variation,
)
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.light import Light, structure_of

GRID = nd.Grid((32, 32, 32), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF((0.24, 0.24, 0.24))
BALL = sphere((3.1, 3.1, 3.1), 1.8, edge_length=0.3)
CELLS = Cells(BALL, OPTICS, GRID)
EVERYWHERE = np.ones(GRID.shape, bool)


def image(interior: float) -> np.ndarray:
    """Of a membrane and an inside, on a background of 2 membranes."""
    light = Light(1.0, interior)
    shown = nd.scene.expected_image(BALL, GRID, OPTICS, 1e-3, 1.0, 0.0, light=light)
    return np.asarray(shown / np.ptp(shown) + 2, np.float32)


@pytest.mark.parametrize("interior", [0.0, 0.5, -0.5])
def test_insides_are_read_beside_the_outside(interior):
    found = deep_brightness(CELLS, image(interior), EVERYWHERE)[1]
    assert np.sign(round(found, 2)) == np.sign(interior)
    missing = image(interior)
    missing[16:] = np.nan
    assert deep_brightness(CELLS, missing, EVERYWHERE)[1] == pytest.approx(found, abs=0.02)
    assert deep_brightness(CELLS, missing, ~EVERYWHERE) == {}


def test_without_a_deep_inside_or_outside_nothing_is_read():
    small = Cells(sphere((3.1, 3.1, 3.1), 0.4, edge_length=0.2), OPTICS, GRID)
    assert deep_brightness(small, image(0.5), EVERYWHERE) == {}
    assert deep_brightness(CELLS, image(0.5), EVERYWHERE, far=2.0) == {}


def waves(share: float) -> np.ndarray:
    """(Z, Y, X) around 1, with this standard deviation."""
    z, y, x = np.indices(GRID.shape)
    return 1 + share * np.sqrt(8) * np.sin(z / 3) * np.sin(y / 3) * np.sin(x / 3)


SEEN = np.exp(-1.5 * (1.2 / 3) ** 2)  # exact: what the PSF leaves of these waves


def uneven(share: float, rim: float = 0.0) -> np.ndarray:
    """(Z, Y, X) of a ball, on a background of 2."""
    far = np.linalg.norm(np.moveaxis(np.indices(GRID.shape), 0, -1) * 0.2 - 3.1, axis=-1)
    return 2 + np.where(far < 1.8, waves(share), 0) + rim * (abs(far - 1.8) < 0.4)


def true(share: float) -> float:
    """What is to be found, through the PSF."""
    deep = waves(share)[(CELLS.away > 2.5) & (CELLS.labels == 1)]
    return float(SEEN * np.std(deep) / np.mean(deep))


@pytest.mark.parametrize("share", [0.1, 0.2])
@pytest.mark.parametrize("rim", [0.0, 5.0])
def test_how_much_insides_vary_is_told_beside_a_bright_rim(share, rim):
    """Two standard errors are taken off or added: of some ten places."""
    least, most = variation(CELLS, uneven(share, rim), 2.0, EVERYWHERE)
    assert 1.2 * true(share) < most < 1.6 * true(share)
    assert least < 0.8 * true(share)
    assert variation(CELLS, uneven(0.0, rim), 2.0, EVERYWHERE)[1] < 0.01


def test_how_much_insides_surely_vary_is_told_where_cells_have_many_places():
    """A narrow PSF: of hundreds of them."""
    cells = Cells(BALL, nd.GaussianPSF((0.12,) * 3), GRID)
    least, most = variation(cells, uneven(0.2), 2.0, EVERYWHERE)
    deep = waves(0.2)[(cells.away > 2.5) & (cells.labels == 1)]
    seen = np.exp(-1.5 * (0.6 / 3) ** 2) * float(np.std(deep) / np.mean(deep))
    assert 0.6 * seen < least < seen < most < 1.3 * seen


def test_noise_is_no_variation():
    """It adds to the bound what is not known of it: not as much as it looks like. None is sure."""
    cells = Cells(BALL, nd.GaussianPSF((0.16,) * 3), GRID)
    noisy = uneven(0.0) + np.random.default_rng(0).standard_normal(GRID.shape)
    alone = 1 / np.sqrt((2 * np.sqrt(np.pi) * 0.8) ** 3)
    least, most = variation(cells, noisy, 2.0, EVERYWHERE)
    assert least == 0
    assert 0.4 * alone < most < alone


@pytest.mark.parametrize("gaps", ["scattered", "plane"])
def test_what_is_missing_is_no_noise(gaps):
    """It is 0 in the image: less than the background by 100."""
    known = np.random.default_rng(0).random(GRID.shape) > 0.05
    if gaps == "plane":
        known[...] = True
        known[:, :, 15] = False
    measured = np.where(known, uneven(0.2) + 100, 0.0)
    _, whole = variation(CELLS, uneven(0.2) + 100, 102.0, EVERYWHERE)
    assert variation(CELLS, measured, 102.0, known)[1] == pytest.approx(whole, rel=0.15)


def balls(radius: float, apart: float, n: int) -> nd.Mesh:
    places = np.stack(np.meshgrid(*[np.arange(n) * apart + apart / 2] * 3), -1).reshape(-1, 3)
    return nd.Mesh.merge([sphere(tuple(place), radius, edge_length=0.4) for place in places])


def test_many_cells_do_not_tell_what_each_is_too_small_for():
    """Each mean is taken off: of a cell with one place, nothing would be left."""
    grid = nd.Grid((48, 48, 48), (0.2, 0.2, 0.2))
    many = Cells(balls(0.95, 2.1, 4), nd.GaussianPSF((0.22,) * 3), grid)
    chromatin = 1 + 0.3 * np.random.default_rng(0).standard_normal(grid.shape)
    everywhere = np.ones(grid.shape, bool)
    assert (many.away > 2.5)[many.labels > 0].sum() > 500
    assert variation(many, chromatin, 0.0, everywhere) == UNKNOWN


@pytest.mark.parametrize("dim", [1.0, 0.3, 0.01, -0.01])
def test_cells_of_different_brightness_do_not_vary(dim):
    two = nd.Mesh.merge([sphere((3.1, 3.1, z), 1.3, edge_length=0.3) for z in (1.6, 4.6)])
    cells = Cells(two, nd.GaussianPSF((0.16,) * 3), GRID)
    noise = 0.05 * np.random.default_rng(0).standard_normal(GRID.shape)
    measured = np.where(cells.labels == 2, 3.0, 3.0 * dim) + noise
    assert variation(cells, measured, 0.0, EVERYWHERE)[1] < 0.01


def test_what_no_cell_has_deep_inside_is_not_told():
    nothing = np.zeros(GRID.shape)
    small = Cells(sphere((3.1, 3.1, 3.1), 0.7, edge_length=0.2), OPTICS, GRID)
    assert variation(small, nothing + 1, 0.0, EVERYWHERE) == UNKNOWN
    assert variation(CELLS, nothing + 1, 0.0, ~EVERYWHERE) == UNKNOWN
    assert variation(CELLS, nothing, 1.0, EVERYWHERE) == UNKNOWN  # darker than that


def test_an_even_cell_that_the_border_cuts_does_not_vary():
    nothing = np.zeros(GRID.shape)
    beside = BALL.with_vertices(BALL.vertices_numpy() + np.array([0, 2.5, 0]))
    assert variation(Cells(beside, OPTICS, GRID), nothing + 1, 0.0, EVERYWHERE)[1] < 1e-6


@pytest.mark.parametrize("moved", [0.0, 2.5, 50.0])
def test_cells_in_their_box_are_those_of_the_whole_grid(moved):
    beside = BALL.with_vertices(BALL.vertices_numpy() + np.array([0, moved, 0]))
    grid = nd.Grid(GRID.shape, GRID.voxel_size, (0.1, 0.0, -0.1))
    whole = Cells(beside, OPTICS, grid)
    cells, box = cells_in_their_box(beside, OPTICS, grid)
    np.testing.assert_array_equal(whole.labels[box], cells.labels)
    assert (whole.labels > 0).sum() == (cells.labels > 0).sum()
    if moved < 50:  # else no cell is in the image
        np.testing.assert_allclose(whole.away[box], cells.away)
    assert cells.labels.size < whole.labels.size


def varies_in_a_fit(image: np.ndarray, monkeypatch) -> tuple[float, float]:
    """Where a fit of both first comes to rest."""
    found = []

    def at_rest(terms, objective, fitted, factored):
        found.append(objective.insides_vary())
        assert objective.insides_vary() == found[-1]
        return fitted, 0

    monkeypatch.setattr(ModelChoice, "_at_rest", staticmethod(at_rest))
    settings = FitSettings(structure="auto", fit_psf=False)
    states = nd.fit(image, GRID, BALL, OPTICS, settings=settings)
    last = next(state for state in states if found)
    assert structure_of(last.light) == "both"
    return found[0]


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.2])
def test_a_fit_knows_by_how_much_its_insides_vary(share, monkeypatch):
    """Of the peak of a membrane's image, which is as bright as the insides here."""
    inside = Light(0.0, 1.0), Light(1.0, 0.0)
    given = GRID, OPTICS, 1e-3, 1.0, 0.0
    filled, rim = (nd.scene.expected_image(BALL, *given, light=one) for one in inside)
    shown = waves(share) * filled / filled.max() + rim / rim.max()
    noisy = np.random.default_rng(0).poisson(300 * (shown - shown.min()) + 20).astype(np.float32)
    least, most = varies_in_a_fit(noisy, monkeypatch)
    assert least <= true(share) <= most < 0.03 + 1.7 * true(share)
    noisy = np.minimum(noisy, np.percentile(noisy, 99))
    assert varies_in_a_fit(noisy, monkeypatch) == UNKNOWN


def test_dark_insides_are_shown_or_not():
    model = image(-0.5)
    assert dark_insides_shown(CELLS, model, model, EVERYWHERE)[1] == pytest.approx(1)
    assert dark_insides_shown(CELLS, image(0.0), model, EVERYWHERE)[1] == pytest.approx(0, abs=0.1)
    assert dark_insides_shown(CELLS, model, image(0.5), EVERYWHERE) == {}


@pytest.mark.parametrize(
    ("shown", "name"),
    [({1: 0.02}, "membrane"), pytest.param({1: 1.0}, "both", marks=pytest.mark.slow)],
)
def test_a_fit_drops_dark_insides_that_the_image_does_not_show(shown, name, monkeypatch):
    """Both shine in this image, so that only what is tested here can take the insides away."""
    asked = []
    target = "napari_deltamic.fitting.objective.fit_objective.dark_insides_shown"
    monkeypatch.setattr(target, lambda *given: asked.append(given) or shown)
    noisy = np.random.default_rng(0).poisson(60 * image(-0.5)).astype(np.float32)
    start = sphere((3.0, 3.2, 3.1), 1.6, edge_length=0.3)
    *_, last = nd.fit(noisy, GRID, start, OPTICS, settings=FitSettings(structure="auto"))
    assert structure_of(last.light) == name
    assert asked


def test_names_of_cells_may_be_large():
    name = 3_000_000_000
    one = CELLS.mesh
    named = Mesh(one.vertices_numpy(), one.faces, one.regions * name)
    cells = Cells(named, CELLS.optics, CELLS.grid)
    found = deep_brightness(cells, image(0.5), EVERYWHERE)
    assert list(found) == [name]
    assert found[name] == deep_brightness(CELLS, image(0.5), EVERYWHERE)[1]
