"""Labels that were drawn in every few slices."""

import numpy as np
import pytest

from napari_deltamic.geometry.labels.annotated_slices import filled_between
from napari_deltamic.geometry.labels.label_repair import repair_labels

SIZE = np.array([0.5, 0.2, 0.2])


def balls(*places, shape=(31, 48, 72)):
    at = np.indices(shape).transpose(1, 2, 3, 0) * SIZE
    labels = np.zeros(shape, np.int32)
    for name, (z, y, x, radius) in enumerate(places, 1):
        labels[((at - (z, y, x)) ** 2).sum(-1) < radius**2] = name
    return labels


WHOLE = balls((7.0, 4.5, 4.0, 3.2), (7.5, 5.0, 10.0, 3.0))


@pytest.mark.parametrize(("every", "alike"), [(2, 0.94), (3, 0.94), (5, 0.82)])
def test_cells_drawn_in_every_few_slices_come_back(every, alike):
    drawn = np.zeros_like(WHOLE)
    drawn[::every] = WHOLE[::every]
    found, filled = filled_between(drawn, SIZE)
    spanned = np.flatnonzero(drawn.any((1, 2)))
    assert filled == spanned[-1] - spanned[0] + 1 - len(spanned)
    for name in (1, 2):
        own = np.flatnonzero((drawn == name).any((1, 2)))  # what lies beyond, nobody has drawn
        here, there = (labels[own[0] : own[-1] + 1] == name for labels in (found, WHOLE))
        assert (here & there).sum() > alike * (here | there).sum()
    np.testing.assert_array_equal(found[::every], drawn[::every])


def test_nothing_joins_cells_of_which_each_lies_on_one_side():
    layers = balls((3.0, 4.5, 4.0, 2.0), (11.0, 4.5, 4.0, 2.0))
    found, filled = filled_between(layers, SIZE)
    assert filled == 0
    assert found is layers


def test_the_user_is_told():
    drawn = WHOLE.copy()
    drawn[12] = 0
    done = repair_labels(drawn, SIZE)
    assert done.repairs == ("1 slice without labels was filled in between others",)
    assert (done.labels != WHOLE).mean() < 0.001


def test_masks_that_touch_share_what_lies_between():
    one, other = np.zeros((3, 9, 12), np.int32), np.zeros((9, 12), np.int32)
    other[2:7, 1:6], other[2:7, 6:11] = 1, 2
    one[0] = one[2] = other
    found, _ = filled_between(one, SIZE)
    np.testing.assert_array_equal(found[1], other)


def test_a_label_may_fill_its_slices():
    full = np.zeros((5, 8, 8), np.int32)
    full[[0, 4]] = 3
    found, filled = filled_between(full, SIZE)
    assert filled == 3
    assert (found == 3).all()
