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


class SurfaceUpkeep:
    """What keeps a surface sound.

    Each method that may change the surface takes what is fitted and gives what the fit goes on
    with: the same object where nothing was changed.

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
        self._problem = problem
        self._topology = TopologyTrials(problem)
        self._remeshing = Remeshing(mesh, width)
        self.guard = CollisionGuard(collisions)

    @property
    def trying(self) -> bool:
        """Whether a change of topology is still to be judged."""
        return self._topology.trial is not None

    @property
    def policy(self) -> TopologyPolicy:
        """Where the topology may change."""
        return self._topology.policy

    def events(self) -> tuple[str, ...]:
        """What has happened since this was last asked, a sentence each."""
        return self._topology.events()

    # ----------------------------------------------------------------------------- the schedule

    def begin_level(self, mesh: Mesh, blurred: float) -> None:
        """blurred : um, width of the PSF of a blurred level; 0 if it is sharp."""
        self._remeshing.begin_level(mesh, blurred)

    def end_level(self, fitted: Fitted, settings: FitSettings, iteration: int) -> Fitted:
        """Judge a change that has had its time."""
        return self._topology.end_level(fitted, settings, iteration)

    def rearranged(
        self, fitted: Fitted, settings: FitSettings, factor: float, iteration: int
    ) -> Fitted:
        """Judge a change that has had its time, and change what presses."""
        return self._topology.look(fitted, settings, factor, iteration)

    def remeshed(self, fitted: Fitted, settings: FitSettings) -> Fitted:
        """The same with good triangles."""
        if not (settings.remesh and self._remeshing.wanted(fitted.mesh, settings.flatness)):
            return fitted
        after = self._remeshing.of_shape(
            fitted.shape, self.guard, settings.collisions, settings.flatness
        )
        return fitted if after is None else fitted.retriangulated(after)

    def too_soon(self, iteration: int) -> bool:
        """Whether rest that comes now is of the places that have not changed."""
        return self._topology.too_soon(iteration)

    def judged(self, fitted: Fitted, settings: FitSettings) -> Fitted:
        """Judge the last change, if any is still on trial."""
        return self._topology.judged(fitted, settings) if self.trying else fitted

    def tried(self, fitted: Fitted, settings: FitSettings, factor: float, iteration: int) -> Fitted:
        """Change what only a trial can tell."""
        return self._topology.tried(fitted, settings, factor, iteration)

    # ---------------------------------------------------------------------- changes from outside

    def guarded(self, collisions: bool) -> None:
        """Guard against crossings from now on, or no more."""
        self.guard = CollisionGuard(collisions)

    def edges_given(self) -> None:
        """The mesh was replaced from outside: its edges stay until the next level."""
        self._remeshing.given()

    def forget_trial(self) -> None:
        """The image is explained in another way: no change is to be judged by it."""
        self._topology.drop()

    def restart(self) -> None:
        """Another surface: whatever was tried may be tried again."""
        self._topology.drop()
        self._topology.restart()

    def go_on_with(self, policy: TopologyPolicy) -> None:
        """Another fit was here before: what it tried is not tried again."""
        self._topology = TopologyTrials(self._problem, policy)

    # ------------------------------------------------------------------------------ checkpoints

    def saved(self) -> dict[str, float]:
        """What a checkpoint keeps of the triangles."""
        return self._remeshing.to_dict()

    def resume(self, policy: TopologyPolicy, remeshing: dict[str, float]) -> None:
        """Go on from a checkpoint."""
        self.go_on_with(policy)
        self._remeshing.resume(remeshing)
