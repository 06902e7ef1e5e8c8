"""Standard deviations of what is measured on a fitted surface, predicted from one image."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..runs.settings import FitSettings
from ..scene import Grid
from .checks import check_image, hot_voxels
from .curvature import Curvature, Deviations, volume_sd
from .default_accuracy import accuracy_for_image
from .density import Density
from .imaging import Imaging
from .level import Level
from .pose import Posed, pose
from .problem import Problem
from .shape import Shape
from .state import FitState


def posed_at(
    image: np.ndarray, grid: Grid, state: FitState, settings: FitSettings | None = None
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

    Raises
    ------
    InputError
        For an image that a fit would refuse, for densities that are not uniform, and for a second
        view.
    """
    settings = settings or FitSettings()
    if settings.density != "uniform" or state.effects.second_view is not None:
        raise InputError("exact errors are there for uniform densities and one view only")
    pixels, known = check_image(image, grid)
    problem = Problem(pixels, known & ~hot_voxels(pixels, known), grid)
    accuracy = accuracy_for_image(pixels, known) if settings.accuracy is None else settings.accuracy
    settings = settings.model_copy(update={"accuracy": accuracy})
    counted = problem.counted_with(state.effects)
    halo = 0.0 if state.effects.halo is None else state.effects.halo.width
    level = Level(
        problem.image, counted, grid, state.optics, settings, state.effects, 1.0, None, halo
    )
    shape = Shape.begun(state.mesh, "uniform")
    density = Density(state.mesh, "uniform", min(state.optics.sigma_um))
    optics = state.optics.detach()
    imaging = Imaging(optics, state.effects, optics, settings.fit_psf, True)
    return pose((level, None), shape, density, imaging, True, True)


def predicted_volume_sd(
    image: np.ndarray, grid: Grid, state: FitState, settings: FitSettings | None = None
) -> dict[int, Deviations]:
    """Standard deviation of the volume of each closed region, um^3, from the curvature at the end.

    Parameters and errors are those of :func:`posed_at`, and an error where there are too many
    vertices or voxels.
    """
    posed = posed_at(image, grid, state, settings)
    curvature = Curvature(posed.posterior, posed.at, state.mesh, state.pinned)
    mesh = state.mesh
    closed = [int(r) for r in mesh.region_ids() if r != 0 and mesh.is_closed(int(r))]
    return {region: volume_sd(curvature, mesh, region) for region in closed}
