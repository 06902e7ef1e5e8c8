"""What is read deep inside of cells, and dark insides that the image does not show."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting.deep_insides import (
    Cells,
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


@pytest.mark.parametrize("share", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_how_much_insides_vary_is_told_without_noise_and_membranes(share, noise):
    """With a bright rim, on a background of 2."""
    far = np.linalg.norm(np.moveaxis(np.indices(GRID.shape), 0, -1) * 0.2 - 3.1, axis=-1)
    rim = 5.0 * (abs(far - 1.8) < 0.4)
    known = noise * np.random.default_rng(0).standard_normal(GRID.shape)
    measured = 2 + np.where(far < 1.8, waves(share), 0) + rim + known
    found = variation(CELLS, measured, known, 2.0, EVERYWHERE)
    deep = waves(share)[CELLS.away > 2.5][CELLS.labels[CELLS.away > 2.5] == 1]
    seen = np.exp(-1.5 * (1.2 / 3) ** 2)  # exact, of these waves through the PSF
    assert found == pytest.approx(seen * np.std(deep) / deep.mean(), abs=0.02 + 0.2 * noise)


def test_cells_of_different_brightness_do_not_vary():
    two = nd.Mesh.merge([sphere((3.1, 3.1, z), 1.3, edge_length=0.3) for z in (1.6, 4.6)])
    cells = Cells(two, nd.GaussianPSF((0.16,) * 3), GRID)
    measured = np.where(cells.labels == 2, 3.0, 1.0) + 0.0 * waves(0)
    assert variation(cells, measured, np.zeros(GRID.shape), 0.0, EVERYWHERE) < 1e-3


def test_what_no_cell_has_deep_inside_is_not_told():
    nothing = np.zeros(GRID.shape)
    small = Cells(sphere((3.1, 3.1, 3.1), 0.7, edge_length=0.2), OPTICS, GRID)
    assert variation(small, nothing + 1, nothing, 0.0, EVERYWHERE) == np.inf
    assert variation(CELLS, nothing + 1, nothing, 0.0, ~EVERYWHERE) == np.inf
    assert variation(CELLS, nothing + np.nan, nothing, 0.0, EVERYWHERE) == np.inf
    assert variation(CELLS, nothing, nothing, 1.0, EVERYWHERE) == np.inf  # darker than that


def test_dark_insides_are_shown_or_not():
    model = image(-0.5)
    assert dark_insides_shown(CELLS, model, model, EVERYWHERE)[1] == pytest.approx(1)
    assert dark_insides_shown(CELLS, image(0.0), model, EVERYWHERE)[1] == pytest.approx(0, abs=0.1)
    assert dark_insides_shown(CELLS, model, image(0.5), EVERYWHERE) == {}


@pytest.mark.parametrize(("shown", "name"), [({1: 0.02}, "membrane"), ({1: 1.0}, "both")])
def test_a_fit_drops_dark_insides_that_the_image_does_not_show(shown, name, monkeypatch):
    """Both shine in this image, so that only what is tested here can take the insides away."""
    asked = []
    target = "napari_deltamic.fitting.fit_objective.dark_insides_shown"
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
