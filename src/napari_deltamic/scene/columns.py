"""Derivatives of the measured image by the PSF's and the effects' numbers, one column each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from ..optics import Optics
from .effects import DepthEffect, Effect, Effects, GainEffect, OffsetEffect, TransferEffect
from .grid import Grid
from .render import Renderer

# Central differences: their error grows as the square of these, that of rounding as their inverse;
# with images in single precision both are about 1e-4 of a column.
_DIFFERENCE = 1e-3  # for the parameters of the optics
_EFFECT_DIFFERENCE = 1e-2  # for those of effects, in units of their scale


class Forming(Protocol):
    """Turns a transform into an image."""

    @property
    def grid(self) -> Grid:
        """The grid of the image."""

    @property
    def frame(self) -> Grid:
        """The grid of the whole image, to which effects refer."""

    def rendered(self, renderer: Renderer, transform: Tensor, otf: Tensor) -> Tensor:
        """Return the image (Z, Y, X) of a transform."""


class Counted(Protocol):
    """The voxels that count."""

    def of(self, image: Tensor) -> Tensor:
        """Return (N,) their values in an image (Z, Y, X)."""


@dataclass(frozen=True)
class Now:
    """The state at which derivatives of an image are taken.

    Attributes
    ----------
    level, renderer, optics, effects
        The present ones.
    transform
        Function that transforms the present structures for a renderer with other effects.
    spectrum, otf, image
        Transform of the present structures, OTF, and image at the counted voxels.
    voxels
        The counted voxels.
    amplitude
        Factor on the image.
    """

    level: Forming
    renderer: Renderer
    optics: Optics
    effects: Effects
    transform: Callable[[Renderer], Tensor]
    spectrum: Tensor
    otf: Tensor
    image: Tensor
    voxels: Counted
    amplitude: float


def optics_columns(now: Now) -> list[Tensor]:
    """Return (N,) derivatives of the measured image by each parameter of the PSF."""
    p = now.optics.parameters()
    columns = []
    for i in range(len(p)):
        change = torch.zeros_like(p)
        change[i] = _DIFFERENCE
        up, down = (
            now.renderer.otf(now.optics.with_parameters(p + sign * change)) for sign in (1, -1)
        )
        difference = now.level.rendered(now.renderer, now.spectrum, up - down)
        columns.append(now.amplitude / (2 * _DIFFERENCE) * now.voxels.of(difference))
    return columns


def effect_columns(now: Now, effect: Effect) -> list[Tensor]:
    """Return (N,) derivatives of the measured image by each parameter of a present effect."""
    p = effect.parameters()
    columns = []
    for i in range(len(p)):
        change = torch.zeros_like(p)
        change[i] = _EFFECT_DIFFERENCE
        # Where a bound is near, the difference is one-sided.
        up, down = effect.with_parameters(p + change), effect.with_parameters(p - change)
        width = float((up.parameters() - down.parameters())[i])
        if width > 0:
            columns.append(_difference(now, up, down, effect) / width)
        else:
            columns.append(torch.zeros_like(now.image))
    return columns


def _difference(now: Now, up: Effect, down: Effect, effect: Effect) -> Tensor:
    """Return the change of the measured image from one value of an effect to another."""
    grid, frame, voxels = now.level.grid, now.level.frame, now.voxels
    if isinstance(effect, OffsetEffect):
        change = effect.with_parameters(up.parameters() - down.parameters()).offset(grid, frame)
        return voxels.of(change.expand(grid.shape)).to(now.image.dtype)
    if isinstance(effect, GainEffect):
        assert isinstance(up, GainEffect)
        assert isinstance(down, GainEffect)
        ratio = (up.gain(grid, frame) - down.gain(grid, frame)) / effect.gain(grid, frame)
        factor = voxels.of(ratio.expand(grid.shape)).to(now.image.dtype)
        return now.amplitude * now.image * factor
    ends = [now.renderer.with_effects(now.effects.adding(e)) for e in (up, down)]
    spectrum, otf = now.spectrum, now.otf
    if isinstance(effect, (TransferEffect, DepthEffect)):
        otf = ends[0].otf(now.optics) - ends[1].otf(now.optics)
    else:
        spectrum = now.transform(ends[0]) - now.transform(ends[1])
    return now.amplitude * voxels.of(now.level.rendered(now.renderer, spectrum, otf))
