"""What is fitted besides the surface: parameters of the PSF and of effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...geometry.mesh import FloatArray
from ...optics import ConfocalPSF, GaussianMixturePSF, GaussianPSF, Optics
from ...scene.columns import Now, effect_columns
from ...scene.effects import Effect, Effects, OffsetEffect
from .level import Voxels
from .likelihood import total

# Standard deviation of the prior on a parameter of the PSF, as a share of how far it may go: 0.5 of
# a log width, of which starts wrong by a factor of two are found (benchmarks/speed).
_PRIOR = 0.36
# Standard deviation of log(width along Y / width along X) around what it is at the start:
# objectives are round, and more of a difference is of what the model does not show. Measured: half
# and twice move surfaces of single cells by 0.004 voxel at most.
_ROUND = 0.002
# Standard deviation of log(excitation / emission) around what it is at the start: dyes tell it, and
# images hardly do. Measured: left free, the ratio stands in for what a model lacks (it ended at 0.3
# in a real droplet). With 0.03 it ended at 1.2 to 1.4 in cells with spherical aberration, and the
# fits were given up; with 0.002, 0.6 and 0.77 rad of that were found within 0.02 (two cells).
_STOKES = 0.002
_EFFECT_PRIOR = 100.0  # the same of an effect's, in units of its scale: their bounds say enough
_OF_RATIO = np.array([[1.0, -1.0], [-1.0, 1.0]])  # exact: second derivatives of half its square


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
    intensity
        What numbers in the unit of the image are counted in, so that its unit changes no fit.
    """

    optics: Optics
    effects: Effects
    start: Optics
    fit_psf: bool
    fit_effects: bool
    intensity: float = 1.0

    def numbers(self) -> tuple[FloatArray, FloatArray]:
        """(P,) of the PSF and (E,) of the effects, as they are now."""
        p = self.optics.parameters().detach().numpy() if self.fit_psf else np.zeros(0)
        parts = [self._counted(e) for e in self.fitted]
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
            own = self._unit(effect) * numbers[at : at + n]
            changed[effect.name] = effect.with_parameters(torch.tensor(own))
            at += n
        return self.effects.replace(**changed) if changed else self.effects

    def effect_columns(self, now: Now) -> list[Tensor]:
        """(N,) each: derivatives of the image by the numbers of effects."""
        found = []
        for effect in self.fitted:
            own = effect_columns(now, getattr(now.effects, effect.name))
            found += [self._unit(effect) * column for column in own]
        return found

    def effect_sums(self, now: Now, voxels: Voxels, factors: Tensor) -> FloatArray:
        """(E,) factors (N,) times each of these columns, summed over the voxels."""
        grid, frame = now.level.grid, now.level.frame
        found = list[float]()
        for effect in self.fitted:
            own, unit = getattr(now.effects, effect.name), self._unit(effect)
            if isinstance(own, OffsetEffect):
                image = voxels.image(factors, grid.shape).cpu()
                sums = own.summed(image, grid, frame).tolist()
            else:
                columns = effect_columns(now, own)
                sums = [float(total(column.to(factors) * factors)) for column in columns]
            found += [unit * value for value in sums]
        return np.array(found)

    def _counted(self, effect: Effect) -> FloatArray:
        found: FloatArray = effect.parameters().numpy() / self._unit(effect)
        return found

    def _unit(self, effect: Effect) -> float:
        return self.intensity if isinstance(effect, OffsetEffect) else 1.0

    def bounded(self, optics: FloatArray, effects: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Both within their bounds."""
        if len(optics):
            low, high = (t.numpy() for t in self.start.limits())
            optics = np.clip(optics, low, high)
        if len(effects):
            chosen = self.effects_of(effects)
            kept = [self._counted(getattr(chosen, e.name)) for e in self.fitted]
            effects = np.concatenate(kept)
        return optics, effects

    def prior(
        self, optics: FloatArray, effects: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Nats, and their gradients (P,), (E,)."""
        away = optics - self.start.parameters().detach().numpy() if len(optics) else np.zeros(0)
        pull = self._optics_precision(len(optics)) @ away
        drawn = effects / _EFFECT_PRIOR**2
        return 0.5 * float(pull @ away) + 0.5 * float(drawn @ effects), pull, drawn

    def prior_curvature(self) -> FloatArray:
        """(P + E, P + E) second derivatives of the prior."""
        p, e = (len(numbers) for numbers in self.numbers())
        found = np.eye(p + e) / _EFFECT_PRIOR**2
        found[:p, :p] = self._optics_precision(p)
        return found

    def _optics_precision(self, count: int) -> FloatArray:
        """(P, P) of the prior on the PSF's parameters, P being ``count``."""
        if not count:
            return np.zeros((0, 0))
        low, high = (t.numpy() for t in self.start.limits())
        found = np.diag((_PRIOR * (high - low) / 2) ** -2.0)
        for pair in _equally_wide(self.start):
            found[np.ix_(pair, pair)] += _OF_RATIO / _ROUND**2
        fitted = self.start.fitted if isinstance(self.start, ConfocalPSF) else ()
        if {"wavelength", "excitation"} <= set(fitted):
            both = [fitted.index(name) for name in ("wavelength", "excitation")]
            found[np.ix_(both, both)] += _OF_RATIO / _STOKES**2
        return found


def _equally_wide(optics: Optics) -> list[list[int]]:
    """Pairs of fitted numbers of a PSF that are widths across, whose ratio stays as it is.

    Those along Y and X; and of Gaussians of a mixture that are equally wide.
    """
    if isinstance(optics, GaussianPSF):
        return [[1, 2]] if optics.diagonal else []
    if not isinstance(optics, GaussianMixturePSF):
        return []
    along_y = [name for name in optics.values if name.endswith("_y")]
    pairs = [(name, name.replace("_y", "_x")) for name in along_y]
    same = (_close(optics.values[name], optics.values[along_y[0]]) for name in along_y[1:])
    pairs += [(along_y[0], name) for name, tied in zip(along_y[1:], same, strict=True) if tied]
    free = optics.fitted
    return [[free.index(name) for name in pair] for pair in pairs if {*pair} <= {*free}]


def _close(width: Tensor, other: Tensor) -> bool:
    """Whether a fit has kept two widths alike, as far as a prior of that strength does."""
    return abs(float(torch.log(width / other).detach())) < 5 * _ROUND
