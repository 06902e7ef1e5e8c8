"""Parts of a mesh that are changed by themselves."""

import numpy as np

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.topology.submesh import Change, Cutter, narrowed, put_back

LARGE = sphere((0, 0, 0), 3.0, edge_length=0.8)
CRUMB = sphere((0, 0, 4.0), 0.3, edge_length=0.2)


def test_a_piece_may_vanish_where_nothing_is_new():
    """As a crumb beside a cell does: all that is left is what was there."""
    whole = Mesh.merge([LARGE, Mesh(CRUMB.vertices, CRUMB.faces, 2 * CRUMB.regions)])
    part = Cutter(whole).part(np.arange(len(whole.faces)))
    left = Change(LARGE, np.arange(len(LARGE.vertices)))
    small, change = narrowed(part, left)
    found = put_back(whole, [(small, change)]).mesh
    np.testing.assert_array_equal(found.faces, LARGE.faces)
    np.testing.assert_array_equal(found.vertices_numpy(), LARGE.vertices_numpy())


def test_what_is_the_same_before_and_after_is_left_out():
    part = Cutter(LARGE).part(np.arange(len(LARGE.faces)))
    moved = LARGE.vertices_numpy().copy()
    moved[0] += 0.1
    origin = np.arange(len(moved))
    origin[0] = -1
    small, change = narrowed(part, Change(LARGE.with_vertices(moved), origin))
    around = (LARGE.faces == 0).any(1).sum()
    assert len(small.mesh.faces) == len(change.mesh.faces) == around
    found = put_back(LARGE, [(small, change)]).mesh
    assert found.volumes()[1] > LARGE.volumes()[1]


def test_faces_in_a_box_are_those_that_reach_into_it():
    rng = np.random.default_rng(1)
    corners, cutter = LARGE.vertices_numpy()[LARGE.faces], Cutter(LARGE)
    for low in rng.uniform(-3, 2, (50, 3)):
        high = low + rng.uniform(0, 2, 3)
        wanted = ((corners.min(1) <= high) & (corners.max(1) >= low)).all(1)
        np.testing.assert_array_equal(cutter.faces_in(low, high), np.flatnonzero(wanted))


def test_the_rim_of_a_part_is_what_other_faces_share():
    rows = np.flatnonzero(LARGE.vertices_numpy()[LARGE.faces][..., 0].mean(1) > 0)
    rest = np.setdiff1d(np.arange(len(LARGE.faces)), rows)
    part = Cutter(LARGE).part(rows)
    shared = np.intersect1d(LARGE.faces[rows], LARGE.faces[rest])
    np.testing.assert_array_equal(part.corners[part.rim], shared)
