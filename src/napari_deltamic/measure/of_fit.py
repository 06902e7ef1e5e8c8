"""What a fit knows of its shape, for the tables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import InputError
from ..fitting import FitState
from ..fitting.curvature import Curvature
from ..fitting.errors_of_measures import posed_at
from ..geometry.mesh import FloatArray
from ..optics import Optics
from ..runs.fit_settings import FitSettings
from ..scene import Grid
from .known import Deviation, Known


def known_of(
    state: FitState,
    grid: Grid | None,
    *,
    explained: Mapping[int, float] | None = None,
    deviation: Deviation | None = None,
) -> Known:
    """What a state says besides its mesh: densities, resolution, border.

    Parameters
    ----------
    grid
        Of the image; None leaves the border out.
    explained
        For a region, the share of what varies around it that the fit explains.
    deviation
        As from :func:`deviation_of`.
    """
    return Known(
        grid=grid,
        density=np.asarray(state.density, np.float64),
        resolution=resolution_of(state.optics),
        explained=explained or {},
        deviation=deviation,
    )


def resolution_of(optics: Optics) -> float:
    """um; the geometric mean of the PSF's standard deviations along the three axes."""
    return float(np.prod(optics.sigma_um) ** (1 / 3))


def deviation_of(
    image: np.ndarray, grid: Grid, state: FitState, settings: FitSettings | None = None
) -> Deviation:
    """The standard error of whatever is measured at the end of a fit, from its curvature there.

    The sandwich: with the variance that voxels really have around the fit, not the one that the
    fit takes them to have.

    Raises
    ------
    InputError
        For a fit whose errors cannot be told: densities that vary, a second view, or too many
        vertices or voxels.
    """
    try:
        posed = posed_at(image, grid, state, settings)
        curvature = Curvature(posed.posterior, posed.at, state.mesh, state.pinned)
    except np.linalg.LinAlgError:
        raise InputError("there are no errors: the image does not determine the shape") from None

    def deviation(gradient: FloatArray) -> float:
        return curvature.deviations(gradient).sandwich

    return deviation
