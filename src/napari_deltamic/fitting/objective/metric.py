"""The metric of the unknowns: the inverse Hessian that L-BFGS starts from."""

from __future__ import annotations

import numpy as np
import torch

from ...geometry.mesh import FloatArray
from ...runs.settings import FitSettings
from ..model.shape import Shape
from ..model.variables import Variables
from ..solvers.preconditioner import NEAR_JUNCTIONS, Preconditioners
from .posed import Posed

# Of a log density against a displacement by one width of the blurred PSF, both squared: both
# change the image alike, but densities are smoothed once, displacements twice. Measured: half and
# twice move the surfaces of small fits by 0.02 voxel, of a cluster by 0.15.
_DENSITY = 0.1
_SMOOTHEST = (
    1e3  # lambda, where the image says next to nothing; half and twice change nothing, as measured
)


class Metric:
    """``(I + lambda L)^-2`` on vertices, ``(I + L)^-1`` on densities, measured on all others.

    Parameters
    ----------
    factored
        What is factored already.
    shape
        As it is when the metric is made; pinned vertices stay.
    smoothing
        lambda of the vertices that the image asks for; more where the prior is stiffer.
    stiffness, firmness
        Weight of the bending energy, and the second derivative of the image's misfit by a
        displacement of a piece of surface along its normal, for each um^2 of it: nats / um^4.
    width
        um: of the blurred PSF.
    at_junctions
        Weight of edges that leave a junction; see :class:`~.preconditioner.Preconditioner`.
    density_fitted
        Whether densities move.

    Attributes
    ----------
    first_scale
        Of the surface, while nothing has been measured.
    """

    def __init__(
        self,
        factored: Preconditioners,
        shape: Shape,
        smoothing: float,
        stiffness: float,
        firmness: float,
        width: float,
        at_junctions: float,
        density_fitted: bool,
    ) -> None:
        self._width, self._density_fitted = width, density_fitted
        mesh = shape.mesh
        # A vertex's share of the surface is A: the bending energy has the second derivative
        # kappa L^2 / (3 A) on an even mesh, the image A h; (I + lambda L)^2 is to follow their sum.
        share = float(np.median(mesh.areas())) * len(mesh.faces) / max(len(mesh.vertices), 1)
        self.first_scale = 1.0 / max(firmness * share * width**2, 1e-300)
        stiff = float(np.sqrt(stiffness / max(3 * firmness, 1e-300))) / max(share, 1e-300)
        held = shape.pinned if shape.pinned.any() else None
        smoothing = min(max(smoothing, stiff), _SMOOTHEST)
        self._mover = factored.of(mesh, smoothing, held, at_junctions)
        self._smooth = shape.model == "smooth" and density_fitted
        if self._smooth:
            self._smoother = factored.of(mesh, 1.0, None, at_junctions)
        self._imaging: FloatArray = np.zeros((0, 0))
        self._insides: FloatArray = np.zeros(0)

    @classmethod
    def at_end(
        cls, posed: Posed, shape: Shape, settings: FitSettings, density_fitted: bool
    ) -> Metric:
        """Where a fit has ended, or nearly so."""
        level, prepared = posed.posterior.level, Preconditioners()
        smoothing, bending, firmness = level.smoothing, settings.bending, posed.firmness
        given = smoothing, bending, firmness, level.width, NEAR_JUNCTIONS, density_fitted
        return cls(prepared, shape, *given)

    def measure(self, curvature: FloatArray, insides: FloatArray) -> None:
        """Take the second derivatives (P + E, P + E) by PSF and effects, and (R,) by insides."""
        found = np.linalg.inv(curvature) if len(curvature) else curvature
        self._imaging = np.asarray(found, dtype=np.float64)
        self._insides = 1.0 / np.maximum(insides, 1e-300)

    def solve(self, gradient: Variables, scale: float) -> Variables:
        """The guessed inverse Hessian times a gradient; ``scale`` is that of the surface."""
        x = torch.from_numpy(gradient.vertices)
        moved = self._mover.solve(self._mover.solve(x)).numpy() * (scale * self._width**2)
        density = np.zeros_like(gradient.density)
        if self._density_fitted and len(density):
            density = gradient.density
            if self._smooth:
                density = self._smoother.solve(torch.from_numpy(density[:, None])).numpy()[:, 0]
            density = density * (scale * _DENSITY)
        n = len(gradient.optics)
        rest = self._imaging @ np.concatenate([gradient.optics, gradient.effects])
        return Variables(moved, density, self._insides * gradient.insides, rest[:n], rest[n:])
