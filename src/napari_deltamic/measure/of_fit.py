"""What a fit knows about its shape, for the tables of measurements."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..common.triple import geometric_mean
from ..errors import InputError
from ..fitting import FitState
from ..fitting.uncertainty.errors_of_measures import posed_at
from ..fitting.uncertainty.replicating import replicas_of
from ..fitting.uncertainty.responses import responses_of
from ..geometry.judgement import Judgement
from ..geometry.replicas import Replicas
from ..runs.fit_settings import FitSettings
from ..scene import Grid
from .known import Known


def known_of(
    state: FitState,
    grid: Grid | None,
    *,
    explained: Mapping[int, float] | None = None,
    replicas: Replicas | None = None,
    judgements: Mapping[int, Judgement] | None = None,
) -> Known:
    """Collect what a state says besides its mesh: densities, resolution, border.

    Parameters
    ----------
    grid
        Grid of the image; None leaves the border out.
    explained
        By region, the share of the variation around it that the fit explains.
    replicas
        From :func:`replicas_at`.
    judgements
        By region, how good its shape is.
    """
    return Known(
        grid=grid,
        density=np.asarray(state.density, np.float64),
        resolution=geometric_mean(state.optics.sigma_um),
        explained=explained or {},
        replicas=replicas,
        judgements=judgements or {},
    )


def replicas_at(
    image: np.ndarray,
    grid: Grid,
    state: FitState,
    settings: FitSettings | None = None,
    counted: np.ndarray | None = None,
) -> Replicas:
    """Make surfaces as likely as the fit's result, to estimate the errors of measurements on it.

    Raises
    ------
    InputError
        If errors cannot be estimated: for a fit with a second view, or of an image that does not
        determine the shape.
    """
    try:
        posed = posed_at(image, grid, state, settings, counted)
        responses = responses_of(posed, state, settings or FitSettings())
        return replicas_of(posed, responses, state.mesh)
    except np.linalg.LinAlgError:
        raise InputError("there are no errors: the image does not determine the shape") from None
