"""What a fit says of itself: remarks, alarms, and a verdict at its end."""

from __future__ import annotations

from ..common.triple import Triple
from ..common.words import counted
from ..geometry.mesh import Mesh
from .model.fitted import Fitted
from .model.likelihood import Match
from .surface.growth_alarm import GrowthAlarm, shrunken, told_shrunken, why_stuck

_ALARMS_EVERY = 10  # iterations: regions grow slowly; areas of all faces would take time each


class Reporter:
    """Collects what there is to say until the next state.

    Parameters
    ----------
    mesh
        At the start.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._growth = GrowthAlarm(mesh)
        self._remarks: tuple[str, ...] = ()
        self._events: tuple[str, ...] = ()

    def say(self, *remarks: str) -> None:
        """Tell this with the next state."""
        self._remarks += tuple(filter(None, remarks))

    def happened(self, events: tuple[str, ...]) -> None:
        """Changes of topology, a sentence each."""
        self._events += events

    def other_mesh(self, mesh: Mesh) -> None:
        """Growth is counted from this mesh on."""
        self._growth = GrowthAlarm(mesh)

    def remeshed(self, before: Mesh, after: Mesh) -> None:
        """Growth goes on with other faces."""
        self._growth.remeshed(before, after)

    def told(self, mesh: Mesh, iteration: int, ends: bool) -> tuple[str, tuple[str, ...]]:
        """The message and the events of a state."""
        due = ends or iteration % _ALARMS_EVERY == 0
        warning = self._growth.check(mesh) if due else ""
        events, remarks = self._events, self._remarks
        self._events = self._remarks = ()
        return joined(*remarks, *events, warning), events


def joined(*sentences: str) -> str:
    """One message of those that are there."""
    return "; ".join(filter(None, sentences))


def verdict(
    fitted: Fitted,
    found: Match,
    finished: bool,
    iteration: int,
    moving: Triple | None,
    so_far: str,
) -> tuple[str, bool]:
    """What came of a fit in plain words, and whether it has converged.

    Parameters
    ----------
    finished
        Whether it ended by itself.
    moving
        um: the place that still moves; None where none does.
    so_far
        What else there is to say.
    """
    mesh = fitted.mesh
    points = shrunken(mesh, min(fitted.optics.sigma_um))
    cells, explained = len(mesh.region_ids()), 1 - min(found.loss, 1)
    stuck = why_stuck(explained, found.bounded, points, cells) if finished else ""
    message = stuck or ("converged" if finished else "")
    after = f"stopped after {counted(iteration, 'iteration')}"
    message = message or f"{after}, before it converged"
    further = "" if stuck else told_shrunken(points)
    if finished and not stuck and moving is not None:
        z, y, x = moving
        message += f", except at ({z:.1f}, {y:.1f}, {x:.1f}) um, where the surface still moves"
    return joined(message, so_far, further), finished and not stuck
