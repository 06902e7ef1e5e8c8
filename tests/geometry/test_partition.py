"""Meshes of touching regions with shared walls."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from napari_deltamic import InputError
from napari_deltamic.geometry.labels import partition
from napari_deltamic.geometry.labels.dual_net import dual_net
from napari_deltamic.geometry.labels.partition import partition_mesh, with_volumes

ONE, ZERO = np.ones(3), np.zeros(3)


def clump(n, seed=0, side=48, radius=9.0):
    """Labels of n cells that touch, in a union of balls."""
    grid = np.stack(np.indices((side,) * 3), -1).astype(float)
    rng = np.random.default_rng(seed)
    centers = side / 2 + rng.normal(size=(n, 3)) * side / 8
    for _ in range(40):
        apart = centers[:, None] - centers[None]
        far = np.linalg.norm(apart, axis=-1) + 100 * np.eye(n)
        push = np.clip(1.4 * radius - far, 0, None)
        centers += 0.2 * (apart / far[..., None] * push[..., None]).sum(1)
    square = np.stack([((grid - c) ** 2).sum(-1) for c in centers])
    return np.where(square.min(0) < radius**2, square.argmin(0) + 1, 0)


def contacts(labels):
    """Pairs of labels with at least 12 voxel faces between them."""
    found = set()
    for axis in range(3):
        a = np.moveaxis(labels, axis, 0)
        pairs = np.sort(np.stack([a[:-1].ravel(), a[1:].ravel()], 1), 1)
        pairs, counts = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0, return_counts=True)
        found |= {tuple(p) for p, c in zip(pairs, counts, strict=True) if c >= 12}
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("edge", [1.5, 2.5, 4.0])
def test_every_region_is_closed_and_no_four_walls_meet(seed, edge):
    labels = clump([3, 5, 8, 12][seed], seed)
    mesh = partition_mesh(labels, ONE, ZERO, edge)
    assert mesh.is_closed()
    assert set(np.unique(mesh.edge_uses())) <= {2, 3}
    assert_array_equal(mesh.region_ids(), np.unique(labels)[1:])
    for k in mesh.region_ids():
        volume = (labels == k).sum()
        assert_allclose(mesh.region_volume(k), volume, rtol=0.1 * edge / 1.5)
    pairs = {tuple(sorted(p)) for p in mesh.interfaces()[0]}
    assert contacts(labels) <= pairs


def test_lies_where_the_labels_do_in_um():
    labels = np.zeros((20, 30, 40), int)
    labels[4:16, 6:15, 8:30], labels[4:16, 15:24, 8:30] = 5, 9
    size, origin = np.array([0.5, 0.2, 0.25]), np.array([10.0, -3.0, 7.0])
    mesh = partition_mesh(labels, size, origin, 0.3)
    wall = mesh.faces[(np.sort(mesh.regions, 1) == (5, 9)).all(1)]
    middle = mesh.vertices_numpy()[wall].mean((0, 1))
    assert_allclose(middle, origin + size * (9.5, 14.5, 18.5), atol=0.1)
    # Two regions lie on their sides of the wall.
    for k, side in ((5, -1), (9, 1)):
        own = mesh.vertices_numpy()[mesh.faces[(mesh.regions == k).any(1)]].mean((0, 1))
        assert side * (own - middle)[1] > 0.3


def test_regions_that_touch_in_an_edge_or_a_corner_only():
    labels = np.zeros((24, 24, 24), int)
    labels[2:12, 2:12, 2:12] = 1
    labels[12:22, 12:22, 2:12] = 2  # along an edge of the first
    labels[12:22, 12:22, 12:22] = 1  # at a corner of its own
    mesh = partition_mesh(labels, ONE, ZERO, 1.0)
    assert mesh.is_closed()
    assert set(np.unique(mesh.edge_uses())) <= {2, 3}


def test_no_four_walls_meet_among_labels_as_small_as_two_edges():
    places = np.random.default_rng(4).uniform(2, 28, (40, 3))
    away = np.linalg.norm(np.moveaxis(np.indices((30,) * 3), 0, -1)[..., None, :] - places, axis=-1)
    labels = np.where(away.min(-1) < 7.5, away.argmin(-1) + 1, 0)
    assert set(np.unique(partition_mesh(labels, ONE, ZERO, 3.0).edge_uses())) <= {2, 3}


def test_a_checkerboard_ends():
    labels = np.indices((6, 6, 6)).sum(0) % 3
    mesh = partition_mesh(np.kron(labels, np.ones((2, 2, 2), int)), ONE, ZERO, 1.0)
    assert mesh.is_closed()


def test_a_hole_in_a_region_is_a_wall_to_the_outside():
    labels = np.zeros((30, 30, 30), int)
    labels[4:26, 4:26, 4:26] = 1
    labels[10:20, 10:20, 10:20] = 0
    mesh = partition_mesh(labels, ONE, ZERO, 2.0)
    assert_allclose(mesh.region_volume(1), 22**3 - 10**3, rtol=0.05)


def test_labels_at_the_border_are_closed():
    mesh = partition_mesh(np.ones((8, 8, 8), int), ONE, ZERO, 1.5)
    assert mesh.is_closed()
    assert_allclose(mesh.region_volume(1), 512, rtol=0.25)


def test_too_fine_or_too_coarse():
    labels = np.zeros((10, 10, 10), int)
    labels[4:6, 4:6, 4:6] = 1
    with pytest.raises(InputError, match="too short"):
        partition_mesh(labels, ONE, ZERO, 0.01)
    with pytest.raises(InputError, match="large enough"):
        partition_mesh(labels, ONE, ZERO, 12.0)


def test_regions_get_their_volumes():
    labels = clump(8, 2)
    mesh = partition_mesh(labels, ONE, ZERO, 3.0)
    wanted = {int(k): float((labels == k).sum()) for k in mesh.region_ids()}
    full = with_volumes(mesh, wanted)
    for k, volume in wanted.items():
        assert_allclose(full.region_volume(k), volume, rtol=2e-3)
    moved = np.linalg.norm(full.vertices_numpy() - mesh.vertices_numpy(), axis=1)
    assert moved.max() < 2.0


def test_a_node_for_which_one_label_alone_competes_may_lie_beside_another():
    """As repairs of a thousand crowded labels made it: between two leads without an end, the
    crossing was no number."""
    nodes = partition._Nodes(np.zeros(3), np.array([5, 5, 5]))
    everywhere = (slice(None),) * 3
    nodes.enter(0, everywhere, np.ones((5, 5, 5)))
    nodes.best[2, 2, 2] = 1
    vertices, quads, _ = dual_net(nodes.best, nodes.lead(edge=2.0))
    assert len(quads) == 6
    assert np.isfinite(vertices).all()
