"""Moments of a fit that a user can go back to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from ..fitting import FitState
from ..geometry import Mesh
from ..optics import GaussianPSF, Optics

MOST = 200  # moments kept: the meshes of more would fill the memory


@dataclass(frozen=True, eq=False)
class Moment:
    """What is kept from one iteration.

    iteration : counts from 1, and on through runs that continue one another.
    loss : see ``FitState``; NaN where the mesh was changed by hand after the fit.
    mesh : um.
    optics : the PSF.
    note : what the user did there; usually empty.
    """

    iteration: int
    loss: float
    mesh: Mesh
    optics: GaussianPSF | Optics
    note: str = ""


class Timeline:
    """The moments of a fit, evenly spread over it, at most ``most`` of them.

    The first, the newest and those with a note are always kept. When it is full, every other one of
    the rest is dropped, and from then on half as many are kept.

    Parameters
    ----------
    moments : those to begin with.
    most : how many are kept; more only if they have notes.
    """

    def __init__(self, moments: Iterable[Moment] = (), most: int = MOST) -> None:
        self._moments: list[Moment] = list(moments)
        self._most = max(most, 4)
        self._stride = 1  # iterations, at least, between two moments that stay
        self._before = 0  # iterations of the runs before the present one
        self._thin_out()

    @property
    def moments(self) -> tuple[Moment, ...]:
        """All moments, in the order in which they were added."""
        return tuple(self._moments)

    def add(self, state: FitState, note: str = "") -> Moment:
        """Add a state and return its moment."""
        iteration = self._before + state.iteration
        moment = Moment(iteration, float(state.loss), state.mesh, state.optics, note)
        kept = self._moments
        if kept and kept[-1].mesh is moment.mesh and kept[-1].optics is moment.optics:
            moment = replace(moment, note=_joined(kept[-1].note, note))
            kept[-1] = moment
            return moment
        # The newest so far is dropped again if it follows too closely on one that stays.
        passing = len(kept) > 1 and not kept[-1].note
        if passing and kept[-1].iteration - kept[-2].iteration < self._stride:
            kept.pop()
        kept.append(moment)
        self._thin_out()
        return moment

    def go_on(self) -> None:
        """Start counting the iterations of a new run that continues from a moment of this one."""
        self._before = max((moment.iteration for moment in self._moments), default=0)

    def nearest(self, iteration: int) -> int | None:
        """Return the index of the moment nearest to an iteration; None if there are no moments."""
        if not self._moments:
            return None
        return min(
            range(len(self._moments)), key=lambda k: abs(self._moments[k].iteration - iteration)
        )

    def _thin_out(self) -> None:
        if len(self._moments) <= self._most:
            return
        first, *rest, last = self._moments
        self._stride *= 2
        thinned, keep = [], False
        for moment in rest:
            if moment.note:
                thinned.append(moment)
            else:
                if keep:
                    thinned.append(moment)
                keep = not keep
        self._moments = [first, *thinned, last]


def _joined(before: str, note: str) -> str:
    return "; ".join(filter(None, (before, note)))


def explained(loss: float) -> float:
    """Per cent of the counted voxels' variation that is explained; NaN if the loss is not known."""
    return 100 * (1 - loss)
