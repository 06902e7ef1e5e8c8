"""Quadrature on triangles: which weighted points stand in for a face, and with what error.

Symmetric rules (D. A. Dunavant, "High degree efficient symmetrical Gaussian quadrature rules for
the triangle", Int. J. Numer. Methods Eng. 21, 1985), their coefficients recomputed to double
precision from the moment equations; larger faces are divided.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import permutations

import numpy as np
import torch

from .triangle import triangle_transform

# Orbits of the triangle's symmetry group: ("centre", w), ("median", w, a), ("general", w, a, b).
_ORBITS: dict[int, list[tuple]] = {
    1: [("centre", 1.0)],
    2: [("median", 1 / 3, 1 / 6)],
    4: [
        ("median", 0.22338158967801147, 0.44594849091596483),
        ("median", 0.10995174365532184, 0.09157621350977069),
    ],
    6: [
        ("median", 0.11678627572637999, 0.24928674517090932),
        ("median", 0.050844906370207325, 0.06308901449150253),
        ("general", 0.08285107561837299, 0.0531450498448169, 0.3103524510337855),
    ],
    8: [
        ("centre", 0.14431560767777474),
        ("median", 0.09509163426729293, 0.4592925882927148),
        ("median", 0.10321737053472131, 0.17056930775175022),
        ("median", 0.03245849762319903, 0.05054722831703108),
        ("general", 0.027230314174430902, 0.00839477740994355, 0.263112829634667),
    ],
}
DEGREES = tuple(_ORBITS)


@dataclass(frozen=True, eq=False)
class Rule:
    """Barycentric points (P, 3) and weights (P,) that sum to 1."""

    degree: int
    divisions: int
    barycentric: np.ndarray
    weights: np.ndarray


@cache
def rule(degree: int, divisions: int = 1) -> Rule:
    """Return a rule exact up to ``degree``, on each of ``divisions``^2 equal parts of a face."""
    points, weights = [], []
    for kind, w, *at in _ORBITS[degree]:
        if kind == "centre":
            corners = [(1 / 3, 1 / 3, 1 / 3)]
        elif kind == "median":
            a = at[0]
            corners = [(1 - 2 * a, a, a), (a, 1 - 2 * a, a), (a, a, 1 - 2 * a)]
        else:
            corners = list(permutations((at[0], at[1], 1 - at[0] - at[1])))
        points += corners
        weights += [w] * len(corners)
    b, w = np.array(points), np.array(weights)
    parts = _divide(divisions)
    return Rule(
        degree,
        divisions,
        np.einsum("pk,skj->spj", b, parts).reshape(-1, 3),
        np.tile(w, len(parts)) / len(parts),
    )


def _divide(n: int) -> np.ndarray:
    """Return (n^2, 3, 3) corners of the parts of a triangle, in barycentric coordinates."""
    corner = lambda i, j: (1 - (i + j) / n, i / n, j / n)  # noqa: E731
    parts = [
        (corner(i, j), corner(i + 1, j), corner(i, j + 1)) for i in range(n) for j in range(n - i)
    ]
    parts += [
        (corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1))
        for i in range(n)
        for j in range(n - i - 1)
    ]
    return np.array(parts)


# ------------------------------------------------------------------------------------- errors

_PHASE = np.linspace(0.0, 12.0, 61)  # largest edge phase, rad
# Shapes with longest edge 1: equilateral, half a square, a needle.
_SHAPES = np.array(
    [
        [[0, 0], [1, 0], [0.5, np.sqrt(0.75)]],
        [[0, 0], [1, 0], [0.5, 0.5]],
        [[0, 0], [1, 0], [0.5, 0.05]],
    ]
)


@cache
def _error_tables() -> tuple[np.ndarray, np.ndarray]:
    """Return means over directions: |F_rule - F|^2 (degree, shape, phase), |F|^2 (shape, phase)."""
    u = (np.arange(24) + 0.5) / 24
    in_plane = np.sqrt(1 - u**2)  # of directions spread evenly over the sphere
    angle = 2 * np.pi * (np.arange(24) + 0.5) / 24
    direction = np.stack(
        [np.outer(in_plane, np.cos(angle)).ravel(), np.outer(in_plane, np.sin(angle)).ravel()], 1
    )
    centred = _SHAPES - _SHAPES.mean(1, keepdims=True)
    phase = np.einsum("svi,di,p->svpd", centred, direction, _PHASE)
    edges = np.stack(
        [phase[:, 2] - phase[:, 1], phase[:, 0] - phase[:, 2], phase[:, 1] - phase[:, 0]]
    )
    exact = 2 * triangle_transform(torch.from_numpy(edges))[0].numpy()
    error = np.empty((len(DEGREES), len(_SHAPES), len(_PHASE)))
    for i, degree in enumerate(DEGREES):
        r = rule(degree)
        approx = np.zeros_like(exact)
        for b, w in zip(r.barycentric, r.weights, strict=True):
            approx += w * np.exp(-1j * np.einsum("v,svpd->spd", b, phase))
        error[i] = (np.abs(approx - exact) ** 2).mean(-1)
    return error, (np.abs(exact) ** 2).mean(-1)


@cache
def _largest_phases(threshold: float, error: float, filled: bool) -> tuple[float, ...]:
    """Return, by degree, the longest edge (rad at the band's edge) that keeps to ``error``."""
    table, power = _error_tables()
    s = np.linspace(0.01, 1.0, 100)  # fraction of the band's radius
    shell = 1.0 if filled else s**2  # for a solid, the flux is divided by the wavevector
    weight = shell * threshold ** (2 * s**2)  # and |OTF|^2 of a Gaussian
    out = []
    for i in range(len(DEGREES)):
        best = 0.0
        for reach in _PHASE[1:]:
            e = np.array([np.interp(s * reach, _PHASE, t) for t in table[i]])
            p = np.array([np.interp(s * reach, _PHASE, t) for t in power])
            if np.sqrt(((weight * e).sum(1) / (weight * p).sum(1)).max()) > error:
                break
            best = float(reach)
        out.append(best)
    return tuple(out)


def choose_rules(
    reach: np.ndarray, threshold: float, error: float, filled: bool = False
) -> list[tuple[Rule, np.ndarray]]:
    """Choose the cheapest rule for every face that keeps the image within ``error``.

    Parameters
    ----------
    reach
        (F,) largest phase along the longest edge of each face, at the edge of the band; rad.
    threshold
        |OTF| at the edge of the band.
    error
        Relative L2 error of the image that quadrature may cause.
    filled
        Whether what shines is inside the faces, rather than on them.

    Returns
    -------
    Rules, each with the indices of its faces.
    """
    limits = _largest_phases(threshold, error, filled)
    sizes = np.array([len(rule(d).weights) for d in DEGREES])
    usable = [i for i, limit in enumerate(limits) if limit > 0]
    divisions = np.ceil(np.maximum(reach, 1e-300)[:, None] / np.array(limits)[None, usable])
    cost = divisions**2 * sizes[None, usable]
    best = cost.argmin(1)
    n = divisions[np.arange(len(reach)), best].astype(np.int64)
    groups = []
    key = n * len(usable) + best
    for one in np.unique(key).tolist():
        divisions_each, which = divmod(one, len(usable))
        found = rule(DEGREES[usable[which]], divisions_each)
        groups.append((found, np.flatnonzero(key == one)))
    return groups
