"""Fourier transform of filaments (polylines) and of points, planned for an accuracy.

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


def path_segments(count: int) -> np.ndarray:
    """Return (S, 2) segments that join ``count`` vertices one after the other.

    Raises InputError for fewer than two vertices.
    """
    if count < 2:
        raise InputError(f"a filament needs two vertices or more, not {count}")
    first = np.arange(count - 1)
    return np.stack([first, first + 1], 1)


# ----------------------------------------------------------------------------------------- plans


@dataclass(frozen=True, eq=False)
class LinePlan:
    """How u_hat of segments or points is computed on a band, like :class:`Plan` for triangles.

    Attributes
    ----------
    rules
        Quadrature rules, each with its segments; empty for points and for the closed form.
    work
        Work of one rendering by the particle-mesh. The closed form, which serves as a check, takes
        a sine, a cosine and about ten passes over each pair of an element and a wavevector.
    """

    method: Method
    band: Band
    accuracy: float
    single: bool
    spreading: Spreading | None
    rules: list[tuple[Rule, np.ndarray]] = field(repr=False)
    work: Work

    def transform(self, vertices: Tensor, elements: Tensor, weights: Tensor) -> Tensor:
        """Return u_hat on the box of the band, differentiable in vertices and weights.

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
    """Choose band and rules for segments (S, 2) or points (P, 1), like :func:`make_plan`.

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
    """Return the Gauss-Legendre rule on each of ``divisions`` equal parts of a segment."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    t = ((np.arange(divisions)[:, None] + (x + 1) / 2) / divisions).reshape(-1)
    return Rule(
        2 * nodes - 1, divisions, np.stack([1 - t, t], 1), np.tile(w / 2, divisions) / divisions
    )


@cache
def _largest_phases(threshold: float, error: float) -> tuple[float, ...]:
    """Longest segment (rad at the edge of the band) that keeps to ``error``, by number of nodes.

    The error is a mean over directions and over the band of a Gaussian OTF.
    """
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
    """Choose the cheapest rule for each segment; returns rules with the segments that take them."""
    limits = _largest_phases(threshold, error)
    choices = [(n, limit) for n, limit in zip(_NODES, limits, strict=True) if limit > 0]
    by_rule: dict[tuple[int, int], list[int]] = {}
    for k, phase in enumerate(phases.tolist()):
        parts = [(n, max(1, ceil(phase / limit))) for n, limit in choices]
        by_rule.setdefault(min(parts, key=lambda p: p[0] * p[1]), []).append(k)
    return [(_line_rule(*key), np.array(where)) for key, where in by_rule.items()]


# ----------------------------------------------------------------------------------- closed forms


def _in_chunks(part: Callable[..., Tensor], *tensors: Tensor) -> Tensor:
    """Evaluate ``part`` on chunks of the wavevectors (last tensor); the gradient recomputes it."""
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
