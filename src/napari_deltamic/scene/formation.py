"""From a transform on a band to an image: the optics, and what effects make of both."""

from __future__ import annotations

import numpy as np
import torch
from scipy.fft import next_fast_len
from torch import Tensor

from ..common.one_thread import in_one_thread
from ..errors import InputError
from ..fourier import Band
from ..optics import Optics
from ..optics.gaussian import gaussian_reach
from .effects import Effect, Effects, GainEffect, TransferEffect
from .effects.base import Axes
from .grid import Grid

_LARGEST_PERIOD = 8  # times the grid: a mesh further away is in other units


class Formation:
    """How an image is formed of what shines: the part of rendering that asks for no structure.

    Parameters
    ----------
    grid
        Of the image.
    frame
        Grid of the whole image, to which effects refer.
    blur
        um along Z, Y, X: a further Gaussian on top of the optics.
    effects
        Those on the side of the OTF and of the image are applied; absent ones are not asked for.
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
        """Shape of the periodic grid on which no copy of what lies at (N, 3) um is seen.

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
        """The optics, the extra blur and what effects make of them, on the box of a band.

        Two such boxes where the PSF changes with depth.
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
        """Whether nothing but the OTF is between a transform and its image."""
        return self.effects.depth is None and not self._gains

    def image(
        self, transform: Tensor, otf: Tensor, band: Band, known: Tensor | None = None
    ) -> Tensor:
        """Image (Z, Y, X): fluorophores seen in each voxel; its sum over all space is the total.

        known : the image, where only its gradients are wanted; of use where :attr:`is_plain`.
        """
        if self.effects.depth is None:
            image = band.to_image(transform, self.grid.shape, otf, known if self.is_plain else None)
        else:
            image = band.to_image(in_one_thread(torch.mul, transform, otf).sum(0), self.grid.shape)
        self._gains = [gain.to(image) for gain in self._gains]  # once: there they stay
        for gain in self._gains:
            image = image * gain
        return image


def _um(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{p:.4g}" for p in point) + ")"


def padded_shape(positions: np.ndarray, grid: Grid, reach: np.ndarray) -> tuple[int, int, int]:
    first, last = grid.extent
    low, high = positions.min(0) - reach, positions.max(0) + reach
    # A copy of the mesh one period away must stay clear of the grid, on either side.
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
