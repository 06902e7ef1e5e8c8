"""What a fit is to explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..scene import Grid
from ..scene.effects import Effects, VoxelEffect
from .checks import FEWEST_VOXELS
from .second_view import Pixels


@dataclass(frozen=True, eq=False)
class Problem:
    """An image, and which of its voxels may count.

    Attributes
    ----------
    image
        (Z, Y, X) float32.
    counted
        (Z, Y, X) bool: missing voxels and foreign ground are left out.
    grid
        Where they lie.
    second
        A second image of the same scene.

    Raises
    ------
    InputError
        If fewer than 64 voxels count, of either image.
    """

    image: np.ndarray
    counted: np.ndarray
    grid: Grid
    second: Pixels | None = None

    def __post_init__(self) -> None:
        _check_enough(self.counted)
        if self.second is not None:
            _check_enough(self.second.known, "second view: ")

    def counted_with(self, effects: Effects) -> np.ndarray:
        """(Z, Y, X) bool: the voxels that may count with these effects.

        Raises
        ------
        InputError
            If fewer than 64 are left.
        """
        counted = self.counted
        for effect in effects.present():
            if isinstance(effect, VoxelEffect):
                counted = counted & ~effect.missing(self.image)
        _check_enough(counted)
        return counted


def _check_enough(counted: np.ndarray, which: str = "") -> None:
    n = int(np.count_nonzero(counted))
    if n < FEWEST_VOXELS:
        raise InputError(f"{which}only {n} voxels count; a fit needs {FEWEST_VOXELS}")
