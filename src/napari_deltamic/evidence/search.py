"""The search for the effects that an image calls for: add the clearest, refit, repeat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import log, sqrt

import numpy as np

from ..fitting.model.state import FitState
from ..runs.settings import FitSettings
from ..scene import Grid
from ..scene.effects import Effect, Effects
from .candidates import allowed, at_estimate, beyond_bounds, points_inwards, variants
from .crop import crop_of
from .evidence_rules import JUDGING
from .modes import density_fields
from .part_model import PartModel, Settled
from .score import Score, block_sizes, score
from .voxel_variance import Variance

_EXPLAINED = "the others explain it"
_UNCLEAR = "not significant compared with the remaining misfit"
_AT_BOUND = "it fits only with a parameter at its bound, so something else resembles it"


@dataclass(frozen=True)
class Judged:
    """An effect, its score, and whether it is in the scene."""

    effect: Effect
    score: Score
    chosen: bool


class Search:
    """Scores of effects around a fitted scene, and the scene refitted with those chosen.

    Parameters
    ----------
    image
        (Z, Y, X) without NaN.
    usable
        (Z, Y, X) bool: voxels that may count.
    grid
        Grid of the image.
    fitted
        Last state of a fit.
    effects
        Effects of that fit; they stay.
    variance
        Variance of voxels as a function of the expected image.
    settings
        Settings of the fit: whether the PSF was fitted, and how the density.
    candidates
        How many effects are considered.
    """

    def __init__(
        self,
        image: np.ndarray,
        usable: np.ndarray,
        grid: Grid,
        fitted: FitState,
        effects: Effects,
        variance: Variance,
        settings: FitSettings,
        candidates: int,
    ) -> None:
        density = None if np.ptp(fitted.density) == 0 else fitted.density
        width = np.asarray(fitted.optics.sigma_um)
        self.part = part = crop_of(usable, grid, fitted.mesh, density, width)
        index = part.index
        self.blocks = block_sizes(index, part.grid.shape, width / np.asarray(grid.voxel_size))
        self.held = effects.names
        self.dropped: dict[str, str] = {}  # name -> reason; these are not added again
        self.model = PartModel(part, image, grid, variance, settings)
        # G. Schwarz's criterion for one further number, corrected for the number of candidates.
        self.threshold = sqrt(log(len(index)) + 2 * log(max(candidates, 1)))
        even = np.ones(len(part.mesh.faces))
        weights = even if part.density is None else part.density
        state = replace(fitted, mesh=part.mesh, density=weights, effects=effects)
        self._take_up(self.model.begun(state))

    def _take_up(self, settled: Settled) -> None:
        self.now = settled
        self._judged: dict[str, Judged] = {}

    @property
    def scene(self) -> FitState:
        """The fit of the part that is judged."""
        return self.now.state

    def run(self, names: tuple[str, ...], tell: Callable[[str], None]) -> None:
        """Add the clearest effect and refit until none is left above the threshold.

        Effects that are still missing cause misfit far and wide. So effects are added by what they
        explain compared with the misfit nearby, and in the end only those stay that are clear
        compared with all the misfit that is left.
        """
        for _ in range(JUDGING.most_rounds):
            left = (n for n in names if n not in {*self.dropped, *self.scene.effects.names})
            found = [self.judged(n) for n in left]
            clear = [
                j
                for j in found
                if abs(j.score.near) > self.threshold
                and allowed(j.effect, self.scene.effects)
                and points_inwards(j.effect, j.score.estimate)
            ]
            if not clear:
                break
            best = max(clear, key=lambda j: abs(j.score.near))
            tell(f"{best.effect.name}: z = {best.score.near:.1f}")
            self._take(best)
            self._drop_least(lambda s: abs(s.near), _EXPLAINED)
        while (name := self._drop_least(lambda s: abs(s.z), _UNCLEAR)) is not None:
            tell(f"{name} left out: {self.dropped[name]}")

    def _take(self, best: Judged) -> None:
        effect = at_estimate(best.effect, best.score.estimate)
        effects = self.scene.effects.adding(effect)
        self._take_up(self.model.with_effects(self.now, effects, -best.score.shape))

    def _drop_least(self, size: Callable[[Score], float], why: str) -> str | None:
        """Remove the effect with the smallest score unless it is above the threshold; its name.

        An effect with a number at its bound stands for something else, and counts as score 0.
        """
        chosen = [n for n in self.scene.effects.names if n not in self.held]
        if not chosen:
            return None

        def told(judged: Judged) -> float:
            # An effect without numbers is not there if its score is negative.
            unwanted = not judged.effect.bounds and judged.score.z < 0
            odd = unwanted or beyond_bounds(judged.effect)
            return 0.0 if odd else size(judged.score)

        least = min((self.judged(n) for n in chosen), key=told)
        if told(least) > self.threshold:
            return None
        name = least.effect.name
        self.dropped[name] = _AT_BOUND if beyond_bounds(least.effect) else why
        effects = self.scene.effects.without(name)
        self._take_up(self.model.with_effects(self.now, effects, least.score.shape))
        return name

    def judged(self, name: str) -> Judged:
        """The score of an effect given all others in the scene; cached until the next refit."""
        if name not in self._judged:
            self._judged[name] = self._judge(name)
        return self._judged[name]

    def _judge(self, name: str) -> Judged:
        present = getattr(self.scene.effects, name)
        if present is not None:
            return Judged(present, self._without(present), True)
        found = []
        for effect in variants(name, self.scene.optics):
            told = score(self.now.linearised, self.now.columns(effect), self.blocks)
            found.append(Judged(effect, told, False))
        return max(found, key=lambda j: abs(j.score.z))

    def misfit(self) -> float:
        """Mean square of what is left, in variances of noise: 1 if the scene explains it all."""
        return float((self.now.linearised.rest**2).mean())

    def density(self) -> Score | None:
        """The score of a smoothly varying density; None if one is fitted, or without membranes."""
        if self.model.density_fitted or not self.scene.light.membrane:
            return None
        fields = density_fields(self.scene.mesh, "smooth", self.part.cells)
        columns = self.model.density_columns(self.now, fields)
        return score(self.now.linearised, columns, self.blocks)

    def _without(self, effect: Effect) -> Score:
        """The score of an effect as if the scene had been fitted without it, in linear order."""
        at, columns = self.now.linearised, self.now.columns(effect)
        neutral = type(effect).neutral()
        if effect.bounds:
            change = effect.parameters().numpy() - neutral.parameters().numpy()
            # The width of an effect says nothing about its amount.
            change[[value.name in effect.tried_widths for value in effect.values()]] = 0.0
        else:
            change = np.ones(1)
        residual = at.residual + (columns @ change) * at.root
        without = at.without(self.now.own_columns(effect), residual)
        return score(without, columns, self.blocks)

    def left_in(self, where: np.ndarray) -> tuple[float, float]:
        """What uninformative voxels do to a fit if they are left in.

        Parameters
        ----------
        where
            (Z, Y, X) bool: voxels of the whole image that are not evidence here.

        Returns
        -------
        score
            Standard deviations by which they differ from what is expected there.
        bias
            How far they move the surface, um.
        """
        index = np.flatnonzero(where[self.part.box])
        if not len(index):
            return 0.0, 0.0
        both = self.model.with_voxels(self.now, index)
        shape, residual = both.solve(both.residual)[: both.modes], both.residual[-len(index) :]
        excess = float((residual**2).sum()) - len(index)
        return excess / sqrt(2 * len(index)), self.model.modes.size(shape)
