"""Distance from a mesh to the crest of the membrane, on blurred shells."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.ridge import _spots, ridge_distance
from numpy.typing import NDArray
from scipy import ndimage

from napari_deltamic import GaussianPSF, Grid, render
from napari_deltamic.errors import InputError
from napari_deltamic.geometry.mesh import Mesh
from napari_deltamic.geometry.primitives import sphere

SIZE = np.array([0.3, 0.15, 0.15])
SHAPE = (34, 64, 64)
CENTER = np.array([5.0, 4.7, 4.8])
RADIUS = 2.5


def shell(radius: float = RADIUS, width: float = 0.2) -> NDArray[np.float64]:
    x = np.stack(np.indices(SHAPE), axis=-1) * SIZE
    distance = np.linalg.norm(x - CENTER, axis=-1) - radius
    return 1000 * np.exp(-0.5 * (distance / width) ** 2)


@pytest.mark.parametrize("offset", [-0.4, -0.1, 0.0, 0.07, 0.4])
def test_offset_of_a_sphere(offset: float) -> None:
    mesh = sphere(CENTER, RADIUS - offset, edge_length=0.35)
    result = ridge_distance(mesh, shell(), SIZE)
    # Face centres lie inside the sphere of the vertices.
    centres = mesh.vertices_numpy()[mesh.faces].mean(axis=1)
    expected = RADIUS - np.linalg.norm(centres - CENTER, axis=1)
    assert result.found.all()
    assert np.abs(result.offset - expected).max() < 0.03
    assert np.abs(result.offset - expected)[result.lateral].max() < 0.01


def test_origin_and_reversed_normals() -> None:
    mesh = sphere(CENTER, RADIUS - 0.2, edge_length=0.4)
    plain = ridge_distance(mesh, shell(), SIZE)
    moved = ridge_distance(mesh.translated([3, 4, 5]), shell(), SIZE, (3, 4, 5))
    assert np.allclose(plain.offset, moved.offset)
    flipped = type(mesh)(mesh.vertices, mesh.faces[:, ::-1], mesh.regions[:, ::-1])
    assert np.allclose(ridge_distance(flipped, shell(), SIZE).offset, -plain.offset, atol=1e-6)


def test_lateral_and_axial_are_told_apart() -> None:
    mesh = sphere(CENTER, RADIUS, edge_length=0.35)
    result = ridge_distance(mesh, shell(), SIZE)
    assert np.array_equal(result.lateral, np.abs(mesh.normals()[:, 0]) < 0.5)
    summary = result.summary()
    assert summary["lateral_count"] + summary["axial_count"] == len(mesh.faces)
    assert summary["lateral_voxels"] == pytest.approx(summary["lateral_um"] / 0.15)
    assert summary["axial_voxels"] == pytest.approx(summary["axial_um"] / 0.3)


def test_noise_does_not_hide_the_ridge() -> None:
    image = shell() + np.random.default_rng(0).normal(100, 50, SHAPE)
    summary = ridge_distance(sphere(CENTER, 2.4, edge_length=0.35), image, SIZE).summary()
    assert summary["lateral_shift_um"] == pytest.approx(0.11, abs=0.03)
    assert summary["fraction_without_ridge"] < 0.1


def test_no_ridge_where_there_is_none() -> None:
    mesh = sphere(CENTER, RADIUS, edge_length=0.5)
    noise = np.random.default_rng(0).normal(100, 50, SHAPE)
    assert ridge_distance(mesh, noise, SIZE).found.mean() < 0.2
    slope = np.indices(SHAPE)[2] * 10.0
    empty = ridge_distance(mesh, slope, SIZE)
    assert not empty.found.any()
    assert empty.summary()["fraction_without_ridge"] == 1
    assert np.isnan(empty.summary()["lateral_um"])


def test_nearest_of_two_membranes_counts() -> None:
    image = shell(2.0, 0.12) + 3 * shell(2.8, 0.12)
    mesh = sphere(CENTER, 2.1, edge_length=0.3)
    result = ridge_distance(mesh, image, SIZE)
    assert np.median(result.offset[result.found & result.lateral]) == pytest.approx(-0.1, abs=0.03)


def test_faces_near_the_border_are_left_out() -> None:
    mesh = sphere((5, 4.7, 0.5), 1.0, edge_length=0.3)
    centres = mesh.vertices_numpy()[mesh.faces].mean(axis=1)
    result = ridge_distance(mesh, shell(), SIZE)
    assert not result.found[centres[:, 2] < -0.1].any()


def test_a_plane_across_z_gives_axial_offsets() -> None:
    x = np.indices(SHAPE)[0] * SIZE[0]
    image = ndimage.gaussian_filter(1000 * np.exp(-0.5 * ((x - 5.1) / 0.4) ** 2), 0.1)
    mesh = sphere(CENTER, (0.3, 3.0, 3.0), edge_length=0.5)
    result = ridge_distance(mesh, image, SIZE)
    top = mesh.normals()[:, 0] > 0.97
    heights = mesh.vertices_numpy()[mesh.faces].mean(axis=1)[top, 0]
    assert np.abs(heights + result.offset[top] * mesh.normals()[top, 0] - 5.1).max() < 0.02


@pytest.mark.parametrize(
    ("image", "size", "reach"),
    [
        (np.zeros((4, 4)), SIZE, 0.5),
        (np.full((4, 4, 4), np.inf), SIZE, 0.5),
        (np.zeros((4, 4, 4)), (1, 1), 0.5),
        (np.zeros((4, 4, 4)), (1, -1, 1), 0.5),
        (np.zeros((4, 4, 4)), SIZE, 0.0),
    ],
)
def test_bad_input(image: NDArray[np.float64], size: tuple[float, ...], reach: float) -> None:
    with pytest.raises(InputError):
        ridge_distance(sphere(CENTER, 1.0), image, size, reach_um=reach)


@pytest.mark.parametrize(("voxel", "count"), [(0.1, 9), (0.25, 4), (1.0, 1)])
def test_lines_lie_evenly_over_a_face(voxel, count):
    spots = _spots(Mesh([(0, 0, 0), (0, 1, 0), (0, 0.5, 0.87)], [(0, 1, 2)]), voxel)
    assert len(spots) == count
    assert (spots > 0).all()
    assert np.allclose(spots.sum(1), 1)
    assert np.allclose(spots.mean(0), 1 / 3)


def test_the_ridge_of_its_own_image_tells_what_blur_does() -> None:
    grid = Grid(SHAPE, tuple(SIZE))
    optics = GaussianPSF((0.4, 0.15, 0.15))

    def rendered(mesh: Mesh) -> NDArray[np.float64]:
        return render(mesh, grid, optics, 1e-3).numpy()

    truth, larger = (sphere(CENTER, r, edge_length=0.2) for r in (1.3, 1.35))
    image = rendered(truth)
    plain = ridge_distance(truth, image, SIZE)
    # A right shape lies outside of the ridge of its image.
    assert plain.summary()["lateral_shift_um"] < -0.03
    assert plain.beyond(plain).summary()["lateral_um"] == 0
    off = ridge_distance(larger, image, SIZE)
    beyond = off.beyond(ridge_distance(larger, rendered(larger), SIZE))
    assert beyond.summary()["lateral_shift_um"] == pytest.approx(-0.05, abs=0.01)
    with pytest.raises(InputError, match="one mesh"):
        off.beyond(ridge_distance(sphere(CENTER, 1.3, edge_length=0.4), image, SIZE))
