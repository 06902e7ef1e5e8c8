import numpy as np
import pytest
from benchmarks.shapes import box, torus
from numpy.testing import assert_allclose

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import smallest_angles
from napari_deltamic.geometry.topology.region_edits import divide_region, remove_region

CENTERS = np.array([[3, 3, 3], [3, 3, 5.2], [3, 4.9, 4.0], [4.6, 3.6, 4.1]])


@pytest.fixture(scope="module")
def cluster():
    return foam(CENTERS, np.full(4, 1.5), 0.35)


def wall(mesh, a, b):
    return (np.sort(mesh.regions, axis=1) == sorted((a, b))).all(axis=1)


@pytest.mark.parametrize("seed", range(6))
def test_a_cell_of_a_cluster_divides(cluster, seed):
    rng = np.random.default_rng(seed)
    cell, normal = int(rng.integers(1, 5)), rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    point = cluster.region_surface(cell).vertices_numpy().mean(0) + rng.uniform(-0.2, 0.2, 3)
    mesh = divide_region(cluster, cell, point, normal, (cell, 9))
    assert mesh.is_closed()
    before, after = cluster.volumes(), mesh.volumes()
    assert after[cell] + after[9] == pytest.approx(before[cell], rel=0.005)
    for other in set(before) - {cell}:
        assert after[other] == pytest.approx(before[other], rel=0.002)
    own = wall(mesh, cell, 9)
    heights = (mesh.vertices_numpy()[np.unique(mesh.faces[own])] - point) @ normal
    assert np.abs(heights).max() < 0.35 * 0.35
    # In front of the plane lies the second daughter.
    towards = np.where(mesh.regions[own, 1] == 9, 1, -1)[:, None] * mesh.normals()[own]
    assert (towards @ normal).min() > 0.5
    assert np.percentile(smallest_angles(mesh), 1) > 25
    assert (mesh.edge_uses() > 3).mean() < 0.001


def test_vertices_of_other_cells_stay(cluster):
    mesh = divide_region(cluster, 1, CENTERS[0] + 0.01, (0, 1, 0.3), (8, 9))
    far = np.setdiff1d(
        np.arange(len(cluster.vertices)), cluster.faces[(cluster.regions == 1).any(1)]
    )
    kept = {tuple(v) for v in mesh.vertices_numpy().tolist()}
    assert {tuple(v) for v in cluster.vertices_numpy()[far].tolist()} <= kept


def test_a_single_cell_divides_into_halves():
    mesh = divide_region(sphere((1, 2, 3), 1.0, subdivisions=4), 1, (1, 2, 3), (0, 0, 1), (2, 3))
    assert mesh.region_ids().tolist() == [2, 3]
    assert_allclose(list(mesh.volumes().values()), 2 / 3 * np.pi, rtol=0.01)
    assert mesh.areas()[wall(mesh, 2, 3)].sum() == pytest.approx(np.pi, rel=0.02)
    assert mesh.region_surface(3).vertices_numpy()[:, 2].mean() > 3


def test_a_box_of_few_triangles_divides():
    mesh = divide_region(box((0, 0, 0), (2, 2, 2)), 1, (0.5, 1, 1), (1, 0, 0), (1, 2))
    assert mesh.volumes() == pytest.approx({1: 6.0, 2: 2.0}, rel=0.05)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"region": 7}, "no region 7"),
        ({"daughters": (2, 9)}, "numbers that are free"),
        ({"daughters": (9, 9)}, "numbers that are free"),
        ({"normal": (0, 0, 0)}, "normal that is not zero"),
        ({"point": (0, np.nan, 0)}, "finite point"),
        ({"point": (50, 0, 0)}, "does not cut region 1"),
    ],
)
def test_divisions_that_cannot_be(cluster, options, message):
    asked = {"region": 1, "point": CENTERS[0], "normal": (1, 0, 0), "daughters": (1, 9)}
    with pytest.raises(InputError, match=message):
        divide_region(cluster, **{**asked, **options})


def test_a_plane_that_cuts_twice_is_refused():
    ring = torus((0, 0, 0), 2.0, 0.5)
    axis = np.eye(3)[np.ptp(ring.vertices_numpy(), axis=0).argmax()]
    with pytest.raises(InputError, match="more than once"):
        divide_region(ring, 1, (0, 0, 0), axis, (1, 2))


def test_an_open_surface_is_refused(cluster):
    opened = Mesh(cluster.vertices, cluster.faces[1:], cluster.regions[1:])
    cell = int(cluster.regions[0].max())
    with pytest.raises(InputError, match="not closed"):
        divide_region(opened, cell, CENTERS[cell - 1], (1, 0, 0), (8, 9))


def test_a_region_is_removed(cluster):
    before = cluster.volumes()
    mesh = remove_region(cluster, 2)
    assert mesh.is_closed()
    assert mesh.volumes() == pytest.approx({k: before[k] for k in (1, 3, 4)})
    assert remove_region(sphere((0, 0, 0), 1.0), 1) is None
    with pytest.raises(InputError, match="no region 5"):
        remove_region(cluster, 5)
