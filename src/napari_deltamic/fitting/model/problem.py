"""What a fit is to explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ...errors import InputError
from ...optics import Optics
from ...runs.settings import FitSettings
from ...scene import Grid
from ...scene.effects import Effects, VoxelEffect
from .checks import FEWEST_VOXELS, check_image, checked_mask
from .hot_voxels import hot_voxels
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
    foreign
        (Z, Y, X) bool: measured voxels of objects that no mesh describes; None if there are none.
    hot
        How many voxels were left out because no PSF can have made them so bright.
    anew
        How often it was found anew which voxels are foreign (:mod:`.ground_again`); None where that
        is given, and not to be found.
    let_go
        (Z, Y, X) uint8: in which letting go a voxel was let go as a neighbour's
        (:mod:`..voxels.letting_go`), which it then stays; 0: in none. None: nothing was.
    frame
        Grid of the whole image, where this one is a piece of it.
    local_background
        (Z, Y, X) what was subtracted from the image (:mod:`..voxels.local_background`); None:
        nothing.
    psf_guessed
        Whether nobody has said how wide the PSF is.

    Raises
    ------
    InputError
        If fewer than 64 voxels count, of either image.
    """

    image: np.ndarray
    counted: np.ndarray
    grid: Grid
    second: Pixels | None = None
    foreign: np.ndarray | None = None
    hot: int = 0
    anew: int | None = None
    let_go: NDArray[np.uint8] | None = None
    frame: Grid | None = None
    local_background: NDArray[np.float32] | None = None
    psf_guessed: bool = False

    def __post_init__(self) -> None:
        _check_enough(self.counted)
        if self.second is not None:
            _check_enough(self.second.known, "second view: ")

    @property
    def ground_changed(self) -> bool:
        """Whether other voxels count than at the start."""
        return bool(self.anew) or self.let_go is not None

    @classmethod
    def of(
        cls, image: np.ndarray | Tensor, grid: Grid, counted: np.ndarray | None = None
    ) -> Problem:
        """The problem of an image as given; counted : (Z, Y, X) bool, voxels that may count.

        All other measured voxels are foreign.

        Raises
        ------
        InputError
            As :func:`~.checks.check_image` does, and if fewer than 64 voxels count.
        """
        pixels, measured = check_image(image, grid)
        may = None if counted is None else checked_mask(counted, grid)
        hot = hot_voxels(pixels, measured)
        measured &= ~hot
        if may is None:
            return cls(pixels, measured, grid, hot=int(hot.sum()))
        return cls(pixels, measured & may, grid, foreign=measured & ~may, hot=int(hot.sum()))

    def counted_with(self, effects: Effects) -> np.ndarray:
        """(Z, Y, X) bool: the voxels that may count with these effects.

        Raises
        ------
        InputError
            If fewer than 64 are left.
        """
        counted = self.counted & self._known_with(effects)
        _check_enough(counted)
        return counted

    def _known_with(self, effects: Effects) -> np.ndarray:
        known = np.ones(self.image.shape, bool)
        for effect in effects.present():
            if isinstance(effect, VoxelEffect):
                known &= ~effect.missing(self.image)
        return known

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
        foreign = None
        if self.foreign is not None and factor == 1:
            foreign = self.foreign & self._known_with(effects)
        level = Level(self.image, counted, *given, other, spread, foreign=foreign, frame=self.frame)
        seen = None if second is None else second.level(*given)
        return level, seen if seen is not None and seen.usable else None


def _check_enough(counted: np.ndarray, which: str = "") -> None:
    n = int(np.count_nonzero(counted))
    if n < FEWEST_VOXELS:
        raise InputError(f"{which}only {n} voxels count; a fit needs {FEWEST_VOXELS}")
