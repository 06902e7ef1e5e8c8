"""Forms an image from a transform on a band: the optics, and effects on both."""

from __future__ import annotations

import numpy as np
import torch
from scipy.fft import next_fast_len
from torch import Tensor

from ..common.one_thread import product
from ..errors import InputError
from ..fourier import Band
from ..optics import Optics
from ..optics.gaussian import gaussian_reach
from .effects import Effect, Effects, GainEffect, TransferEffect
from .effects.base import Axes
from .grid import Grid

_LARGEST_PERIOD = 8  # times the grid: a mesh further away is in other units


class Formation:
    """How a transform becomes an image: the part of rendering that does not depend on structures.

    Parameters
    ----------
    grid
        Of the image.
    frame
        Grid of the whole image, to which effects refer.
    blur
        A further Gaussian blur, um along Z, Y, X.
    effects
        Those that act on the OTF and on the image are applied.
    """

    def __init__(
        self, grid: Grid, frame: Grid, blur: tuple[float, float, float], effects: Effects
    ) -> None:
        self.grid, self.frame, self.blur, self.effects = grid, frame, blur, effects
        present: tuple[Effect, ...] = effects.present()
        self._transfers = [e for e in present if isinstance(e, TransferEffect)]
        self._gains = [e.gain(grid, frame) for e in present if isinstance(e, GainEffect)]

    def fft_shape(
        self, positions: np.ndarray, optics: Optics, accuracy: float, margin: float = 0.0
    ) -> tuple[int, int, int]:
        """Return the shape of a periodic grid on which copies of positions (N, 3) um are not seen.

        Raises
        ------
        InputError
            If positions are so far from the grid that their units must be wrong.
        """
        blurred = gaussian_reach(accuracy) * np.asarray(self.blur)
        reach = np.hypot(optics.reach(accuracy), blurred) + margin
        for effect in self.effects.present():
            reach = np.hypot(reach, effect.reach(0.1 * accuracy))
        return padded_shape(positions, self.grid, reach)

    def otf(self, optics: Optics, axes: Axes) -> Tensor:
        """Return the OTF of optics, extra blur and effects on the box of a band.

        Two such boxes if the PSF changes with depth.
        """
        otf = optics.otf(axes)
        for axis, k in enumerate(axes):
            if self.blur[axis] > 0:
                otf = otf * torch.exp(-0.5 * (self.blur[axis] * k) ** 2)
        for effect in self._transfers:
            otf = otf * effect.transfer(axes, self.frame)
        depth = self.effects.depth
        if depth is not None:
            first, last = depth.transfers(axes)
            otf = torch.stack([otf * first, otf * last])
        return otf

    @property
    def is_plain(self) -> bool:
        """Whether there is nothing but the OTF between a transform and its image."""
        return self.effects.depth is None and not self._gains

    def image(
        self, transform: Tensor, otf: Tensor, band: Band, known: Tensor | None = None
    ) -> Tensor:
        """Return the image (Z, Y, X): fluorophores seen in each voxel.

        Its sum over all space is their total number.
        known : the image, if only its gradients are wanted; used only if :attr:`is_plain`.
        """
        if self.effects.depth is None:
            image = band.to_image(transform, self.grid.shape, otf, known if self.is_plain else None)
        else:
            image = band.to_image(product(transform, otf).sum(0), self.grid.shape)
        self._gains = [gain.to(image) for gain in self._gains]  # moved only once
        for gain in self._gains:
            image = image * gain
        return image


def _um(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{p:.4g}" for p in point) + ")"


def padded_shape(positions: np.ndarray, grid: Grid, reach: np.ndarray) -> tuple[int, int, int]:
    first, last = grid.extent
    low, high = positions.min(0) - reach, positions.max(0) + reach
    # Copies of the mesh one period away must stay clear of the grid, on either side.
    period = np.maximum.reduce(
        [last - low, high - first, last - first + np.asarray(grid.voxel_size)]
    )
    n = np.ceil(period / np.asarray(grid.voxel_size) - 1e-9)
    if (n > _LARGEST_PERIOD * (np.asarray(grid.shape) + reach / np.asarray(grid.voxel_size))).any():
        raise InputError(
            f"the mesh reaches from {_um(positions.min(0))} to {_um(positions.max(0))} um, "
            f"the image from {_um(first)} to {_um(last)} um: are the units the same?"
        )
    z, y, x = (int(next_fast_len(int(k), real=True)) for k in n)
    return z, y, x
