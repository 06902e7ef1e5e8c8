"""Fourier transform of filaments (polylines) and of points, with the plan an accuracy asks for.

A straight segment from a to b of length L has ``L exp(-i (a+b)/2.xi) sin(h) / h`` with
``h = (b-a).xi / 2``; a point x has ``exp(-i x.xi)``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from math import ceil, pi

import numpy as np
import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from ..common.accuracy_bounds import check_accuracy
from ..errors import InputError
from .band import Band
from .closed_form import row_wavevectors
from .cost import Work, count_work
from .falloff import POINT_LIKE
from .particle_mesh import elements_ft
from .plan import (
    EXACT_BELOW,
    Cutoff,
    Method,
    checked_method,
    choose_band,
    spreading_for,
)
from .points import Points
from .quadrature import Rule
from .spreading import Spreading, Transfer, gaussian
from .triangle import sinc

_PAIRS_AT_ONCE = 1 << 20  # bounds the memory of the closed forms


def filament_ft(
    vertices: Tensor | np.ndarray,
    segments: Tensor | np.ndarray,
    wavevectors: Tensor | np.ndarray,
    weights: Tensor | np.ndarray | None = None,
) -> Tensor:
    """Fourier transform of line segments at any wavevectors; exact but for rounding.

    ``u_hat(xi) = sum over segments of weight * integral along the segment of exp(-i x.xi) ds``.

    Parameters
    ----------
    vertices
        (V, 3) um.
    segments
        (S, 2) integers: the vertices that each joins; see :func:`path_segments`.
    wavevectors
        (K, 3) rad/um.
    weights
        (S,) signal per um; 1 where not given.

    Returns
    -------
    (K,) complex128, differentiable in vertices and weights. A segment of no length pulls nothing.

    Raises
    ------
    InputError
        If a shape is wrong or a segment names a vertex that is not there.
    """
    v, s, w, xi = _checked(vertices, segments, wavevectors, weights, 2)
    return _in_chunks(_segments_part, v[s[:, 0]], v[s[:, 1]], w, xi)


def point_ft(
    points: Tensor | np.ndarray,
    wavevectors: Tensor | np.ndarray,
    weights: Tensor | np.ndarray | None = None,
) -> Tensor:
    """Fourier transform of points at any wavevectors: ``sum of weight * exp(-i x.xi)``.

    Parameters
    ----------
    points
        (P, 3) um.
    wavevectors
        (K, 3) rad/um.
    weights
        (P,) signal of each; 1 where not given.

    Returns
    -------
    (K,) complex128, differentiable in points and weights.

    Raises
    ------
    InputError
        If a shape is wrong.
    """
    every = np.arange(len(points))[:, None]
    v, _, w, xi = _checked(points, every, wavevectors, weights, 1)
    return _in_chunks(_points_part, v, w, xi)


def path_segments(count: int, closed: bool = False) -> np.ndarray:
    """(S, 2) segments that join ``count`` vertices one after the other; closed: back to the first.

    Raises InputError for fewer than two vertices.
    """
    if count < 2:
        raise InputError(f"a filament needs two vertices or more, not {count}")
    first = np.arange(count if closed and count > 2 else count - 1)
    return np.stack([first, (first + 1) % count], 1)


# ----------------------------------------------------------------------------------------- plans


@dataclass(frozen=True, eq=False)
class LinePlan:
    """How u_hat of segments or points is computed on a band; as :class:`Plan` for triangles.

    Attributes
    ----------
    rules
        Of the segments, each with theirs; empty for points, and for the closed form.
    work
        What one rendering by the particle-mesh computes; the closed form, which is for checking,
        takes a sine, a cosine and about ten passes over each pair of an element and a wavevector.
    """

    method: Method
    band: Band
    accuracy: float
    single: bool
    spreading: Spreading | None
    rules: list[tuple[Rule, np.ndarray]] = field(repr=False)
    work: Work

    def transform(self, vertices: Tensor, elements: Tensor, weights: Tensor) -> Tensor:
        """u_hat on the box of the band, differentiable in vertices and weights.

        Parameters
        ----------
        vertices
            (V, 3) um relative to the centre of the grid's first voxel.
        elements
            (S, 2) vertices that each segment joins, or (P, 1) where they are points.
        weights
            (S,) signal per um, or (P,) signal.
        """
        v, w = vertices.to(torch.float64), weights.to(torch.float64)
        if self.spreading is None:
            xi = row_wavevectors(self.band.rows, self.band.spacing)
            is_points = elements.shape[1] == 1
            rows = (
                _in_chunks(_points_part, v[elements[:, 0]], w, xi)
                if is_points
                else _in_chunks(_segments_part, v[elements[:, 0]], v[elements[:, 1]], w, xi)
            )
            return self.band.to_box(rows.to(torch.complex64 if self.single else torch.complex128))
        assert self.spreading is not None
        points = Points(self.rules, len(elements))
        return elements_ft(v, elements, w, points, self.spreading, self.single)


def make_line_plan(
    vertices: np.ndarray,
    elements: np.ndarray,
    fft_shape: tuple[int, int, int],
    voxel_size: tuple[float, float, float],
    width: tuple[float, float, float],
    accuracy: float,
    method: Method | None = None,
    aligned: bool = True,
    cutoff: Cutoff | None = None,
    transfer: Transfer | None = None,
    margin: float = 1.0,
) -> LinePlan:
    """Choose band and rules for segments (S, 2) or points (P, 1); as :func:`make_plan`.

    The power of a line falls more slowly with the wavevector than that of a surface, that of a
    point not at all, so that the band is a little larger. The particle-mesh is taken unless the
    closed form is forced, or the accuracy is below what it can reach. margin : by how much segments
    may grow while the plan is used.

    Raises
    ------
    InputError
        If the accuracy is negative, not a number, or 1 or more.
    """
    check_accuracy(accuracy)
    method = checked_method(method)
    if accuracy < EXACT_BELOW:
        return LinePlan(
            "closed form", Band.full(fft_shape, voxel_size), accuracy, False, None, [], Work()
        )
    c = choose_band(POINT_LIKE, fft_shape, voxel_size, width, accuracy, aligned, cutoff)
    rules: list[tuple[Rule, np.ndarray]] = [(_POINT, np.arange(len(elements)))]
    if elements.shape[1] == 2:
        along = np.abs(vertices[elements[:, 1]] - vertices[elements[:, 0]]) * np.asarray(c.held)
        phases = margin * (np.linalg.norm(along, axis=1) if c.round else along.sum(1))
        rules = _choose_line_rules(phases, c.at_edge, c.quadrature)
    spreading = spreading_for(c, rules, width, transfer or gaussian(width), POINT_LIKE)
    work = count_work("particle-mesh", c.band, 0, np.zeros(0), rules, spreading)
    if method == "closed form":
        return LinePlan(method, c.band, accuracy, c.single, None, [], work)
    return LinePlan("particle-mesh", c.band, accuracy, c.single, spreading, rules, work)


# ------------------------------------------------------------------------------------- quadrature

_NODES = (1, 2, 3, 4, 6, 8)
_POINT = Rule(0, 1, np.ones((1, 1)), np.ones(1))
_PHASE = np.linspace(0.0, 16.0, 81)


@cache
def _line_rule(nodes: int, divisions: int) -> Rule:
    """Gauss-Legendre on each of equal parts of a segment."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    t = ((np.arange(divisions)[:, None] + (x + 1) / 2) / divisions).reshape(-1)
    return Rule(
        2 * nodes - 1, divisions, np.stack([1 - t, t], 1), np.tile(w / 2, divisions) / divisions
    )


@cache
def _largest_phases(threshold: float, error: float) -> tuple[float, ...]:
    """For each number of nodes, the longest segment (rad at the edge of the band) that keeps to
    ``error``, by the mean over directions and over the band of a Gaussian OTF."""
    u = (np.arange(32) + 0.5) / 32  # cosine of the angle to the segment: even over the sphere
    s = np.linspace(0.01, 1.0, 100)
    weight = s**2 * threshold ** (2 * s**2)
    found = []
    for nodes in _NODES:
        rule = _line_rule(nodes, 1)
        phase = _PHASE[:, None] * u
        exact = np.sinc(phase / (2 * pi))
        centred = rule.barycentric[:, 1] - 0.5
        approx = np.cos(phase[..., None] * centred) @ rule.weights
        wrong, power = ((approx - exact) ** 2).mean(1), (exact**2).mean(1)
        best = 0.0
        for reach in _PHASE[1:]:
            e, p = (weight @ np.interp(s * reach, _PHASE, t) for t in (wrong, power))
            if np.sqrt(e / p) > error:
                break
            best = float(reach)
        found.append(best)
    return tuple(found)


def _choose_line_rules(
    phases: np.ndarray, threshold: float, error: float
) -> list[tuple[Rule, np.ndarray]]:
    """The cheapest rule for each segment, with the segments that take it."""
    limits = _largest_phases(threshold, error)
    choices = [(n, limit) for n, limit in zip(_NODES, limits, strict=True) if limit > 0]
    by_rule: dict[tuple[int, int], list[int]] = {}
    for k, phase in enumerate(phases.tolist()):
        parts = [(n, max(1, ceil(phase / limit))) for n, limit in choices]
        by_rule.setdefault(min(parts, key=lambda p: p[0] * p[1]), []).append(k)
    return [(_line_rule(*key), np.array(where)) for key, where in by_rule.items()]


# ----------------------------------------------------------------------------------- closed forms


def _checked(
    vertices: Tensor | np.ndarray,
    elements: Tensor | np.ndarray,
    wavevectors: Tensor | np.ndarray,
    weights: Tensor | np.ndarray | None,
    corners: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    v, xi = (torch.as_tensor(t).to(torch.float64) for t in (vertices, wavevectors))
    e = torch.as_tensor(elements).to(torch.int64)
    if v.ndim != 2 or v.shape[1] != 3 or e.ndim != 2 or e.shape[1] != corners:
        raise InputError(
            f"positions (V, 3) and elements (N, {corners}) are needed, "
            f"not {tuple(v.shape)} and {tuple(e.shape)}"
        )
    if xi.ndim != 2 or xi.shape[1] != 3:
        raise InputError(f"wavevectors must have shape (K, 3), not {tuple(xi.shape)}")
    if e.numel() and (int(e.min()) < 0 or int(e.max()) >= len(v)):
        raise InputError("a segment names a vertex that is not there")
    w = v.new_ones(len(e)) if weights is None else torch.as_tensor(weights).to(torch.float64)
    if w.shape != (len(e),):
        raise InputError(f"weights must have shape ({len(e)},), not {tuple(w.shape)}")
    return v, e, w, xi


def _in_chunks(part: Callable[..., Tensor], *tensors: Tensor) -> Tensor:
    """``part`` at all wavevectors (the last tensor), some at a time; the gradient computes anew."""
    *elements, xi = tensors
    step = max(1, _PAIRS_AT_ONCE // max(len(elements[0]), 1))
    parts = [torch.zeros(0, dtype=torch.complex128)]
    for k in range(0, len(xi), step):
        parts.append(checkpoint(part, *elements, xi[k : k + step], use_reentrant=False))
    return torch.cat(parts)


def _segments_part(a: Tensor, b: Tensor, weights: Tensor, xi: Tensor) -> Tensor:
    along = b - a
    size = weights * torch.linalg.vector_norm(along, dim=1)
    phase = ((a + b) / 2) @ xi.T
    share, _ = sinc(along @ xi.T / 2)
    return size.to(torch.complex128) @ (torch.exp(-1j * phase) * share)


def _points_part(points: Tensor, weights: Tensor, xi: Tensor) -> Tensor:
    return weights.to(torch.complex128) @ torch.exp(-1j * (points @ xi.T))
