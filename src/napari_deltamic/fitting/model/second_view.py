"""The second image of a scene that was seen twice: one more term of the objective."""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from ...images.stacks import read_image
from ...optics import GaussianPSF, Optics
from ...runs.settings import FitSettings
from ...scene import Grid
from ...scene.effects import Effects, ViewEffect
from .checks import check_image
from .level import Level


class Pixels:
    """A second image and the PSF that it was seen through.

    Parameters
    ----------
    image
        (Z, Y, X) on the grid of the first; NaN marks missing voxels; None: the effect's file.
    grid
        Of the fit.
    view
        The effect.

    Raises
    ------
    InputError
        If there is no image, or it does not lie on the grid.
    """

    def __init__(self, image: np.ndarray | None, grid: Grid, view: ViewEffect) -> None:
        if image is None:
            if not view.image:
                raise InputError(f"{view.name} has no image: name its file by 'image'")
            image = read_image(view.image)[0]
        try:
            self.values, self.known = check_image(image, grid)
        except InputError as error:
            raise InputError(f"second view: {error}") from None
        self.optics = GaussianPSF(view.sigma)

    def restricted(self, counted: np.ndarray) -> None:
        """Leave out voxels, (Z, Y, X) bool."""
        self.known = self.known & (np.asarray(counted) != 0)

    def level(
        self, grid: Grid, optics: Optics, settings: FitSettings, effects: Effects, factor: float
    ) -> Level:
        """This image at the level of the first: the same grid and blur."""
        # Those of the first image's background and camera are not those of this one.
        own = effects.of_a_further_image()
        return Level(
            self.values, self.known, grid, optics, settings, own, factor, own_optics=self.optics
        )
