"""Dark ground between cells, and pieces of them, are no cells."""

import numpy as np
from scipy import ndimage

from napari_deltamic.geometry.labels.bright_cells import cells_of
from napari_deltamic.geometry.labels.even_walls import even_walls

SHAPE = (40, 72, 72)
# Z, Y, X and radius, voxels: large and small cells side by side, with dark ground between them.
PLACES = [
    (20, 17.5, 17.5, 12),
    (20, 17.5, 46, 9.5),
    (20, 30, 61.5, 6),
    (20, 33.5, 33.5, 6.5),
    (20, 46, 17.5, 9.5),
    (20, 48.5, 46.5, 12),
    (20, 62, 33, 5),
]


def balls(places):
    grid = np.indices(SHAPE)
    away = [np.hypot.reduce(grid - np.reshape(p[:3], (3, 1, 1, 1))) - p[3] for p in places]
    nearest = np.min(away, axis=0)
    return np.where(nearest < 0, np.argmin(away, axis=0) + 1, 0), nearest


def photographed(away, seed):
    light = ndimage.gaussian_filter((np.abs(away) < 0.8).astype(float), (1.8, 1.2, 1.2))
    return np.random.default_rng(seed).poisson(8 + 50 * light / light.max())


def alike(found, own):
    """Best intersection over union of a cell with one that was found."""
    names = np.unique(found[own & (found > 0)])
    return max((((found == k) & own).sum() / ((found == k) | own).sum() for k in names), default=0)


def test_ground_between_cells_and_pieces_of_them_are_not_found():
    truth, away = balls(PLACES)
    found = cells_of(photographed(away, 1), (0.2, 0.2, 0.2)).labels
    assert found.max() >= 6
    assert min(alike(truth, found == k) for k in range(1, found.max() + 1)) > 0.5


def test_a_wall_that_is_open_to_some_sides_is_less_even():
    labels, away = balls([(20, 36, 36, 10)])
    wall = np.exp(-(away**2) / 3).astype(np.float32)
    half = np.where(np.indices(SHAPE)[2] < 36, wall, 0).astype(np.float32)
    names, side = np.array([2]), np.ones(3)
    whole, open_, flat = (
        even_walls(labels.astype(np.int32) + 1, names, one, side)[0]
        for one in (wall, half, np.zeros_like(wall))
    )
    assert whole > 0.9
    assert open_ < 0.6
    assert flat == 0


def test_what_the_border_cuts_is_told_by_the_rest_of_its_wall():
    labels, away = balls([(20, 36, 0, 10)])
    wall = np.exp(-(away**2) / 3).astype(np.float32)
    assert even_walls(labels.astype(np.int32) + 1, np.array([2]), wall, np.ones(3))[0] > 0.9
    alone = np.ones(SHAPE, np.int32)
    assert even_walls(alone, np.array([1]), wall, np.ones(3))[0] == 1
