"""Relative tensions of walls and pressures of cells, from angles and curvatures.

At rest the tensions balance at every junction (Young and Dupre): with the unit vectors t along its
walls, away from it, ``sum of gamma t = 0``. Across a wall the pressures differ by what its
curvature requires (Laplace): ``p_a - p_b = 2 gamma H``. Angles and curvatures stay the same when
all tensions change by one factor, so tensions are given relative to their mean over a cluster, and
pressures, per um, in units of that mean (see M. Ishihara and K. Sugimura, "Bayesian inference of
force dynamics during morphogenesis", J. Theor. Biol. 313, 2012, for the two equations as one linear
system in the plane).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..errors import InputError
from ..geometry.mesh import OUTSIDE, FloatArray
from .junctions import Junction

Pair = tuple[int, int]  # of regions, the larger number first


@dataclass(frozen=True)
class TensionSettings:
    """Numbers that decide which tensions are given, and how much each junction counts.

    angle_error : degrees; error of angles without any noise, so that no junction counts as exact.
        From `python -m benchmarks.measurements`: 0.35 on analytic double bubbles.
    largest_error : of the mean tension; a tension that is less certain is left out, with the
        reason. A choice: beyond it, it is hardly known which of two walls pulls more.
    most_walls : most walls to solve for, since the matrix of errors is dense.
    """

    angle_error: float = 0.35
    largest_error: float = 0.5
    most_walls: int = 6000

    def __post_init__(self) -> None:
        if not (self.angle_error > 0 and self.largest_error > 0 and self.most_walls > 0):
            raise InputError("settings of tensions must be positive")


@dataclass(frozen=True)
class Estimate:
    """A number with its standard error, or the reason why there is none."""

    value: float | None = None
    error: float | None = None
    reason: str = ""


_RIDGE = 1e-8  # of the mean diagonal: else what nothing determines would have no error


def relative_tensions(
    junctions: Sequence[Junction],
    walls: Sequence[Pair],
    resolution: float = 0.0,
    settings: TensionSettings | None = None,
) -> dict[Pair, Estimate]:
    """Find tensions by least squares over all junctions of three walls.

    Each junction gives two equations, weighted by the standard errors of its angles. Errors follow
    from these weights, and grow with the contradictions between the equations.

    Parameters
    ----------
    junctions
        The junctions, with their angles.
    walls
        Those to tell something about.
    resolution
        Of the image, um; see :meth:`Junction.errors`.

    Returns
    -------
    One estimate for each wall; 1 is the mean of the walls that junctions join to it.
    """
    settings = settings or TensionSettings()
    found = {wall: Estimate(reason="no junction whose angles could be measured") for wall in walls}
    seen = sorted({wall for j in junctions for wall in walls_around(j.regions)})
    if len(seen) > settings.most_walls:
        reason = f"more than {settings.most_walls} walls: tensions are not solved for"
        return {wall: Estimate(reason=reason) for wall in walls}
    index = {wall: k for k, wall in enumerate(seen)}
    for group in _clusters(junctions, index):
        rows = _equations(group, index, resolution, settings.angle_error)
        own = np.flatnonzero(rows.any(0))
        values, errors = _solved(rows[:, own])
        for k, value, error in zip(own.tolist(), values, errors, strict=True):
            found[seen[k]] = _told(float(value), float(error), settings)
    return found


def relative_pressures(
    tensions: Mapping[Pair, Estimate],
    curvatures: Mapping[Pair, float],
    areas: Mapping[Pair, float],
    regions: Sequence[int],
) -> dict[int, Estimate]:
    """Find pressures by least squares over the walls whose tension and mean curvature are known.

    Standard errors include those of the tensions and the contradictions between walls.

    Parameters
    ----------
    tensions
        From :func:`relative_tensions`.
    curvatures
        Mean curvatures, 1/um; positive where a wall bulges out of its pair's first region.
    areas
        um^2; the weight of each wall.
    regions
        Those to estimate.
    """
    known = [
        (pair, t.value * 2 * curvatures[pair], areas[pair], (t.error or 0.0) / t.value)
        for pair, t in tensions.items()
        if t.value is not None and np.isfinite(curvatures.get(pair, np.nan))
    ]
    unknown = Estimate(reason="tension and curvature are not both known for any of its walls")
    found = dict.fromkeys(regions, unknown)
    cells = sorted({region for pair, *_ in known for region in pair} | {OUTSIDE})
    index = {region: k for k, region in enumerate(cells)}
    rows = np.zeros((len(known), len(cells)))
    for row, (pair, *_) in zip(rows, known, strict=True):
        row[index[pair[0]]], row[index[pair[1]]] = 1.0, -1.0
    jumps, weight, unsure = np.array([rest for _, *rest in known]).reshape(-1, 3).T
    linked = connected_components(coo_matrix(np.abs(rows.T) @ np.abs(rows)), directed=False)[1]
    for number in np.unique(linked):
        own = np.flatnonzero(linked == number)
        if OUTSIDE not in {cells[k] for k in own}:
            for k in own:
                found[cells[k]] = Estimate(reason="no measured walls lead to the outside")
            continue
        free = [k for k in own if cells[k] != OUTSIDE]
        used = rows[:, free].any(1)
        if not used.any():
            continue
        values, errors = _weighted(
            rows[np.ix_(used, free)], jumps[used], np.abs(unsure * jumps)[used], weight[used]
        )
        for k, value, error in zip(free, values, errors, strict=True):
            found[cells[k]] = Estimate(float(value), float(error))
    found.pop(OUTSIDE, None)
    return found


def walls_around(regions: tuple[int, int, int]) -> tuple[Pair, Pair, Pair]:
    """Return the three walls where regions a < b < c meet: (b, a), (c, b), (c, a)."""
    a, b, c = regions
    return (b, a), (c, b), (c, a)


def _clusters(junctions: Sequence[Junction], index: Mapping[Pair, int]) -> list[list[Junction]]:
    """Group the junctions that share walls, directly or through others."""
    if not junctions:
        return []
    ends = [[index[wall] for wall in walls_around(j.regions)] for j in junctions]
    one = [e[0] for e in ends for _ in range(2)]
    other = [e[k] for e in ends for k in (1, 2)]
    shape = (len(index), len(index))
    label = connected_components(coo_matrix((np.ones(len(one)), (one, other)), shape))[1]
    groups: dict[int, list[Junction]] = {}
    for junction, e in zip(junctions, ends, strict=True):
        groups.setdefault(int(label[e[0]]), []).append(junction)
    return list(groups.values())


def _equations(
    junctions: Sequence[Junction], index: Mapping[Pair, int], resolution: float, floor: float
) -> FloatArray:
    """Return (2 J, W) equations: the force in the plane across each junction over its error."""
    rows = np.zeros((2 * len(junctions), len(index)))
    for k, junction in enumerate(junctions):
        _, b, c = np.radians(junction.angles)
        # Around the junction: wall (b, a), region b, wall (c, b), region c, wall (c, a), region a.
        directions = np.array([0.0, b, b + c])
        errors = np.radians(np.hypot(junction.errors(resolution), floor))
        weight = 1 / float(np.sqrt((errors**2).mean()))
        for wall, angle in zip(walls_around(junction.regions), directions, strict=True):
            rows[2 * k, index[wall]] += weight * np.cos(angle)
            rows[2 * k + 1, index[wall]] += weight * np.sin(angle)
    return rows


def _solved(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minimise the squared forces (M, W) at a mean tension of 1; return tensions and errors."""
    n = rows.shape[1]
    # Householder's reflection of (1, .., 1) onto the first axis: its other columns keep the mean.
    mirror = np.full(n, 1 / np.sqrt(n))
    mirror[0] += 1.0
    mirror /= np.linalg.norm(mirror)
    reflected = rows - 2 * np.outer(rows @ mirror, mirror)
    free, held = reflected[:, 1:], -np.sqrt(n) * reflected[:, 0]
    matrix = free.T @ free
    ridge = _RIDGE * max(float(matrix.diagonal().mean()), 1e-300)
    factor = cho_factor(matrix + ridge * np.eye(n - 1))
    z = cho_solve(factor, -free.T @ held)
    left = held + free @ z
    surplus = len(rows) - (n - 1)
    scale = max(1.0, float(left @ left) / surplus) if surplus > 0 else 1.0
    whole = np.concatenate([[-np.sqrt(n)], z])
    values = whole - 2 * mirror * (mirror @ whole)
    basis = np.eye(n)[:, 1:] - 2 * np.outer(mirror, mirror[1:])
    variance = np.einsum("wk,kw->w", basis, cho_solve(factor, basis.T))
    return values, np.sqrt(scale * np.maximum(variance, 0))


def _told(value: float, error: float, settings: TensionSettings) -> Estimate:
    if error > settings.largest_error:
        return Estimate(reason="angles do not determine its tension")
    if value <= 0:
        return Estimate(reason="angles contradict any tension: not at rest, or not well fitted")
    return Estimate(value, error)


def _weighted(
    rows: FloatArray, values: FloatArray, errors: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solve weighted least squares; standard errors come from those of values and residuals."""
    root = np.sqrt(weight)
    inverse = np.linalg.pinv((rows * weight[:, None]).T @ rows, hermitian=True)
    response = inverse @ (rows * weight[:, None]).T
    found = response @ values
    left = root * (rows @ found - values)
    surplus = len(rows) - rows.shape[1]
    scatter = float(left @ left) / surplus if surplus > 0 else 0.0
    variance = (response**2) @ errors**2 + scatter * inverse.diagonal()
    return found, np.sqrt(variance)
