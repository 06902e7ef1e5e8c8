"""The bending energy of cells as closed bodies."""

import numpy as np
from numpy.testing import assert_allclose

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.bending import BendingEnergy
from napari_deltamic.geometry.cell_bending import CellBending
from napari_deltamic.geometry.foam import foam

BALL = sphere((0.3, 1.0, -2.0), 0.7, subdivisions=2)
TWO = foam(np.array([(0, 0, -0.5), (0, 0, 0.5)]), np.full(2, 0.7), 0.2)


def test_of_cells_apart_it_is_that_of_their_surface():
    other = BALL.translated((0, 0, 3.0))
    mesh = Mesh.merge([BALL, Mesh(other.vertices, other.faces, other.regions * 7)])
    at = mesh.vertices_numpy() + 0.02 * np.random.default_rng(0).normal(
        size=(len(mesh.vertices), 3)
    )
    for one, same in zip(CellBending(mesh)(at), BendingEnergy(mesh)(at), strict=True):
        assert_allclose(one, same, rtol=1e-10, atol=1e-9)


def test_of_cells_that_share_a_wall_it_is_the_sum_over_them():
    at = TWO.vertices_numpy()
    each = [TWO.region_surface(int(k)) for k in TWO.region_ids()]
    alone = sum(BendingEnergy(one)(one.vertices_numpy())[0] for one in each)
    assert_allclose(CellBending(TWO)(at)[0], alone, rtol=1e-10)
    # At their junction they are bent, which the energy of the walls leaves out.
    assert alone > 1.2 * BendingEnergy(TWO)(at)[0]


def test_its_gradient_is_its_slope():
    energy, at = CellBending(TWO), TWO.vertices_numpy()
    rng = np.random.default_rng(1)
    along = rng.normal(size=at.shape)
    step = 1e-6
    slope = (energy(at + step * along)[0] - energy(at - step * along)[0]) / (2 * step)
    assert_allclose((energy(at)[1] * along).sum(), slope, rtol=1e-5)


def test_its_second_derivatives_are_nowhere_negative_and_hold_the_junction():
    at = TWO.vertices_numpy()
    along = np.tile([0.0, 0.0, 1.0], (len(at), 1))
    own, free = (kind(TWO).curvature(at, along).toarray() for kind in (CellBending, BendingEnergy))
    assert_allclose(own, own.T, atol=1e-10)
    assert np.linalg.eigvalsh(own).min() > -1e-9 * np.abs(own).max()
    uses = np.bincount(TWO.face_edges().ravel(), minlength=len(TWO.edges()))
    junction = np.unique(TWO.edges()[uses > 2])
    assert len(junction) > 5
    assert (np.diag(own)[junction] > np.diag(free)[junction]).all()
