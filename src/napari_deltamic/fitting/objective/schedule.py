"""Levels, windows and patience: when a level goes on, is posed anew, or ends."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf

from .convergence import Remaining


@dataclass(frozen=True)
class Schedule:
    """When levels end.

    Attributes
    ----------
    renewed_every
        Iterations after which voxels, weights and plan are made anew: the surface has moved.
    strayed, strayed_far
        Or as soon as this share of the vertices has moved so far, in widths of the blurred PSF,
        which is also as far as they may: further away are voxels that do not count.
    window
        Iterations over which gain and movement are judged. Measured: half and twice change the
        iterations of small fits by 0.3 and 0.2 to 0.85 of them.
    coarse_gain
        A coarse level ends when a window gains less than this share of the objective ...
    coarse_most
        ... or after so many iterations: it only has to bring the next one within reach. More of
        them did not bring cow and fish any nearer in the end, fewer left starts unfound.
    gain
        Nats. The last level ends when no patch as wide as the PSF that would move by more than the
        tolerance would gain more: with 0.1, none is further from where it belongs than half of
        its own standard deviation.
    moving
        Or, after a while, when no more than this share of the patches would: on large surfaces
        there are always some where the image shows what no mesh describes. The worst is named.
        About one patch of a small surface.
    drift
        Nor does it end while the surface as a whole still drifts, within a window by more than so
        many times the tolerance (:func:`~.convergence.drifted`). Down a valley, where surface,
        brightness and PSF stand in for each other, each step gains little and hides how far it
        still goes: a nucleus ended 24 % too small. Measured: other small fits end at 0.2 to 2
        times.
    patience, doubled_every
        Iterations of the level that make that while, and those after which that share has doubled:
        an embryo in haze had explained ever more by ever narrower membranes, and lay 0.58 voxel off
        after 60 iterations, 0.60 after 180, as measured.
    rests
        Iterations in a row for which that must hold: single ones are met by chance.
    held
        Steps in a row after which a vertex that was held back by the guard counts as at rest: a
        single one could be chance.
    level_variance
        Share by which the variance of the residuals may change from one objective to the next
        before that counts. Measured: half and twice change nothing in small fits.
    fallen
        Share by which an objective may have fallen since it was posed when a fit ends: else it is
        posed anew, as what is uneven inside was read around a surface further off. Measured: at
        most 0.022 in 18 small fits; 0.067 in one that ended 7 % too large, and at 1 % once posed
        anew.
    worth_renewing
        Share by which the squares that are left must have fallen since the objective before: else
        its voxels and weights stay. Voxels that follow a surface where the image shows what no
        mesh describes would have it move for ever (seen on an embryo with foreign light).
    imaging_below
        Widths of the blurred PSF over that of the PSF from which on PSF and effects are fitted: at
        the last level. From 2.5 on, they stood in for shapes that were still far off where light
        inside was free as well (nuclei, benchmarks.defaults).
    """

    renewed_every: int = 20
    strayed: float = 0.02
    strayed_far: float = 1.5
    window: int = 5
    coarse_gain: float = 0.02
    coarse_most: int = 30
    gain: float = 0.1
    moving: float = 0.01
    drift: float = 2.0
    patience: int = 60
    doubled_every: int = 20
    rests: int = 2
    held: int = 3
    level_variance: float = 0.1
    fallen: float = 0.03
    worth_renewing: float = 0.01
    imaging_below: float = 1.2

    def may_move(self, iterations: int) -> float:
        """Share of the patches that may still move after so many iterations of the last level."""
        return 0.0 if iterations < self.patience else self.moving * self._relaxed(iterations)

    def may_drift(self, iterations: int) -> float:
        """Tolerances by which the surface may still drift."""
        return self.drift * self._relaxed(iterations)

    def _relaxed(self, iterations: int) -> float:
        late = max(iterations - self.patience, 0)
        return float(2.0 ** (late / self.doubled_every))


@dataclass(frozen=True)
class Progress:
    """How far a level has come.

    Attributes
    ----------
    iterations
        Of the level.
    since_posed
        Since its objective was posed.
    values
        Of the objective since then, nats, its first one included.
    variance
        Of the residuals in it; 0 before the first.
    left
        See :class:`~.posed.Posed`.
    held
        Whether voxels and weights stay what they are.
    settled
        Whether the variance is about that of the objective before.
    stuck
        How often no way down was found since a step last gained something.
    rests
        How often in a row hardly anything was left to gain.
    sure
        Whether it is clear what shines.
    answered
        Whether that was asked at rest since the surface last went elsewhere.
    asked_again
        Whether what had left was asked for again, for the last time.
    unsure
        Whether what else might shine explained as much, or nearly so: membranes when they were
        asked for again; of a fit of both, insides alone where it ended.
    nuclei
        Whether insides around dark nuclei were tried, for the only time.
    """

    iterations: int = 0
    since_posed: int = 0
    values: tuple[float, ...] = field(default=())
    variance: float = 0.0
    left: float = 0.0
    held: bool = False
    settled: bool = False
    stuck: int = 0
    rests: int = 0
    sure: bool = False
    answered: bool = False
    asked_again: bool = False
    unsure: bool = False
    nuclei: bool = False

    def posed(
        self,
        value: float,
        variance: float,
        schedule: Schedule,
        left: float = 0.0,
    ) -> Progress:
        """The objective is another one; value : at its start, nats. The rest: see ``Posed``."""
        change = abs(variance / self.variance - 1) if self.variance > 0 else 1.0
        settled = change < schedule.level_variance
        fallen = 1 - left / self.left if self.left > 0 else 1.0
        little = settled and fallen < schedule.worth_renewing
        return replace(
            self,
            since_posed=0,
            values=(value,),
            rests=0,
            variance=variance,
            left=left,
            settled=settled,
            held=self.held or little,
        )

    def freed(self) -> Progress:
        """Voxels and weights are chosen anew."""
        return replace(self, held=False)

    def released(self) -> Progress:
        """The surface goes elsewhere: voxels and weights have to follow."""
        return replace(self, held=False, left=0.0, answered=False)

    def stepped(self, value: float, moved: bool, schedule: Schedule) -> Progress:
        """One iteration more; whether it found a way down.

        A step that gains next to nothing does not count as a way: where there is only noise, the
        first step after each new objective finds one, and the fit would never end.
        """
        before = self.values[-1] if self.values else inf
        found = moved and before - value > schedule.gain
        return replace(
            self,
            iterations=self.iterations + 1,
            since_posed=self.since_posed + 1,
            values=(*self.values, value),
            stuck=0 if found else self.stuck + (not moved),
        )

    def final(self, schedule: Schedule) -> bool:
        """Whether the objective is that of a surface about where it is now."""
        fallen = 1 - self.values[-1] / self.values[0] if self.values[:1] > (0.0,) else 0.0
        return self.settled and fallen <= schedule.fallen

    def coarse_ends(self, schedule: Schedule) -> bool:
        """Whether a coarse level is done."""
        if self.iterations >= schedule.coarse_most or self.stuck > 1:
            return True
        if self.since_posed < schedule.window:
            return False
        return 1 - self.values[-1] / self.values[-1 - schedule.window] < schedule.coarse_gain

    def looked(self, remaining: Remaining, tolerance: float, schedule: Schedule) -> Progress:
        """Whether hardly anything is left to gain has been looked at. tolerance : um."""
        moves = remaining.move > tolerance and remaining.gain > schedule.gain
        little = not moves or remaining.share <= schedule.may_move(self.iterations)
        little &= remaining.drift <= schedule.may_drift(self.iterations) * tolerance
        rests = little and self.since_posed >= schedule.window
        return replace(self, rests=self.rests + 1 if rests else 0)

    def at_rest(self, schedule: Schedule) -> bool:
        """Whether it is time to end."""
        return self.stuck > 1 or self.rests >= schedule.rests
