"""The error of fitted surfaces at several accuracies."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.accuracy.shape_error import (
    ShapeError,
    enough,
    photons_for,
    shape_errors,
    shrunk,
    simulated,
)
from napari_deltamic.fitting.model.default_accuracy import image_noise
from napari_deltamic.fitting.shape_dial import Dialled
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.fit_settings import SHAPE_CHOICES
from napari_deltamic.runs.settings import NEAR_LEVELS, FitSettings

GRID = nd.Grid((20, 22, 24), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF(0.3)
TRUTH = sphere((1.9, 2.1, 2.3), 1.1, subdivisions=2)
SHORT = FitSettings(levels=NEAR_LEVELS, max_iterations=50, fit_psf=False)


def test_simulated_images():
    image = simulated(TRUTH, GRID, OPTICS, 100, seed=0)
    assert image.shape == GRID.shape
    assert np.array_equal(image, simulated(TRUTH, GRID, OPTICS, 100, seed=0))
    assert not np.array_equal(image, simulated(TRUTH, GRID, OPTICS, 100, seed=1))
    assert image.max() == pytest.approx(110, rel=0.35)
    assert np.percentile(image, 2) < 20
    clean = simulated(TRUTH, GRID, OPTICS, float("inf"), seed=0)
    assert clean.min() == pytest.approx(0.1, abs=0.02)
    assert abs((image / 100 - clean).mean()) < 0.01


def test_photons_for_a_noise():
    for photons in (20.0, 500.0):
        noise = image_noise(simulated(TRUTH, GRID, OPTICS, photons, seed=0))
        found = photons_for(noise, TRUTH, GRID, OPTICS)
        assert found == pytest.approx(photons, rel=0.5)
        again = image_noise(simulated(TRUTH, GRID, OPTICS, found, seed=0))
        assert again == pytest.approx(noise, rel=0.2)
    assert photons_for(0.0, TRUTH, GRID, OPTICS) == float("inf")


def test_shape_errors_fall_along_the_dial():
    """Of a ball whose edges are long: flat triangles are what is off."""
    truth = sphere((1.9, 2.1, 2.3), 1.3, edge_length=0.15)
    start = sphere((1.9, 2.1, 2.3), 1.2, edge_length=0.5)
    seen = []
    found = list(
        shape_errors(
            truth, GRID, OPTICS, 1000, start=start, settings=SHORT, choices=("quick", "careful"),
            draws=2, progress=lambda done, of: seen.append((done, of)),
        )
    )  # fmt: skip
    assert [e.choice for e in found] == ["quick", "careful"]
    assert [len(e.errors) for e in found] == [2, 2]
    quick, careful = found
    assert quick.dialled.edge > careful.dialled.edge
    assert quick.dialled.predicted > careful.dialled.predicted
    assert quick.mean > 1.3 * careful.mean
    assert careful.mean < 0.2 * GRID.voxel_size[0]
    assert 0 < careful.spread < careful.mean
    assert quick.seconds > 0
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert enough(found) == "careful"


def test_shape_errors_need_an_image():
    with pytest.raises(nd.InputError, match="draw"):
        next(shape_errors(TRUTH, GRID, OPTICS, 100, draws=0))


def test_a_surface_outside_the_image():
    far = TRUTH.translated((0.0, 0.0, 40.0))
    with pytest.raises(nd.InputError, match="empty"):
        simulated(far, GRID, OPTICS, 100, seed=0)


def errors(*means):
    took = Dialled(0.3, 1e-2, 0.02, 1.0)
    given = zip(SHAPE_CHOICES, means, strict=False)
    return [ShapeError(c, took, (m,), 1, n) for n, (c, m) in enumerate(given)]


def test_what_is_enough():
    assert enough(errors(3.0, 1.04, 1.0)) == "normal"
    assert enough(errors(1.04, 1.06, 1.0)) == "quick"
    assert enough(errors(1.2, 1.06, 1.0)) == "careful"
    with pytest.raises(nd.InputError, match="no choice"):
        enough([])


def test_one_draw_has_no_spread():
    took = Dialled(0.3, 1e-2, 0.02, 1.0)
    assert ShapeError("quick", took, (3.0,), 1, 1).spread == 0
    assert ShapeError("quick", took, (3.0, 5.0), 1, 1).mean == 4


def test_shrunk_about_each_piece():
    other = sphere((1.0, 1.0, 9.0), 0.5, subdivisions=1)
    both = shrunk(nd.Mesh.merge([TRUTH, other]))
    one = both.vertices[: len(TRUTH.vertices)]
    two = both.vertices[len(TRUTH.vertices) :]
    assert np.allclose(one.mean(0), TRUTH.vertices.mean(0))
    assert np.linalg.norm(one - one.mean(0), axis=1) == pytest.approx(0.9 * 1.1)
    assert np.linalg.norm(two - two.mean(0), axis=1) == pytest.approx(0.9 * 0.5)
