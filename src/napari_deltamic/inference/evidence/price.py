"""What an effect adds to an iteration of a fit."""

from __future__ import annotations

from dataclasses import replace
from math import prod

from ...fourier.cost import Costs, Work, costs
from ...fourier.plan import Plan
from ...scene import Grid
from ...scene.effects import Effect


def milliseconds(effect: Effect, plan: Plan, grid: Grid, known: Costs | None = None) -> float:
    """ms that an iteration takes longer, from what the effect states and the machine's rates.

    Parameters
    ----------
    plan
        Of the renderings.
    grid
        Of the image.
    known
        Costs of this machine; by default those kept from an earlier measurement.
    """
    known, cost = known or costs(), effect.cost
    rates = known.rates(plan.single, gradient=True)
    transform = rates.seconds(replace(plan.work, pixels=0.0))
    image = rates.seconds(Work(pixels=plan.work.pixels)) - rates.call
    passes = cost.bands * prod(plan.band.box_shape) + cost.voxels * prod(grid.shape)
    transforms = cost.transforms_by(plan.method)
    return 1e3 * (transforms * transform + cost.images * image + passes * known.voxel)
