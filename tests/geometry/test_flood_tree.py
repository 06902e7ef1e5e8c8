import numpy as np
import pytest
from numpy.testing import assert_array_equal

from napari_deltamic.geometry.labels import basins, flood_tree


def components(ranked):
    """Per voxel: the level above its component, and size, border, lowest level of that."""
    tree = basins._new_tree(ranked, np.ones(3))
    own = np.arange(ranked.size)
    leaf = tree.level[tree.parent] == tree.level
    leaf[tree.parent == own] = False
    node = np.where(leaf, tree.parent, own)
    above = tree.level[tree.parent[node]]
    return above, tree.volume[node], tree.border[node], tree.lowest[node]


SHAPES = [(3, 3, 3), (3, 4, 5), (6, 7, 8), (12, 11, 13)]  # that of scikit-image needs three


@pytest.mark.parametrize("levels", [1, 3, 40, 65536])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_compiled_tree_is_that_of_scikit_image(shape, levels, monkeypatch):
    if flood_tree.native() is None:
        pytest.skip("no compiled extension")
    image = np.random.default_rng(levels).integers(0, levels, shape).astype(np.uint16)
    ours = components(image)
    monkeypatch.setattr(flood_tree, "native", lambda: None)
    for mine, theirs in zip(ours, components(image), strict=True):
        assert_array_equal(mine, theirs)


def test_a_row_of_voxels():
    if flood_tree.native() is None:
        pytest.skip("no compiled extension")
    parent, order = flood_tree.flood_tree(np.array([[[1, 0, 3, 2, 2]]], np.uint16))
    assert parent.tolist() == [2, 0, 2, 4, 2]
    assert order.tolist() == [2, 4, 3, 0, 1]


@pytest.mark.parametrize("library", [flood_tree.native, lambda: None])
def test_what_holds_a_voxel_comes_before_it(library, monkeypatch):
    monkeypatch.setattr(flood_tree, "native", library)
    image = np.random.default_rng(0).integers(0, 9, (5, 6, 7)).astype(np.uint16)
    parent, order = flood_tree.flood_tree(image)
    assert_array_equal(np.sort(order), np.arange(image.size))
    place = np.empty(image.size, int)
    place[order] = np.arange(image.size)
    assert (place[parent] <= place).all()
    assert parent[order[0]] == order[0]


def test_a_transposed_image_is_flooded_as_it_lies():
    image = np.random.default_rng(1).integers(0, 9, (4, 5, 6)).astype(np.uint16)
    for mine, theirs in zip(
        flood_tree.flood_tree(image.T),
        flood_tree.flood_tree(np.ascontiguousarray(image.T)),
        strict=True,
    ):
        assert_array_equal(mine, theirs)


def test_the_library_refuses_what_is_no_image():
    library = flood_tree.native()
    if library is None:
        pytest.skip("no compiled extension")
    for wrong in (np.zeros((2, 2), np.uint16), np.zeros((0, 2, 2), np.uint16)):
        with pytest.raises(ValueError, match="levels"):
            library.flooded(wrong)
