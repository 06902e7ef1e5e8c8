"""The second image of a scene that was seen twice: one more term of the loss, one more image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from torch import Tensor

from ..errors import InputError
from ..images import read_image
from ..optics import GaussianPSF, Optics
from ..scene import Grid, Renderer
from ..scene.effects import Effects, SecondView
from ..settings import FitSettings
from .checks import check_image
from .level import Level
from .likelihood import Match, match


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

    def __init__(self, image: np.ndarray | None, grid: Grid, view: SecondView) -> None:
        if image is None:
            if not view.image:
                raise InputError("second_view has no image: name its file by 'image'")
            image = read_image(view.image)[0]
        try:
            self.values, self.known = check_image(image, grid)
        except InputError as error:
            raise InputError(f"second view: {error}") from None
        self.optics = GaussianPSF(view.sigma)

    def restricted(self, counted: np.ndarray) -> None:
        """Leave out voxels, (Z, Y, X) bool."""
        self.known = self.known & (np.asarray(counted) != 0)


class SecondTerm:
    """What the second image adds to the loss of a level.

    It shares grid, blur and mesh transform with the level of the first image.
    """

    def __init__(
        self,
        pixels: Pixels,
        grid: Grid,
        level_optics: Optics,
        settings: FitSettings,
        effects: Effects,
        factor: float,
    ) -> None:
        self.optics = pixels.optics
        # Those of the first image's background and camera are not those of this one.
        own = effects.without("background", "camera", "missing")
        self._level = Level(pixels.values, pixels.known, grid, level_optics, settings, own, factor)
        self._level.reach_of(self.optics)

    def added_to(self, first: Match, level: Level, renderer: Renderer, transform: Tensor) -> Match:
        """The match of the first image with the mean loss of both.

        The second image has an amplitude and a background of its own.
        """
        rendered = level.rendered(renderer, transform, renderer.otf(self.optics))
        voxels = self._level.voxels(rendered.detach())
        own = match(voxels.of(rendered), voxels.measured, voxels.weights)
        return replace(first, loss=(first.loss + own.loss) / 2)
