"""Where a fit might as well have ended: by noise, by its prior, by its triangles."""

from __future__ import annotations

import numpy as np

from ..geometry.mesh import FloatArray, Mesh
from ..geometry.replicas import Replicas
from ..geometry.subdivision import Subdivided, subdivided
from .curvature import Curvature
from .pose import Posed

_DRAWS = (16, 32)  # of the noise: errors of one place are then right to 18 and 12 %, by definition
_WORK = (
    50_000  # vertices in all draws, so that large surfaces have the fewest; chosen, not measured
)
# Vertices from which on a smooth surface has four triangles for one, below sixteen, since sixteen
# would take four times as long; chosen, not measured.
_LARGE = 6000
_ACCURACY = 1e-3  # of the image of the smooth surface: finer than what a fit is rendered with


def replicas_of(posed: Posed, curvature: Curvature, mesh: Mesh) -> Replicas:
    """Replicas of the end of a fit, each by one Gauss-Newton step.

    Noise: the residual of each voxel with a sign drawn by lot (the wild bootstrap of C. F. J. Wu,
    "Jackknife, bootstrap and other resampling methods in regression analysis", 1986), so that its
    covariance is that of the sandwich. Triangles: a smooth surface is made whose image is that of
    the mesh, and the mesh is fitted to the image of it; what both measure differs by what flat
    triangles are off by. The prior: what it pulls at the end of the fit.

    Parameters
    ----------
    posed
        The objective, where the fit has ended.
    curvature
        Its second derivatives there.
    mesh
        The fitted one.
    """
    v, directions = mesh.vertices_numpy(), curvature.directions
    now = posed.posterior(posed.at)
    settled = v + curvature.newton_step(now.gradient).vertices
    prior = posed.posterior.prior
    bend, line = prior.bending(v)[1], prior.junctions(v)[1]
    pull = -curvature.response(prior.stiffness * (bend + line))
    fine = _finer(mesh)
    smooth, refitted = _smooth(posed, curvature, mesh, fine, now.match.amplitude)
    count = int(np.clip(_WORK // len(v), *_DRAWS))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (curvature.residual.size, count))
    noise = curvature.follows(signs * curvature.residual[:, None])
    scatter = np.stack([directions.displaced(one) for one in noise.T])
    finer = len(fine.mesh.faces) // max(len(mesh.faces), 1)
    return Replicas(mesh, settled, smooth, refitted, refitted + pull, scatter, finer)


def _finer(mesh: Mesh) -> Subdivided:
    once = subdivided(mesh)
    return once if len(mesh.vertices) > _LARGE else once.again()


def _smooth(
    posed: Posed, curvature: Curvature, mesh: Mesh, fine: Subdivided, amplitude: float
) -> tuple[Mesh, FloatArray]:
    """A smooth surface with the image of the mesh, and where a fit of that would end."""
    v, posterior = mesh.vertices_numpy(), posed.posterior
    own = np.concatenate(posterior.images(posed.at))

    def off(smooth: Mesh) -> FloatArray:
        image = np.concatenate(posterior.images_of(smooth, posed.at, _ACCURACY))
        return curvature.directions.displaced(curvature.follows(amplitude * (image - own)))

    # Subdivision rounds off: what it takes away is given back once.
    control = v - off(fine.moved(v))
    smooth = fine.moved(control)
    return smooth, v + off(smooth)
