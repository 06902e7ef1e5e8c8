"""Corrections of found cells by clicks."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.find_cells import find_cells
from napari_deltamic.geometry.labels.label_edits import (
    Click,
    Corrector,
    correct_labels,
)
from napari_deltamic.scene.samples import foam_sample

SIZE = (0.4, 0.2, 0.2)
LEFT, RIGHT = (2.4, 3.0, 2.0), (2.4, 3.0, 5.0)


def scene(wall=1.0, noise=0.02):
    """Two cells side by side with a wall between them, and which is where (um voxels of SIZE)."""
    z, y, x = np.indices((13, 31, 36)) * np.reshape(SIZE, (3, 1, 1, 1))
    truth = np.zeros(z.shape, np.int32)
    inside = (abs(z - 2.4) < 1.6) & (abs(y - 3.0) < 1.8)
    truth[inside & (x > 0.6) & (x < 3.4)] = 1
    truth[inside & (x >= 3.4) & (x < 6.4)] = 2
    away = np.maximum(abs(z - 2.4) - 1.6, abs(y - 3.0) - 1.8)
    hull = np.maximum(away, abs(x - 3.5) - 2.9)
    image = np.exp(-((hull / 0.2) ** 2)) + wall * np.exp(-(((x - 3.4) / 0.2) ** 2)) * (hull < 0)
    return image + noise * np.random.default_rng(0).normal(size=z.shape), truth


def same(found, truth):
    """Dice of two masks."""
    return 2 * (found & truth).sum() / (found.sum() + truth.sum())


@pytest.mark.parametrize(("wall", "least"), [(1.0, 0.9), (0.3, 0.9), (0.0, 0.8)])
def test_one_click_cuts_a_label_at_the_wall_or_half_way(wall, least):
    image, truth = scene(wall)
    joined = (truth > 0).astype(np.int32)
    done = correct_labels(image, SIZE, joined, [Click(LEFT)])
    assert set(np.unique(done)) == {0, 1, 2}
    assert same(done == 2, truth == 1) > least
    assert same(done == 1, truth == 2) > least


def test_several_clicks_in_a_label_divide_it_among_them():
    image, truth = scene()
    done = correct_labels(image, SIZE, 5 * (truth > 0), [Click(LEFT), Click(RIGHT)])
    assert same(done == done[6, 15, 10], truth == 1) > 0.95
    assert same(done == done[6, 15, 25], truth == 2) > 0.95


def test_a_click_in_the_background_adds_the_cell_there_and_leaves_others_alone():
    image, truth = scene()
    only = np.where(truth == 1, 4, 0)
    done = correct_labels(image, SIZE, only, [Click(RIGHT)])
    assert np.array_equal(done == 4, only == 4)
    assert same(done == 5, truth == 2) > 0.85


def test_nothing_is_added_where_there_is_only_background():
    image, truth = scene()
    image, labels = (np.pad(part, ((0, 0), (0, 0), (0, 40))) for part in (image, truth))
    with pytest.raises(InputError, match="no cell is seen around click 1"):
        correct_labels(image, SIZE, labels, [Click((2.4, 3.0, 11.0))])


def test_a_nucleus_that_was_missed_is_added_and_no_background():
    places = [(2.4, y, x) for y in (2.2, 6.2) for x in (2.2, 6.2, 10.2)]
    at = np.indices((13, 42, 62)) * np.reshape(SIZE, (3, 1, 1, 1))
    truth = np.zeros(at.shape[1:], np.int32)
    for k, place in enumerate(places, 1):
        truth[((at - np.reshape(place, (3, 1, 1, 1))) ** 2).sum(0) < 1.5**2] = k
    grain = np.random.default_rng(1).normal(size=truth.shape)
    image = gaussian_filter(10.0 * (truth > 0), (0.5, 1, 1)) + 2 + 0.5 * grain
    rest = np.where(truth == 5, 0, truth)
    done = correct_labels(image, SIZE, rest, [Click(places[4])])
    assert np.array_equal(done[rest > 0], rest[rest > 0])
    assert same((done > 0) & (rest == 0), truth == 5) > 0.85
    with pytest.raises(InputError, match="no cell is seen"):
        correct_labels(image, SIZE, rest, [Click((2.4, 4.2, 12.0))])


def test_cells_are_merged_and_removed():
    image, truth = scene()
    merged = correct_labels(image, SIZE, truth, [Click(LEFT, "merge"), Click(RIGHT, "merge")])
    assert set(np.unique(merged)) == {0, 1}
    assert same(merged == 1, truth > 0) > 0.98
    left = correct_labels(image, SIZE, truth, [Click(RIGHT, "remove")])
    assert np.array_equal(left, np.where(truth == 1, 1, 0))


def test_a_later_step_sees_what_an_earlier_one_did():
    image, truth = scene()
    joined = (truth > 0).astype(np.int32)
    back = [Click(LEFT, "merge", 1), Click(RIGHT, "merge", 1)]
    merged = correct_labels(image, SIZE, joined, [Click(LEFT), *back])
    assert set(np.unique(merged)) == {0, 2}
    assert np.array_equal(merged > 0, joined > 0)


def test_clicks_one_by_one_give_what_their_steps_give_at_once():
    image, truth = scene()
    labels = only = np.where(truth == 1, 4, 0)
    clicks = [Click(RIGHT), Click(LEFT, "remove", 1), Click(LEFT, "cell", 2)]
    corrector = Corrector(image, SIZE)
    for click in clicks:
        labels = corrector.corrected(labels, [click])
    assert np.array_equal(labels, correct_labels(image, SIZE, only, clicks))
    assert len(np.unique(labels)) == 3


@pytest.mark.parametrize(
    ("clicks", "message"),
    [
        ([Click((0, 0, 90))], "click 1 .* outside the image"),
        ([Click(LEFT, "merge")], "no partner"),
        ([Click(LEFT, "merge"), Click(LEFT, "merge")], "same cell already"),
        ([Click((0, 0, 0), "remove")], "lies in no cell"),
    ],
)
def test_clicks_that_mean_nothing_are_told(clicks, message):
    image, truth = scene()
    with pytest.raises(InputError, match=message):
        correct_labels(image, SIZE, truth, clicks)


def test_labels_of_another_shape_are_refused():
    image, truth = scene()
    with pytest.raises(InputError, match="the labels have shape"):
        correct_labels(image, SIZE, truth[1:], [Click(LEFT)])


@pytest.mark.slow
def test_a_crumb_of_a_sound_cell_is_not_cut_off():
    """A fit could make no cell of it; the labels stay as they are."""
    sample = foam_sample()
    labels = np.asarray(find_cells(sample.image, sample.grid.voxel_size, 5.0))
    corrector = Corrector(sample.image, sample.grid.voxel_size)
    for place in ((29, 32, 22), (27, 31, 27), (32, 65, 48)):  # near walls: 29 to 83 voxels
        click = Click(tuple(np.multiply(place, sample.grid.voxel_size)))
        with pytest.raises(InputError, match="cuts nothing off"):
            corrector.corrected(labels, [click])
