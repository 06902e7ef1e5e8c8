"""What a fit is to explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..optics import Optics
from ..runs.settings import FitSettings
from ..scene import Grid
from ..scene.effects import Effects, VoxelEffect
from .checks import FEWEST_VOXELS
from .level import Level
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

    def levels(
        self,
        optics: Optics,
        settings: FitSettings,
        effects: Effects,
        factor: float,
        spread: float,
    ) -> tuple[Level, Level | None]:
        """Both images at one blur, see :class:`Level`.

        None in place of a second one of which a wide blur leaves too little, since much is missing.

        Raises
        ------
        InputError
            If the effects leave fewer than 64 voxels of the first.
        """
        given = self.grid, optics, settings, effects, factor
        counted, second = self.counted_with(effects), self.second
        other = None if second is None else second.optics
        level = Level(self.image, counted, *given, other, spread)
        seen = None if second is None else second.level(*given)
        return level, seen if seen is not None and seen.usable else None


def _check_enough(counted: np.ndarray, which: str = "") -> None:
    n = int(np.count_nonzero(counted))
    if n < FEWEST_VOXELS:
        raise InputError(f"{which}only {n} voxels count; a fit needs {FEWEST_VOXELS}")
