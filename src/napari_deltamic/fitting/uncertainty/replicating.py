"""Where a fit might as well have ended: by noise, by its prior, by its triangles."""

from __future__ import annotations

import numpy as np

from ...geometry.mesh import FloatArray, Mesh
from ...geometry.replicas import Replicas
from ...geometry.subdivision import Subdivided, subdivided
from ..objective.posed import Posed
from .responses import Responses, noise_of

_WORK = 50_000  # vertices in all draws: large surfaces have fewer; chosen, not measured
# Vertices from which on a smooth surface has four triangles for one, below sixteen, since sixteen
# would take four times as long; chosen, not measured.
_LARGE = 6000
_ACCURACY = 1e-3  # of the image of the smooth surface: finer than what a fit is rendered with


def replicas_of(posed: Posed, responses: Responses, mesh: Mesh) -> Replicas:
    """Replicas of the end of a fit.

    Noise: see :func:`~.responses.noise_of`. Triangles: a smooth surface is made whose image is that
    of the mesh, and the mesh is fitted to the image of it; what both measure differs by what flat
    triangles are off by. The prior: what it pulls at the end of the fit.

    Parameters
    ----------
    posed
        The objective, where the fit has ended.
    responses
        What the surface gives way to there.
    mesh
        The fitted one.
    """
    v, pull = mesh.vertices_numpy(), responses.pulled()
    settled = v + responses.settled()
    fine = _finer(mesh)
    amplitude = posed.posterior(posed.at).match.amplitude
    smooth, refitted = _smooth(posed, responses, mesh, fine, amplitude)
    count = int(np.clip(_WORK // len(v), *responses.draws_of_one))
    scatter = noise_of(responses, count)
    finer = len(fine.mesh.faces) // max(len(mesh.faces), 1)
    return Replicas(mesh, settled, smooth, refitted, refitted + pull, scatter, finer)


def _finer(mesh: Mesh) -> Subdivided:
    once = subdivided(mesh)
    return once if len(mesh.vertices) > _LARGE else once.again()


def _smooth(
    posed: Posed, responses: Responses, mesh: Mesh, fine: Subdivided, amplitude: float
) -> tuple[Mesh, FloatArray]:
    """A smooth surface with the image of the mesh, and where a fit of that would end."""
    v, posterior = mesh.vertices_numpy(), posed.posterior
    own = np.concatenate(posterior.images(posed.at))

    def off(smooth: Mesh) -> FloatArray:
        image = np.concatenate(posterior.images_of(smooth, posed.at, _ACCURACY))
        return responses.after(amplitude * (image - own))

    # Subdivision rounds off: what it takes away is given back once.
    control = v - off(fine.moved(v))
    smooth = fine.moved(control)
    return smooth, v + off(smooth)
