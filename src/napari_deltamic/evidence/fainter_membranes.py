"""Whether a fit of insides has mistaken light of membranes for insides that reach further out.

Light of density m on the surface of an inside of density i looks like an inside that ends m / i
further out, through a PSF whose variance is smaller by (m / i)^2: both edges agree in their first
three moments (integrals of light, light * x and light * x^2 across the surface). The remaining
difference is of third order. No derivative at the end of a fit shows it, so the other image is
rendered.
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
    """How far in surfaces with membranes are tried.

    Attributes
    ----------
    depths
        Depths that are tried, in widths of the PSF, in ascending order. Chosen: the difference
        grows as their cube, and its cost in nats as their sixth power.
    never
        Nats by which an alternative may explain less before no deeper one is tried; by definition
        e^-10 as likely.
    """

    depths: tuple[float, ...] = (0.25, 0.35, 0.5, 0.7, 1.0)
    never: float = 10.0


RULES = FainterMembranesRules()


def fainter_membranes(posed: Posed, responses: Responses, state: FitState) -> Alternative | None:
    """The alternative of membranes with surfaces further in, which may be true; None without any.

    It is the depth with the largest ``moved``, each weighted by the root of its likelihood relative
    to the fit (at most 1): what it would add to the variance if both were equally likely a priori.
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
    """A state with membranes and surfaces further in, and by how much they moved, (V, 3) um."""
    width = geometric_mean(state.optics.sigma_um)
    mesh, light, depth = state.mesh, state.light, widths * width
    moved = -depth * outwards(mesh)
    moved[_of_those_turned_over(mesh, moved)] = 0.0
    inner, outer = (light.of_cells(side) * (side != OUTSIDE) for side in mesh.regions.T)
    insides = (inner + outer) / np.maximum(1, (mesh.regions != OUTSIDE).sum(1))
    density = light.membrane * state.density + light.interior * depth * insides
    optics = state.optics
    if len(posed.at.optics):  # else the PSF is known, and tells both apart
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
    """Vertices of cells that are too small to be moved this far in."""
    after = mesh.with_vertices(mesh.vertices_numpy() + moved).volumes()
    small = [region for region, volume in after.items() if volume <= 0]
    return np.unique(mesh.faces[np.isin(mesh.regions, small).any(1)])
