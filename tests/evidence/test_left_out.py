"""Bright parts beside a cell that belong to none."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic import GaussianPSF, Grid
from napari_deltamic.evidence.left_out import left_out
from napari_deltamic.geometry import sphere

GRID = Grid((32, 40, 70), (0.2, 0.2, 0.2), (1.0, 0.0, 0.0))
Z, Y, X = np.meshgrid(*(np.arange(n) * 0.2 for n in GRID.shape), indexing="ij")
MIDDLE = (4.0, 4.0, 4.0)  # um; the grid begins at 1
OPTICS, GROUND, LIGHT = GaussianPSF(0.25), 20.0, 100.0


def ball(radius: float, right: float = 0.0) -> np.ndarray:
    """(Z, Y, X) bool; ``right`` um of the cell."""
    return (Z - 3) ** 2 + (Y - 4) ** 2 + (X - 4 - right) ** 2 < radius**2


def arm(first: float, last: float, radius: float = 0.5) -> np.ndarray:
    """(Z, Y, X) bool: a rod to the right of the cell, um from its middle."""
    along = X - 4
    return (np.hypot(Z - 3, Y - 4) < radius) & (along > first) & (along < last)


def seen(what: np.ndarray) -> np.ndarray:
    """Through the PSF, of 20 photons outside and 120 inside."""
    light = gaussian_filter(LIGHT * what.astype(float), 0.25 / 0.2)
    return np.random.default_rng(0).poisson(GROUND + light).astype(float)


def found(image: np.ndarray) -> dict[int, tuple[float, tuple[float, float, float]]]:
    """Beside the fitted ball of 2 um."""
    cell = sphere(MIDDLE, 2.0, edge_length=0.2)
    shown = GROUND + gaussian_filter(LIGHT * ball(2.0), 0.25 / 0.2)
    return left_out(cell, GRID, OPTICS, image, shown, GROUND)


def test_an_arm_that_no_label_covers_is_told_with_its_share_and_its_place():
    ((cell, (share, (z, y, x))),) = found(seen(ball(2.0) | arm(1.5, 8.0))).items()
    missing = (arm(1.5, 8.0) & ~ball(2.0)).sum() / ball(2.0).sum()
    assert cell == 1
    assert share == pytest.approx(missing, rel=0.2)
    assert (z, y) == pytest.approx((4.0, 4.0), abs=0.5)
    assert 6.0 < x < 12.0


@pytest.mark.parametrize(
    "beside",
    [
        arm(0.0, 1.0),  # nothing but the cell
        ball(2.0, 4.0),  # another cell that touches
        ball(1.3, 3.3),  # a smaller one
        arm(3.0, 8.0),  # something beyond a dark gap
        ball(2.1),  # its surface is off by half a voxel
    ],
)
def test_neighbours_that_touch_and_things_further_away_are_none(beside):
    assert found(seen(ball(2.0) | beside)) == {}


def test_what_is_missing_is_not_bright():
    image = seen(ball(2.0) | arm(1.5, 8.0))
    image[X > 6.0] = np.nan
    assert found(image) == {}


def test_dim_parts_in_noise_are_none():
    image = np.random.default_rng(1).normal(GROUND, 40.0, GRID.shape)
    assert found(image + gaussian_filter(LIGHT * ball(2.0), 0.25 / 0.2)) == {}
