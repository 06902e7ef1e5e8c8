"""What the end of a fit gives way to: other noise, more patience, another prior, another model."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...errors import InputError
from ...geometry.mesh import FloatArray
from ...geometry.vectors import lengths
from ...runs.settings import FitSettings
from ..model.shape import Shape
from ..model.state import FitState
from ..objective.descent import FAR
from ..objective.posed import Posed
from .curvature import Curvature
from .refits import Alternative, Refits


class Exact:
    """Displacements (V, 3) um of a surface, from the second derivatives of the objective.

    Attributes
    ----------
    residual
        (N,) measured minus rendered, of all voxels that count.
    draws, draws_of_one
        Of the noise: for means over many patches, and for errors of one place, at least and at
        most, which are then right to 1 / sqrt(2 draws), by definition.
    """

    draws, draws_of_one = 16, (16, 32)  # chosen: errors are then right to 18 and 12 %

    def __init__(self, posed: Posed, curvature: Curvature) -> None:
        self._posed, self._curvature = posed, curvature
        self._far = FAR * posed.posterior.level.width
        self.residual = curvature.residual

    def after(self, change: FloatArray) -> FloatArray:
        """What the surface follows a change (N,) of the image by."""
        return self._bounded(self._curvature.directions.displaced(self._curvature.follows(change)))

    def settled(self) -> FloatArray:
        """What more iterations would move it by."""
        now = self._posed.posterior(self._posed.at)
        return self._bounded(self._curvature.newton_step(now.gradient).vertices)

    def pulled(self) -> FloatArray:
        """What the prior moves it by."""
        prior, v = self._posed.posterior.prior, self._posed.at.vertices
        pull = prior.stiffness * (prior.bending(v)[1] + prior.junctions(v)[1])
        return self._bounded(-self._curvature.response(pull))

    def amplitudes(self, columns: FloatArray) -> FloatArray:
        """(m,) how much of further columns (N, m) of the image explains most of the residual."""
        return self._curvature.amplitudes(columns)

    def alternatives(self, columns: Iterable[tuple[str, FloatArray]]) -> list[Alternative]:
        """What the model may lack, by further columns (N, m) of the image: all of them."""
        found = [(name, *self._curvature.alternative(each)) for name, each in columns]
        displaced = self._curvature.directions.displaced
        return [Alternative(name, gain, displaced(along)) for name, gain, along in found]

    def instead(self, change: FloatArray) -> tuple[float, FloatArray]:
        """What another rendering, by a change (N,), gains, nats, and what it is followed by."""
        gain, along = self._curvature.instead(change)
        return gain, self._curvature.directions.displaced(along)

    def _bounded(self, moved: FloatArray) -> FloatArray:
        """Displacements of which none is longer than a step of a fit may be.

        Further away the objective is no parabola. In a cluster of 16 cells one vertex of a sliver
        would have moved by 13 voxels, and the surface, with 11 nm left to settle as further steps
        told, by 26 nm; bounded, by 10 nm.
        """
        found: FloatArray = moved / np.maximum(lengths(moved)[:, None] / self._far, 1.0)
        return found


Responses = Exact | Refits


def responses_of(posed: Posed, state: FitState, settings: FitSettings) -> Responses:
    """Responses at the end of a fit, exact where that is affordable.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where the image does not determine the shape.
    """
    try:
        return Exact(posed, Curvature(posed.posterior, posed.at, state.mesh, state.pinned))
    except InputError:
        shape = Shape.begun(state.mesh, settings.density)
        pinned = state.pinned
        return Refits(posed, shape if pinned is None else shape.with_pins(pinned), settings)


def noise_of(responses: Responses, draws: int | None = None) -> FloatArray:
    """(K, V, 3) um: what other noise would move the surface by, in as many draws.

    The residual of each voxel with a sign drawn by lot (the wild bootstrap of C. F. J. Wu,
    "Jackknife, bootstrap and other resampling methods in regression analysis", 1986), so that the
    covariance is that of the sandwich.
    """
    residual = responses.residual
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (len(residual), draws or responses.draws))
    return np.stack([responses.after(one * residual) for one in signs.T])
