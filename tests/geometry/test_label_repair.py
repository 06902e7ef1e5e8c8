"""Label images as segmentation programs write them."""

import numpy as np
import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.label_repair import repair_labels


def two_boxes(gap=0):
    labels = np.zeros((10, 14, 24), np.uint16)
    labels[2:8, 3:11, 2:11] = 1
    labels[2:8, 3:11, 11 + gap : 21] = 2
    return labels


def test_a_good_image_is_left_alone():
    done = repair_labels(two_boxes())
    assert np.array_equal(done.labels, two_boxes())
    assert done.remarks == ()


def test_whole_numbers_kept_as_floats_are_labels():
    labels = two_boxes().astype(np.float32)
    labels[0, 0, 0] = np.nan
    assert np.array_equal(repair_labels(labels).labels, two_boxes())


def test_a_mask_is_one_label():
    assert set(np.unique(repair_labels(two_boxes() > 0).labels)) == {0, 1}


def test_cells_that_touch_in_a_mask_are_asked_about():
    assert "if there are several" in repair_labels(np.where(two_boxes(), 255, 0)).asked[0]
    assert repair_labels(np.where(two_boxes(), 1, 0)).asked == ()


def test_the_largest_part_is_kept_and_the_others_are_named():
    labels = two_boxes()
    labels[0, 0, 0] = 1
    done = repair_labels(labels)
    assert done.labels[0, 0, 0] == 0
    assert done.remarks == ("label 1: in several parts; the largest was kept",)


def test_a_large_part_that_is_left_out_may_be_a_cell():
    labels = np.where(two_boxes(gap=4) > 0, 3, 0)
    labels[0, 0, 0] = 4
    assert "give it a number of its own" in repair_labels(labels).remarks[1]


@pytest.mark.parametrize("value", [True, 1, 255])
def test_each_large_part_of_a_mask_is_a_cell(value):
    labels = np.where(two_boxes(gap=4) > 0, value, False)
    labels[0, 0, 0] = value
    done = repair_labels(labels)
    assert np.array_equal(done.labels, two_boxes(gap=4))
    assert done.remarks == (
        f"there is one label, {value:d}, in 2 large parts, as in a mask: each was taken for a "
        "cell, 1 small part left out; give cells numbers of their own if that is wrong",
    )


def test_holes_are_filled_but_not_with_other_cells():
    labels = two_boxes()
    labels[4, 6, 5] = 0
    labels[4, 6, 8] = 2  # a fragment of the neighbour, inside
    labels[3:6, 5:8, 14:17] = 7
    done = repair_labels(labels)
    assert done.labels[4, 6, 5] == done.labels[4, 6, 8] == 1
    assert (done.labels[3:6, 5:8, 14:17] == 7).all()


def test_overlapping_masks_share_by_depth():
    one, other = np.zeros((2, 10, 14, 24), bool)
    one[2:8, 3:11, 2:14] = True
    other[2:8, 3:11, 9:21] = True
    done = repair_labels([one, other])
    row = done.labels[5, 7]
    assert (row[2:11] == 1).all()
    assert (row[12:21] == 2).all()
    assert "overlap in 240 voxels" in done.remarks[0]


def test_a_cell_wholly_inside_another_is_not_lost_silently():
    large, small = np.zeros((2, 10, 14, 24), bool)
    large[1:9, 1:13, 1:23] = True
    small[4:6, 6:8, 10:12] = True
    with pytest.raises(InputError, match=r"cell 2 .* lies wholly in others"):
        repair_labels([large, small])


def test_cells_cut_by_the_border_are_named():
    labels = two_boxes()
    labels[0:3, 3:11, 11:21] = 2
    assert "label 2: cut by the border" in repair_labels(labels).remarks[0]


def test_one_label_over_most_of_the_image_is_doubted():
    labels = np.ones((6, 6, 6), int)
    assert "is it the background?" in repair_labels(labels).remarks[-1]
    assert "label 1 fills 73% of the image" in repair_labels(two_boxes() + 1).asked[0]


def test_a_cell_that_fills_a_tight_image_is_no_background():
    places = np.moveaxis(np.indices((21, 21, 21)), 0, -1) - 10
    ball = np.linalg.norm(places, axis=-1) <= 10
    assert ball[0].any()
    assert repair_labels(ball).asked == repair_labels(two_boxes()).asked == ()


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (np.ones((4, 5), int), "2D"),
        (np.zeros((4, 5, 6), int), "no labels above 0"),
        (np.full((4, 5, 6), 0.5), "not whole numbers"),
        (np.full((4, 5, 6), -1), "negative"),
        (np.full((4, 5, 6), "a"), "whole numbers"),
        ([np.ones((4, 5, 6), bool), np.ones((4, 5, 7), bool)], "must agree"),
    ],
)
def test_what_cannot_be_repaired_is_refused(labels, message):
    with pytest.raises(InputError, match=message):
        repair_labels(labels)
