import numpy as np
import pytest
from test_mesh import two_cubes

from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.labels.voxels import ranked, voxel_labels


def test_voxels_of_two_cubes_that_share_a_wall():
    # Voxel centres at 0.125, 0.375, ... in the cubes; one row of voxels around them.
    labels = voxel_labels(two_cubes(), (6, 6, 10), (0.25,) * 3, (-0.125,) * 3)
    expected = np.zeros((6, 6, 10), int)
    expected[1:5, 1:5, 1:5] = 1
    expected[1:5, 1:5, 5:9] = 2
    np.testing.assert_array_equal(labels, expected)


def test_voxels_of_a_ball_are_those_within_its_radius():
    size, origin = np.array([0.3, 0.2, 0.1]), np.array([-1.0, 2.0, 0.5])
    center = origin + 10 * size
    labels = voxel_labels(sphere(center, 0.9, subdivisions=5), (21, 21, 21), size, origin)
    place = np.stack(np.indices(labels.shape), -1) * size + origin
    depth = 0.9 - np.linalg.norm(place - center, axis=-1)
    sure = np.abs(depth) > 0.01
    np.testing.assert_array_equal(labels[sure], (depth > 0)[sure])


def test_volumes_of_a_foam_agree():
    mesh = foam(np.array([[2, 2, 2], [2, 2, 3.4], [2, 3.2, 2.6]]), np.full(3, 1.0), 0.3)
    labels = voxel_labels(mesh, (80, 100, 110), (0.05,) * 3)
    for region, volume in mesh.volumes().items():
        assert (labels == region).sum() * 0.05**3 == pytest.approx(volume, rel=0.01)


def test_what_lies_outside_of_the_voxels_is_cut_off():
    ball = sphere((0, 0, 0), 1.0, subdivisions=4)
    labels = voxel_labels(ball, (5, 5, 5), (0.3,) * 3)
    place = np.stack(np.indices(labels.shape), -1) * 0.3
    np.testing.assert_array_equal(labels, np.linalg.norm(place, axis=-1) < 1)
    assert not voxel_labels(ball.translated((9, 0, 0)), (5, 5, 5), (0.3,) * 3).any()


def test_lines_through_vertices_do_not_leak():
    """Vertices just where the lines through voxel centres are."""
    for seed in range(20):
        ball = sphere((10, 10, 10), 4 + seed / 4, subdivisions=2)
        snapped = ball.with_vertices(np.round(ball.vertices)).translated((1.3e-6, 2.1e-6, 0))
        labels = voxel_labels(snapped, (21, 21, 21), (1, 1, 1))
        assert not labels[:, :, -1].any()
        assert (labels == 1).sum() == pytest.approx(snapped.region_volume(1), rel=0.15)


@pytest.mark.parametrize("largest", [9, 1 << 40])
def test_labels_by_rank(largest):
    labels = np.array([[[0, 7, 7], [-2, 3, largest]]])
    names, ranks = ranked(labels)
    assert names.tolist() == [0, 3, 7, largest]
    assert ranks.tolist() == [[[0, 2, 2], [0, 1, 3]]]
    large = np.zeros((1, 2, 2), np.uint64)
    large[0, 0, 0] = 2**53 + 1
    assert ranked(large)[0].tolist() == [0, 2**53 + 1]
    assert ranked(np.full((1, 1, 2), 5))[0].tolist() == [0, 5]
    assert ranked(np.zeros((0, 1, 2), int))[0].tolist() == [0]
