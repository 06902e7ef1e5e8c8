"""What it means that two cells touch: one definition, on cases that can be counted by hand."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.contacts import (
    between_cells,
    contact_areas,
    contacts,
    label_contacts,
    neighbours,
    wall_areas,
    walls,
)
from napari_deltamic.measure import measure_cells

# A square of 2 um between cells 7 and 3, written both ways round; 3 has a free face, 5 is alone.
CORNERS = [[0, 0, 0], [0, 0, 2], [0, 2, 2], [0, 2, 0], [4, 0, 0]]
FACES = [[0, 1, 2], [0, 3, 2], [0, 1, 4], [1, 2, 4]]
REGIONS = [[3, 7], [7, 3], [0, 3], [5, 0]]


@pytest.fixture
def mesh():
    return nd.Mesh(CORNERS, FACES, REGIONS)


def test_cells_touch_where_a_face_lies_between_them(mesh):
    assert contacts(mesh) == {(3, 7)}
    assert walls(mesh) == {(3, 7), (0, 3), (0, 5)}
    assert neighbours(mesh) == {3: [7], 5: [], 7: [3]}


def test_the_area_of_a_contact_is_that_of_its_faces(mesh):
    assert contact_areas(mesh) == {(3, 7): pytest.approx(4.0)}
    assert wall_areas(mesh)[0, 3] == pytest.approx(mesh.areas()[2])


def test_the_outside_is_no_cell():
    assert between_cells([(0, 4), (9, 2), (4, 0), (2, 9)]) == {(2, 9)}


def test_membranes_that_lie_close_are_no_contact():
    two = nd.Mesh.merge([sphere((0, 0, 0), 1.0), sphere((0, 0, 2.001), 1.0)])
    assert contacts(two) == set()
    assert [row["n_contacts"] for row in measure_cells(two)] == [0, 0]


def test_labels_touch_where_faces_of_voxels_lie_between_them():
    labels = np.zeros((2, 3, 4), np.uint8)
    labels[:, :, 0], labels[:, :, 1], labels[0, 0, 3] = 4, 2, 9
    pairs, faces = label_contacts(labels)
    assert pairs.tolist() == [[2, 4]]
    assert faces.tolist() == [6]


def test_labels_without_neighbours_have_no_contacts():
    pairs, faces = label_contacts(np.zeros((3, 3, 3), int))
    assert pairs.shape == (0, 2)
    assert faces.shape == (0,)


@pytest.mark.parametrize("kind", [np.uint8, np.int32, np.uint64, np.int64])
@pytest.mark.parametrize("largest", [5, 3000])
def test_label_contacts_of_any_numbers(kind, largest):
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 6, (7, 8, 9))
    if largest > 5:
        if kind is np.uint8:
            largest = 250
        labels[labels == 5] = largest
    expected = {}
    for axis in range(3):
        moved = np.moveaxis(labels, axis, 0)
        for a, b in zip(moved[:-1].ravel().tolist(), moved[1:].ravel().tolist(), strict=True):
            if a and b and a != b:
                pair = min(a, b), max(a, b)
                expected[pair] = expected.get(pair, 0) + 1
    pairs, faces = label_contacts(labels.astype(kind))
    assert [tuple(pair) for pair in pairs.tolist()] == sorted(expected)
    assert faces.tolist() == [expected[pair] for pair in sorted(expected)]
    assert pairs.dtype == faces.dtype == np.int64
