"""What an effect adds to an iteration of a fit."""

from __future__ import annotations

import time
from dataclasses import replace
from math import prod

import torch

from ..fourier.cost import BUILT_IN, Costs, Work
from ..fourier.plan import Plan
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid, Renderer, Scene
from ..scene.effects import Effect, Effects

# Passes over the voxels that the loss and its gradient take: read, weigh, square; and back. Chosen,
# not measured.
_PASSES = 6.0
_LONGEST, _FEWEST = 0.2, 3  # s and runs of a timing: enough for a minimum, and hardly noticed


class EffectCosts:
    """What effects cost in a fit of a scene on this machine.

    Effects state their cost in renderings, so renderings of the scene are timed now. Rates kept
    from another moment, when the machine was more or less busy, would not do.

    Parameters
    ----------
    mesh, grid, optics, effects
        Those of the fit, for the whole image.
    accuracy
        Accuracy of its rendered images.

    Attributes
    ----------
    seconds
        Time of a rendering with its gradient.
    """

    def __init__(
        self, mesh: Mesh, grid: Grid, optics: Optics, effects: Effects, accuracy: float
    ) -> None:
        self._renderer = Renderer(Scene.of(mesh, optics, effects), grid, accuracy)
        self._grid = grid
        plan = self._renderer.plan
        self.seconds = self._timed(mesh, optics)
        self._pace = self.seconds / BUILT_IN.seconds(plan.work, plan.single)

    def _timed(self, mesh: Mesh, optics: Optics) -> float:
        """Seconds of a rendering with its gradient; the least of several, free of interruptions."""
        taken: list[float] = []
        while len(taken) < _FEWEST or sum(taken) < _LONGEST:
            vertices = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
            began = time.perf_counter()
            transform = self._renderer.transform(vertices)
            self._renderer.image(transform, self._renderer.otf(optics)).sum().backward()
            taken.append(time.perf_counter() - began)
        return min(taken)

    def milliseconds(self, effect: Effect) -> float:
        """How much longer an iteration at full resolution takes with an effect, ms."""
        return self._pace * milliseconds(effect, self._renderer.plan, self._grid, BUILT_IN)


def milliseconds(effect: Effect, plan: Plan, grid: Grid, known: Costs) -> float:
    """How much longer an iteration takes with an effect, ms, from the cost that the effect states.

    Parameters
    ----------
    plan
        Plan of the renderings.
    grid
        Grid of the image.
    known
        Costs of a machine.
    """
    cost, rates = effect.cost, known.rates(plan.single, gradient=True)
    transform = rates.seconds(replace(plan.work, pixels=0.0))
    image = rates.seconds(Work(pixels=plan.work.pixels)) - rates.call
    passes = cost.bands * prod(plan.band.box_shape) + cost.voxels * prod(grid.shape)
    return 1e3 * (
        cost.transforms * transform + cost.images * image + passes * known.voxel / _PASSES
    )
