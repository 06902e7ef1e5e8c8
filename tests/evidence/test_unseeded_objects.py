"""Bright things that no cell explains: which places of a residual they are made of."""

import numpy as np
import pytest

from napari_deltamic import GaussianPSF
from napari_deltamic.evidence.residual import Spot
from napari_deltamic.evidence.unseeded_objects import strays
from napari_deltamic.geometry import Mesh, sphere

OPTICS = GaussianPSF((0.3, 0.2, 0.2))


@pytest.fixture(scope="module")
def cell():
    return sphere((3.0, 3.0, 3.0), 1.0, edge_length=0.3)


def spot(place, z=8.0):
    there = tuple(map(float, place))
    return Spot(there, 1.0, z, z, 1, there)


def test_places_around_one_thing_are_one(cell):
    """The membrane of a cell without a start is bright all around; both are told."""
    middle = np.array([3.0, 3.0, 8.0])
    around = [spot(middle + 0.9 * way) for axis in np.eye(3) for way in (axis, -axis)]
    (found,) = strays(around, cell, OPTICS)
    assert found.middle == pytest.approx(tuple(middle))
    assert found.position in [one.position for one in around]


def test_things_that_lie_apart_are_several_the_brightest_first(cell):
    found = strays([spot((3, 3, 8), 6.0), spot((3, 9, 3), 12.0)], cell, OPTICS)
    assert [stray.position for stray in found] == [(3, 9, 3), (3, 3, 8)]
    assert [stray.z for stray in found] == [12.0, 6.0]


def test_neither_dark_places_nor_those_of_a_surface_count(cell):
    dark, near = spot((3, 3, 8), -9.0), spot((3, 3, 4.3))
    assert strays([dark, near], cell, OPTICS) == ()
    assert strays([], cell, OPTICS) == ()


def test_what_is_bright_within_a_cell_is_no_other_cell():
    """The chromatin of a nucleus."""
    nuclei = Mesh.merge([sphere((5.0, 5.0, x), 3.0, edge_length=0.6) for x in (5.0, 14.0)])
    chromatin = [spot((5, 5, 5), 20.0), spot((5.5, 4.5, 14)), spot((4, 5, 13.7))]
    assert strays(chromatin, nuclei, OPTICS) == ()
    (found,) = strays([*chromatin, spot((5, 14, 5))], nuclei, OPTICS)
    assert found.position == (5, 14, 5)


def test_things_around_a_cell_are_told_where_one_of_them_is(cell):
    around = [spot((3, 3, 1.0), 9.0), spot((3, 3, 5.0), 8.0), spot((3, 1, 3)), spot((3, 5, 3))]
    for stray in strays([*around, spot((1, 3, 3)), spot((5, 3, 3))], cell, OPTICS):
        for place in (stray.position, stray.middle):
            assert np.linalg.norm(np.subtract(place, 3)) > 1
