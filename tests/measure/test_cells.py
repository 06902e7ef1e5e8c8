from math import isnan, pi

import numpy as np
from benchmarks.shapes import box
from numpy.testing import assert_allclose

from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.measure import measure_cells


def boxes_with_a_wall():
    """A box of 1 x 1 x 2 um cut in two cells, 1 (low x) and 2, by a wall."""
    whole = box((0, 0, 0), (1, 1, 2), edge_length=1)
    low = whole.vertices[whole.faces][:, :, 2].mean(axis=1) < 0
    regions = np.where(low[:, None], [1, 0], [2, 0])
    ring = np.nonzero(whole.vertices[:, 2] == 0)[0]
    z, y = whole.vertices[ring, 0], whole.vertices[ring, 1]
    a, b, c, d = ring[np.argsort(np.arctan2(y, z))]
    wall = Mesh(whole.vertices, [[a, b, c], [a, c, d]])
    faces = wall.faces if wall.normals()[0, 2] < 0 else wall.faces[:, ::-1]
    return Mesh(
        whole.vertices,
        np.concatenate([whole.faces, faces]),
        np.concatenate([regions, [[2, 1], [2, 1]]]),
    )


def test_sphere():
    (row,) = measure_cells(sphere((1, 2, 3), 2.0, subdivisions=5))
    assert row["region"] == 1
    assert_allclose(row["volume_um3"], 32 / 3 * pi, rtol=1e-3)
    assert_allclose(row["area_um2"], 16 * pi, rtol=1e-3)
    assert_allclose(row["sphericity"], 1, rtol=1e-3)
    assert row["sphericity"] < 1
    centroid = [row[f"centroid_{axis}_um"] for axis in "zyx"]
    assert_allclose(centroid, [1, 2, 3])
    assert row["n_contacts"] == 0


def test_cells_that_share_a_wall():
    rows = measure_cells(boxes_with_a_wall().translated((10, 20, 30)))
    assert [row["region"] for row in rows] == [1, 2]
    for row, x in zip(rows, (29.5, 30.5), strict=True):
        assert_allclose(row["volume_um3"], 1)
        assert_allclose(row["area_um2"], 6)
        assert_allclose(row["sphericity"], (pi / 6) ** (1 / 3))
        assert_allclose([row[f"centroid_{axis}_um"] for axis in "zyx"], [10, 20, x])
        assert row["n_contacts"] == 1


def test_an_open_cell_has_no_volume():
    mesh = sphere((0, 0, 0), 1.0)
    (row,) = measure_cells(Mesh(mesh.vertices, mesh.faces[1:]))
    assert row["area_um2"] > 12
    for name in ("volume_um3", "sphericity", "centroid_z_um"):
        assert isnan(row[name])
