"""What is fitted besides the surface: parameters of the PSF and of effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..geometry.mesh import FloatArray
from ..optics import Optics
from ..scene import Renderer
from ..scene.effects import Effect, Effects, GainEffect, OffsetEffect, TransferEffect
from .level import Level, Voxels

_DIFFERENCE = 1e-3  # of optics' parameters
_EFFECT_DIFFERENCE = 1e-2  # of effects', in units of their scale
# Standard deviation of the prior on a parameter of the PSF, as a share of how far it may go: 0.5 of
# a log width, of which starts wrong by a factor of two are found (benchmarks/speed).
_PRIOR = 0.36
_EFFECT_PRIOR = 100.0  # the same of an effect's, in units of its scale: their bounds say enough

Transform = Callable[[Renderer], Tensor]  # of the present mesh and density


@dataclass(frozen=True, eq=False)
class Imaging:
    """PSF and effects: their numbers as unknowns of a fit, their bounds and priors.

    Attributes
    ----------
    optics, effects
        Kinds and whatever is held.
    start
        The PSF at the start, around which its prior lies.
    fit_psf
        Whether the PSF is fitted.
    fit_effects
        Whether effects are.
    """

    optics: Optics
    effects: Effects
    start: Optics
    fit_psf: bool
    fit_effects: bool

    def numbers(self) -> tuple[FloatArray, FloatArray]:
        """(P,) of the PSF and (E,) of the effects, as they are now."""
        p = self.optics.parameters().detach().numpy() if self.fit_psf else np.zeros(0)
        parts = [e.parameters().numpy() for e in self.fitted]
        return p.astype(np.float64), np.concatenate(parts) if parts else np.zeros(0)

    @property
    def fitted(self) -> tuple[Effect, ...]:
        """The effects whose numbers are fitted."""
        return self.effects.fitted() if self.fit_effects else ()

    def optics_of(self, numbers: Tensor) -> Optics:
        """The PSF with other numbers (P,), differentiable in them."""
        return self.optics.with_parameters(numbers) if self.fit_psf else self.optics

    def effects_of(self, numbers: FloatArray) -> Effects:
        """The effects with other numbers (E,)."""
        changed: dict[str, Effect] = {}
        at = 0
        for effect in self.fitted:
            n = len(effect.parameters())
            changed[effect.name] = effect.with_parameters(torch.tensor(numbers[at : at + n]))
            at += n
        return self.effects.replace(**changed) if changed else self.effects

    def bounded(self, optics: FloatArray, effects: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Both within their bounds."""
        if len(optics):
            low, high = (t.numpy() for t in self.start.limits())
            optics = np.clip(optics, low, high)
        if len(effects):
            chosen = self.effects_of(effects)
            kept = [getattr(chosen, e.name).parameters().numpy() for e in self.fitted]
            effects = np.concatenate(kept)
        return optics, effects

    def prior(
        self, optics: FloatArray, effects: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Nats, and their gradients (P,), (E,)."""
        pull = np.zeros(0)
        value = 0.0
        if len(optics):
            _, high = (t.numpy() for t in self.start.limits())
            center = self.start.parameters().detach().numpy()
            pull = (optics - center) / (_PRIOR * (high - center)) ** 2
            value += 0.5 * float(pull @ (optics - center))
        drawn = effects / _EFFECT_PRIOR**2
        return value + 0.5 * float(drawn @ effects), pull, drawn

    def prior_curvature(self) -> FloatArray:
        """(P + E,) second derivatives of the prior."""
        p, e = self.numbers()
        here = np.zeros(0)
        if len(p):
            low, high = (t.numpy() for t in self.start.limits())
            here = (_PRIOR * (high - low) / 2) ** -2.0
        return np.concatenate([here, np.full(len(e), _EFFECT_PRIOR**-2.0)])


@dataclass(frozen=True)
class Now:
    """Where derivatives of an image by its PSF and effects are taken.

    Attributes
    ----------
    level, renderer, optics, effects
        As they are.
    transform
        Transforms the present mesh for a renderer with other effects.
    spectrum, otf, image
        Of the present mesh; the image at the voxels that count.
    voxels
        Those.
    amplitude
        Of the image.
    """

    level: Level
    renderer: Renderer
    optics: Optics
    effects: Effects
    transform: Transform
    spectrum: Tensor
    otf: Tensor
    image: Tensor
    voxels: Voxels
    amplitude: float


def optics_columns(now: Now) -> list[Tensor]:
    """(N,) derivatives of the measured image by each parameter of the PSF."""
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
    """(N,) derivatives of the measured image by each of the effect's parameters."""
    p = effect.parameters()
    columns = []
    for i in range(len(p)):
        change = torch.zeros_like(p)
        change[i] = _EFFECT_DIFFERENCE
        # Where a bound is near, the difference is one-sided.
        up, down = effect.with_parameters(p + change), effect.with_parameters(p - change)
        width = float((up.parameters() - down.parameters())[i])
        columns.append(_difference(now, up, down, effect) / width)
    return columns


def _difference(now: Now, up: Effect, down: Effect, effect: Effect) -> Tensor:
    """What the measured image changes by, from one value of an effect to another."""
    grid, frame, voxels = now.level.grid, now.level.frame, now.voxels
    if isinstance(effect, OffsetEffect):
        assert isinstance(up, OffsetEffect)
        assert isinstance(down, OffsetEffect)
        change = up.offset(grid, frame) - down.offset(grid, frame)
        return voxels.of(change.expand(grid.shape)).to(now.image.dtype)
    if isinstance(effect, GainEffect):
        assert isinstance(up, GainEffect)
        assert isinstance(down, GainEffect)
        ratio = (up.gain(grid, frame) - down.gain(grid, frame)) / effect.gain(grid, frame)
        factor = voxels.of(ratio.expand(grid.shape)).to(now.image.dtype)
        return now.amplitude * now.image * factor
    ends = [now.renderer.with_effects(now.effects.replace(**{effect.name: e})) for e in (up, down)]
    spectrum, otf = now.spectrum, now.otf
    if isinstance(effect, TransferEffect) or effect.name == "depth_psf":
        otf = ends[0].otf(now.optics) - ends[1].otf(now.optics)
    else:
        spectrum = now.transform(ends[0]) - now.transform(ends[1])
    return now.amplitude * voxels.of(now.level.rendered(now.renderer, spectrum, otf))
