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

# Over the voxels that the loss and its gradient take: read, weigh, square; and back. Chosen, not
# measured.
_PASSES = 6.0
_LONGEST, _FEWEST = 0.2, 3  # seconds and repeats of timing: enough for a least time, hardly noticed


class EffectCosts:
    """What effects cost in a fit of a scene on this machine.

    What an effect states is in renderings, and so is its price here: in those of the scene, which
    are timed. Rates kept from another moment, when the machine was busier or idler, would not do.

    Parameters
    ----------
    mesh, grid, optics, effects
        Of the fit, and of the whole image.
    accuracy
        Of its images.

    Attributes
    ----------
    seconds
        Of a rendering with its gradient.
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
        """Seconds of a rendering with its gradient, when nothing else gets in between."""
        taken: list[float] = []
        while len(taken) < _FEWEST or sum(taken) < _LONGEST:
            vertices = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
            began = time.perf_counter()
            transform = self._renderer.transform(vertices)
            self._renderer.image(transform, self._renderer.otf(optics)).sum().backward()
            taken.append(time.perf_counter() - began)
        return min(taken)

    def milliseconds(self, effect: Effect) -> float:
        """ms that an iteration at full resolution takes longer with an effect."""
        return self._pace * milliseconds(effect, self._renderer.plan, self._grid, BUILT_IN)


def milliseconds(effect: Effect, plan: Plan, grid: Grid, known: Costs) -> float:
    """ms that an iteration takes longer with an effect, from what it states and a machine's rates.

    Parameters
    ----------
    plan
        Of the renderings.
    grid
        Of the image.
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
