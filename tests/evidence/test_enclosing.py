"""Membranes that enclose a cell and belong to none."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from napari_deltamic import GaussianPSF, Grid
from napari_deltamic.evidence.enclosing import enclosing_membranes
from napari_deltamic.fitting.objective.deep_insides import Cells
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.labels.meshes import mesh_from_labels

SIZE, SIGMA = (0.3, 0.2, 0.2), (0.45, 0.2, 0.2)
GRID = Grid((44, 60, 60), SIZE, (1.0, 0.0, 0.0))
Z, Y, X = np.meshgrid(
    *(o + np.arange(n) * d for n, d, o in zip(GRID.shape, SIZE, GRID.origin, strict=True)),
    indexing="ij",
)
MIDDLE = np.array([7.5, 6.0, 6.0])  # um
OPTICS, GROUND = GaussianPSF(SIGMA), 20.0
NUCLEUS = sphere(MIDDLE, 2.0, edge_length=0.4)


def away(right: float = 0.0) -> np.ndarray:
    """(Z, Y, X) um from the middle, or from a place to its right."""
    return np.sqrt((Z - MIDDLE[0]) ** 2 + (Y - MIDDLE[1]) ** 2 + (X - MIDDLE[2] - right) ** 2)


def shell(radius: float, right: float = 0.0) -> np.ndarray:
    """(Z, Y, X) a membrane a voxel thick; the sum across it is 1."""
    return np.clip(1 - np.abs(away(right) - radius) / 0.25, 0, None)


def seen(light: np.ndarray, photons: float = 400.0) -> np.ndarray:
    """Through the PSF."""
    blurred = gaussian_filter(light.astype(float), np.divide(SIGMA, SIZE))
    return np.random.default_rng(0).poisson(GROUND + photons * blurred).astype(float)


def found(image: np.ndarray, mesh=NUCLEUS) -> dict[int, float]:
    return enclosing_membranes(Cells(mesh, OPTICS, GRID), image, GROUND)


@pytest.mark.parametrize("faint", [0.1, 0.3, 0.8])
def test_the_membrane_around_a_faint_nuclear_envelope_is_told(faint):
    around = found(seen(shell(4.5) + faint * shell(2.0)))
    assert list(around) == [1]
    assert around[1] == pytest.approx(1 / faint, rel=0.2)


@pytest.mark.parametrize("right", [0.9, 1.7, 2.2])
def test_a_nucleus_beside_the_middle_of_its_cell_is_enclosed_even_if_it_touches(right):
    around = found(seen(shell(4.6, right) + 0.2 * shell(2.0)))
    assert around[1] == pytest.approx(5.0, rel=0.2)


def test_one_that_is_not_seen_everywhere_does_not_enclose():
    image = seen(shell(4.5) + 0.2 * shell(2.0))
    assert found(np.where(Y < 6.0, np.nan, image)) == {}
    assert found(np.full(GRID.shape, np.nan)) == {}
    assert found(seen(shell(4.5) * (Y < 7.0) + 0.2 * shell(2.0))) == {}


@pytest.mark.parametrize(
    "beside",
    [
        np.zeros(GRID.shape),
        0.5 * shell(4.5),  # a fainter one
        3.0 * shell(2.4),  # its own, as its surface is off by a width
        3.0 * shell(2.0, 4.2),  # a neighbour that touches, and another
        3.0 * (shell(2.0, 4.2) + shell(2.0, -4.2)),
        2.0 * (away() > 2.3),  # a bright medium
        2.0 * (away() > 4.5),  # one beyond a gap
        2.0 * ((away() > 2.3) & (away() < 4.5)),  # a bright cytoplasm
    ],
)
def test_other_things_do_not_enclose(beside):
    assert found(seen(beside + shell(2.0))) == {}


def test_the_membrane_of_a_fitted_cell_is_no_other():
    labels = np.where(away() < 2.0, 1, np.where(away() < 4.5, 2, 0))
    both = mesh_from_labels(labels, SIZE, origin=GRID.origin)
    assert found(seen(3 * shell(4.5) + shell(2.0)), both) == {}


@pytest.mark.parametrize("dim", [0.3, 0.6, 1.0])
def test_cells_of_a_tissue_without_labels_do_not_enclose(dim):
    """Their walls among each other are brighter than those of a dim cell, and all around it."""
    rng, reach = np.random.default_rng(1), np.array([[0.0, 0.0, 0.0]])
    while len(reach) < 60:  # places at least 3.4 um apart
        place = rng.uniform(-8, 8, 3)
        if np.linalg.norm(reach - place, axis=1).min() > 3.4:
            reach = np.vstack([reach, place])
    places = np.stack([Z, Y, X], -1) - MIDDLE
    (one, two), cell = (a.transpose(3, 0, 1, 2) for a in cKDTree(reach).query(places, 2))
    wall = np.clip(1 - (two - one) / 0.5, 0, None)
    mesh = mesh_from_labels((cell[0] == 0).astype(int), SIZE, origin=GRID.origin)
    assert found(seen(np.where((cell == 0).any(0), dim, 1.0) * wall), mesh) == {}
