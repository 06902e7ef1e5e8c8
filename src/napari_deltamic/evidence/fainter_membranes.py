"""Whether membranes may shine that a fit of insides has taken for insides that reach further out.

Light of density m on the surface of an inside of density i looks like an inside that ends by m / i
further out, through a PSF whose variance is less by (m / i)^2: the edge of the one and of the other
agree in their first three moments (integrals of light, light * x and light * x^2 across the
surface). What then differs is of third order. No derivative at the end of a fit tells of it, so the
other image is rendered.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..common.triple import geometric_mean
from ..fitting.model.state import FitState
from ..fitting.objective.posed import Posed
from ..fitting.uncertainty.refits import Alternative
from ..fitting.uncertainty.responses import Responses
from ..geometry.mesh import OUTSIDE, FloatArray, IntArray, Mesh
from ..geometry.outwards import outwards

NAME = "light of membranes"


@dataclass(frozen=True)
class FainterMembranesRules:
    """Which membranes are tried.

    Attributes
    ----------
    depths
        How much further in surfaces are tried, in widths of the PSF, least first. Chosen: what
        differs grows as their cube, and what that costs in nats as their sixth power.
    never
        Nats: what explains less by that many is no longer tried, nor what lies further in; by
        definition e^-10 as likely.
    """

    depths: tuple[float, ...] = (0.25, 0.35, 0.5, 0.7, 1.0)
    never: float = 10.0


RULES = FainterMembranesRules()


def fainter_membranes(posed: Posed, responses: Responses, state: FitState) -> Alternative | None:
    """Of surfaces further in, with membranes, those that the fit may be wrong by; None without any.

    Its ``moved`` is the largest of all depths, each times the root of its likelihood over that of
    the fit (1 at most): what it adds to the variance, were either as likely beforehand.
    """
    if state.light.interior <= 0 or not state.mesh.is_closed():
        return None
    tried = []
    now = posed.shown(state)
    for widths in RULES.depths:
        other, moved = _with_membranes(posed, state, widths)
        gain, followed = responses.instead(state.amplitude * (posed.shown(other) - now))
        if gain < -RULES.never:
            break
        likely = np.exp(min(gain, 0.0) / 2)
        tried.append(Alternative(NAME, gain, likely * (moved + followed)))
    return max(tried, key=lambda one: float(np.square(one.moved).sum()), default=None)


def _with_membranes(posed: Posed, state: FitState, widths: float) -> tuple[FitState, FloatArray]:
    """A state with surfaces further in, and what they moved by, (V, 3) um."""
    width = geometric_mean(state.optics.sigma_um)
    mesh, light, depth = state.mesh, state.light, widths * width
    moved = -depth * outwards(mesh)
    moved[_of_those_turned_over(mesh, moved)] = 0.0
    inner, outer = (light.of_cells(side) * (side != OUTSIDE) for side in mesh.regions.T)
    insides = (inner + outer) / np.maximum(1, (mesh.regions != OUTSIDE).sum(1))
    density = light.membrane * state.density + light.interior * depth * insides
    optics = state.optics
    if len(posed.at.optics):  # else it is known, and tells them apart
        optics = optics.widened(depth)
    other = replace(
        state,
        mesh=mesh.with_vertices(mesh.vertices_numpy() + moved),
        optics=optics,
        density=density,
        light=replace(light, membrane=1.0),
    )
    return other, moved


def _of_those_turned_over(mesh: Mesh, moved: FloatArray) -> IntArray:
    """Vertices of cells that are too small to be moved so far in."""
    after = mesh.with_vertices(mesh.vertices_numpy() + moved).volumes()
    small = [region for region, volume in after.items() if volume <= 0]
    return np.unique(mesh.faces[np.isin(mesh.regions, small).any(1)])
