"""At the end of a fit other arrangements are tried, and kept where the image speaks for them."""

import warnings

import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid, Mesh, fit, render
from napari_deltamic.geometry import remesh
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.geometry.topology.flips import flipped
from napari_deltamic.geometry.topology.small_pieces import absorbed, small_pieces
from napari_deltamic.geometry.topology.thin_places import short_junctions, small_walls
from napari_deltamic.inference.topology import TopologyKeeper
from napari_deltamic.settings import FitSettings

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
VOXEL, EDGE = 0.15, 0.25
OPTICS = GaussianPSF(0.2)
SETTINGS = FitSettings(levels=(1.0,))


def contacts(mesh):
    return {(int(min(p)), int(max(p))) for p in mesh.interfaces()[0] if min(p) > 0}


def photographed(truth):
    """Image with a peak of 40 photons, noise included, and its grid."""
    low, high = truth.bounds() + np.array([[-0.6], [0.6]])
    shape = tuple(int(n) for n in np.ceil((high - low) / VOXEL) + 1)
    grid = Grid(shape, (VOXEL,) * 3, tuple(low))
    image = render(truth, grid, OPTICS, 1e-4).numpy().astype(np.float64)
    image = 2 + 40 * image.clip(0) / image.max()
    return np.random.default_rng(0).poisson(image), grid


def fitted(truth, start):
    image, grid = photographed(truth)
    states = list(fit(image, grid, start, OPTICS, settings=SETTINGS))
    assert states[-1].converged
    return states, "; ".join(e for s in states for e in s.events)


def five(half):
    """Cells 1 and 2 at the ends of a junction of three others, or through it if they are near."""
    turns = 2 * np.pi * np.arange(3) / 3 + 0.3
    around = 0.8 * np.stack([0 * turns, np.sin(turns), np.cos(turns)], axis=1)
    ends = np.array([[-half, 0.02, 0.01], [half, 0, 0]])
    return foam(np.concatenate([ends, around]), np.full(5, 1.15), 0.15)


def flip_of(mesh):
    """Its coarser start, in which cells 1 and 2 touch where they should not, or the reverse."""
    mesh = remesh(mesh, EDGE).mesh
    if (1, 2) in contacts(mesh):
        (place,) = [p for p in small_walls(mesh, 1.0) if p.regions == (1, 2)]
    else:
        (place,) = [p for p in short_junctions(mesh, 1.0) if p.sides == (1, 2)]
    made = flipped(mesh, place, EDGE)
    assert contacts(made) ^ contacts(mesh) == {(1, 2)}
    return made


@pytest.mark.parametrize("half", [0.68, 0.9])
def test_a_wrong_neighbour_is_exchanged(half):
    truth = five(half)
    states, told = fitted(truth, flip_of(truth))
    assert contacts(states[-1].mesh) == contacts(truth)
    assert told


@pytest.mark.parametrize("half", [0.68, 0.9])
def test_right_neighbours_stay(half):
    truth = five(half)
    states, told = fitted(truth, remesh(truth, EDGE).mesh)
    assert contacts(states[-1].mesh) == contacts(truth)
    assert told == ""


def with_gap(size):
    """Four cells around a gap, which is a fifth one taken away."""
    corners = 1.2 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the tips of the fifth
        mesh = foam(np.concatenate([corners, [[0, 0, 0]]]), np.array([*4 * [1.25], size]), 0.15)
    return Mesh(mesh.vertices, mesh.faces, np.where(mesh.regions == 5, 0, mesh.regions))


def test_a_gap_that_is_not_in_the_image_closes():
    begun = with_gap(0.75)
    (gap,) = small_pieces(begun, 0.5)
    truth = remesh(absorbed(begun, gap, 0.15), 0.15).mesh
    states, told = fitted(truth, begun)
    assert not small_pieces(states[-1].mesh, 0.5)
    assert "has closed" in told


def test_a_gap_that_is_in_the_image_stays():
    truth = with_gap(0.75)
    (gap,) = small_pieces(truth, 0.5)
    assert gap.volume < 4 / 3 * np.pi * 0.4**3  # or it would not even be tried
    states, told = fitted(truth, remesh(truth, EDGE).mesh)
    assert small_pieces(states[-1].mesh, 0.5)
    assert "closed" not in told


def test_losses_of_another_level_do_not_count():
    keeper = TopologyKeeper()
    keeper.forgets([0.1] * 4)
    keeper.level_ends(None)
    assert keeper._loss == np.inf
