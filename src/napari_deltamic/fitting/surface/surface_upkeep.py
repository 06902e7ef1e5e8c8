"""The surface of a fit between two steps: good triangles, changes of topology, no crossings."""

from __future__ import annotations

from ...geometry.mesh import Mesh
from ...runs.settings import FitSettings
from ..model.fitted import Fitted
from ..model.problem import Problem
from .collisions import CollisionGuard
from .topology import TopologyPolicy
from .topology_trials import TopologyTrials
from .triangle_quality import Remeshing


class SurfaceUpkeep(TopologyTrials):
    """What keeps a surface sound: changes of its topology, good triangles, no crossings.

    Parameters
    ----------
    problem
        What is to be explained.
    mesh
        At the start.
    width
        um: of the PSF.
    collisions
        Whether steps that would make surfaces cross are shortened.

    Attributes
    ----------
    guard
        Against crossings.
    """

    def __init__(self, problem: Problem, mesh: Mesh, width: float, collisions: bool) -> None:
        super().__init__(problem)
        self._remeshing = Remeshing(mesh, width)
        self.guard = CollisionGuard(collisions)

    def begin_level(self, mesh: Mesh, blurred: float) -> None:
        """blurred : um, width of the PSF of a blurred level; 0 if it is sharp."""
        self._remeshing.begin_level(mesh, blurred)

    def remeshed(self, fitted: Fitted, settings: FitSettings) -> Fitted:
        """The same with good triangles."""
        if not (settings.remesh and self._remeshing.wanted(fitted.mesh, settings.flatness)):
            return fitted
        after = self._remeshing.of_shape(
            fitted.shape, self.guard, settings.collisions, settings.flatness
        )
        return fitted if after is None else fitted.retriangulated(after)

    def guarded(self, collisions: bool) -> None:
        """Guard against crossings from now on, or no more."""
        self.guard = CollisionGuard(collisions)

    def edges_given(self) -> None:
        """The mesh was replaced from outside: its edges stay until the next level."""
        self._remeshing.given()

    def saved(self) -> dict[str, float]:
        """What a checkpoint keeps of the triangles."""
        return self._remeshing.to_dict()

    def resume(self, policy: TopologyPolicy, remeshing: dict[str, float]) -> None:
        """Go on from a checkpoint."""
        self.go_on_with(policy)
        self._remeshing.resume(remeshing)
