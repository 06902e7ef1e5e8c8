"""The objective where a fit has ended, for the errors of what is measured there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import InputError
from ...runs.settings import FitSettings
from ...scene import Grid
from ...scene.light import structure_of
from ..model.default_accuracy import accuracy_for_image
from ..model.density import Density
from ..model.fitted import Fitted
from ..model.imaging import Imaging
from ..model.problem import Problem
from ..model.shape import Shape
from ..model.state import FitState
from ..objective.pose import pose
from ..objective.posed import Posed


def posed_at(
    image: np.ndarray,
    grid: Grid,
    state: FitState,
    settings: FitSettings | None = None,
    may_count: np.ndarray | None = None,
    *,
    frame: Grid | None = None,
    density_fitted: bool = False,
) -> Posed:
    """The objective of the last level, from where a fit has ended.

    Parameters
    ----------
    image, grid
        What was fitted; NaN marks missing voxels.
    state
        The end of the fit.
    settings
        Those of the fit.
    may_count
        (Z, Y, X) bool: voxels that may count; None for all.
    frame
        Grid of the whole image, where this one is a piece of it.
    density_fitted
        Whether densities are unknowns, or held.

    Raises
    ------
    InputError
        For an image that a fit would refuse, and for a second view.
    """
    settings = settings or FitSettings()
    if state.effects.view is not None:
        raise InputError("exact errors are there for one view only")
    image = state.without_local_background(image)
    problem = replace(Problem.of(image, grid, may_count), frame=frame)
    if settings.accuracy is None:
        accuracy = accuracy_for_image(problem.image, problem.counted)
        settings = settings.model_copy(update={"accuracy": accuracy})
    level, _ = problem.levels(state.optics, settings, state.effects, 1.0, state.effects.spread)
    density = Density(state.mesh, settings.density, min(state.optics.sigma_um))
    log = None if state.density is None else density.of_faces(state.density)
    shape = Shape.begun(state.mesh, settings.density).moved(state.mesh.vertices_numpy(), log)
    optics = state.optics.detach()
    imaging = Imaging(optics, state.effects, optics, settings.fit_psf, True, level.range)
    structure = structure_of(state.light)
    fitted = Fitted(
        shape, optics, state.effects, optics, state.effects, structure, state.light, state.dimmed
    )
    return pose((level, None), fitted, density, imaging, density_fitted, tempered=True)
