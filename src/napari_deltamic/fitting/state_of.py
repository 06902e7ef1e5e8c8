"""What a run shows of itself after an iteration."""

from __future__ import annotations

from ..geometry.mesh import FloatArray
from ..scene import Grid
from .model.fitted import Arrays, Fitted
from .model.likelihood import Match
from .model.state import FitState
from .stage import Stage


def state_of(
    fitted: Fitted,
    stage: Stage,
    found: Match,
    density: FloatArray,
    grid: Grid,
    levels: int,
    blur: float,
    accuracy: float,
    kept: Arrays,
) -> FitState:
    """The state of a run.

    Parameters
    ----------
    fitted, stage, found
        Surface, PSF and effects; where the run is; how they match the image.
    density
        (F,) relative to the mean.
    grid
        Of the image.
    levels, blur
        How many levels there are; width of the blur of this one, in widths of the PSF.
    accuracy
        Of the rendered image.
    kept
        The last checkpoint.
    """

    return FitState(
        iteration=stage.iteration,
        level=stage.level_number + 1,
        levels=levels,
        mesh=fitted.mesh,
        optics=fitted.optics,
        density=density,
        loss=found.loss,
        amplitude=found.amplitude,
        background=found.background,
        blur=blur,
        effects=fitted.effects,
        light=fitted.light,
        pinned=fitted.shape.pinned if fitted.shape.pinned.any() else None,
        evaluations=stage.evaluations,
        unsure=stage.progress.unsure and fitted.structure != "membrane",
        dimmed=fitted.dimmed,
        grid=grid,
        accuracy=accuracy,
        _checkpoint=lambda: kept,
    )
