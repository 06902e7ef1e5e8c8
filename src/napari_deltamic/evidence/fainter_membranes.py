"""Whether membranes may shine that a fit has not, or may not where it has them.

Light of density m on the surface of an inside of density i looks like an inside that ends by m / i
further out, through a PSF whose variance is less by (m / i)^2: the edge of the one and of the other
agree in their first three moments (integrals of light, light * x and light * x^2 across the
surface). What then differs is of third order. No derivative at the end of a fit tells of it, so the
other image is rendered: of insides with a membrane further in, and of both without their membranes,
as far out as explains most.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..fitting.likelihood import solve_scale
from ..fitting.posed import Posed
from ..fitting.prediction import as_floats
from ..fitting.refits import Alternative
from ..fitting.responses import Responses
from ..fitting.state import FitState
from ..geometry.mesh import OUTSIDE, FloatArray, IntArray, Mesh
from ..geometry.outwards import outwards

NAME = "light of membranes"


@dataclass(frozen=True)
class FainterMembranesRules:
    """Which membranes are tried.

    Attributes
    ----------
    depths
        How much further in surfaces are tried, and further out without membranes, in widths of the
        PSF, least first. Chosen: what differs grows as their cube, and what that costs in nats as
        their sixth power.
    never
        Nats: what explains less by that many is no longer tried, nor what lies further in; by
        definition e^-10 as likely.
    """

    depths: tuple[float, ...] = (0.25, 0.35, 0.5, 0.7, 1.0)
    never: float = 10.0


RULES = FainterMembranesRules()


def fainter_membranes(posed: Posed, responses: Responses, state: FitState) -> Alternative | None:
    """The surfaces, further in or out, that the fit may be wrong by most; None without any.

    Its ``moved`` is the largest, each times the root of its likelihood over that of the fit (1 at
    most): what it adds to the variance, were either as likely beforehand.
    """
    if state.light.interior <= 0 or not state.mesh.is_closed():
        return None
    tried = [*_fainter(posed, responses, state)]
    if state.light.membrane > 0:
        tried += _none(posed, responses, state)
    return max(tried, key=lambda one: float(np.square(one.moved).sum()), default=None)


def _fainter(posed: Posed, responses: Responses, state: FitState) -> Iterator[Alternative]:
    """Further in, with membranes, or with more of them."""
    now = posed.shown(state)
    for widths in RULES.depths:
        other, moved = _with_membranes(posed, state, widths)
        gain, followed = responses.instead(state.amplitude * (posed.shown(other) - now))
        if gain < -RULES.never:
            return
        yield _as_likely(gain, moved + followed)


def _none(posed: Posed, responses: Responses, state: FitState) -> Iterator[Alternative]:
    """Further out, as far as explains most, without membranes."""
    _, now = _scaled(posed, state)
    width = _width(state)
    tried = []
    for widths in RULES.depths:
        other, moved = _displaced(state, widths * width)
        left, seen = _scaled(posed, replace(other, light=replace(state.light, membrane=0.0)))
        tried.append((left, seen, moved))
    _, seen, moved = min(tried, key=lambda one: one[0])
    gain, followed = responses.instead(seen - now)
    if gain >= -RULES.never:
        yield _as_likely(gain, moved + followed)


def _as_likely(gain: float, moved: FloatArray) -> Alternative:
    return Alternative(NAME, gain, np.exp(min(gain, 0.0) / 2) * moved)


def _scaled(posed: Posed, state: FitState) -> tuple[float, FloatArray]:
    """Weighted squares that a state leaves, and (N,) what it shows, as bright as explains most."""
    voxels = posed.posterior.views[0].voxels
    shown, measured = posed.shown(state), posed.posterior.measured(posed.at)[0]
    weights = as_floats(voxels.weights)
    a, b, _ = solve_scale(*(torch.from_numpy(one) for one in (shown, measured, weights)))
    seen = a * shown + b
    return float(weights @ (measured - seen) ** 2), seen


def _width(state: FitState) -> float:
    return float(np.prod(state.optics.sigma_um) ** (1 / 3))


def _with_membranes(posed: Posed, state: FitState, widths: float) -> tuple[FitState, FloatArray]:
    """A state with surfaces further in, and what they moved by, (V, 3) um."""
    depth, light = widths * _width(state), state.light
    other, moved = _displaced(state, -depth)
    inner, outer = (light.of_cells(side) * (side != OUTSIDE) for side in state.mesh.regions.T)
    insides = (inner + outer) / np.maximum(1, (state.mesh.regions != OUTSIDE).sum(1))
    density = light.membrane * state.density + light.interior * depth * insides
    optics = state.optics
    if len(posed.at.optics):  # else it is known, and tells them apart
        optics = optics.widened(depth)
    other = replace(other, optics=optics, density=density, light=replace(light, membrane=1.0))
    return other, moved


def _displaced(state: FitState, further: float) -> tuple[FitState, FloatArray]:
    """A state with surfaces so much further out, um, and what they moved by, (V, 3) um."""
    mesh = state.mesh
    moved = further * outwards(mesh)
    moved[_of_those_turned_over(mesh, moved)] = 0.0
    return replace(state, mesh=mesh.with_vertices(mesh.vertices_numpy() + moved)), moved


def _of_those_turned_over(mesh: Mesh, moved: FloatArray) -> IntArray:
    """Vertices of cells that are too small to be moved so far in."""
    after = mesh.with_vertices(mesh.vertices_numpy() + moved).volumes()
    small = [region for region, volume in after.items() if volume <= 0]
    return np.unique(mesh.faces[np.isin(mesh.regions, small).any(1)])
