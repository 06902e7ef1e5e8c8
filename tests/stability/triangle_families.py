"""Triangles on which formulas for the transform break, by family."""

from functools import cache

import numpy as np

X = (0.0, 0.0, 1.0)
TURN = 2 * np.pi
GAPS = 10.0 ** np.arange(-12, 3)
UNITS = {"nm": 1e3, "m": 1e-6, "huge units": 2.0**40, "tiny units": 2.0**-40}

# Value and gradients of these are exactly zero.
NO_AREA = {
    "on a line": [[0, 0, 0], [1, 2, 3], [2, 4, 6]],
    "one point": [[1, 2, 3]] * 3,
    "first is second": [[0.3, 0.7, 5.0], [0.3, 0.7, 5.0], [1.1, -2.0, 4.0]],
    "second is third": [[1.1, -2.0, 4.0], [0.3, 0.7, 5.0], [0.3, 0.7, 5.0]],
    "third is first": [[0.3, 0.7, 5.0], [1.1, -2.0, 4.0], [0.3, 0.7, 5.0]],
}


def near_phases(gap):
    """Phases (N, 3) of which one, two or three pairs are this close."""
    spreads = (0.5, 1.9, 2.1, 7.0, 60.0, 1000.0)
    return {
        "one near pair": [(0.0, gap, s) for s in spreads],
        "two near pairs": [(0.0, gap, gap * r) for r in (1.01, 7.0, 1e3) if gap * r < 1e3],
        "three near pairs": [(-gap, 0.0, gap * r) for r in (1.0, 1.5)],
    }


def _phases():
    """(N, 3) phases, with the names of their families."""
    spreads = (0.5, 1.9, 2.1, 7.0, 60.0, 1000.0)
    near = (-1e-3, -1e-6, -1e-7, -1e-15, 0.0, 1e-15, 1e-7, 1e-6, 1e-3)
    by_gap = [near_phases(g) for g in GAPS]
    families = {name: [p for each in by_gap for p in each[name]] for name in by_gap[0]}
    families |= {
        "coincident": [(0.0, 0.0, s) for s in (0.0, 1e-12, *spreads)]
        + [(s, s, s) for s in spreads],
        "zeros": [(0.0, TURN * m, TURN * n) for m in (1, 2, 7) for n in (-1, -3, 5, 150)],
        "near tau": [
            (0.0, 2 * (1 + e) * f, 2 * (1 + e)) for e in near for f in (0, 1e-8, 0.01, 0.3, 0.5, 1)
        ],
        # The large branch switches its sinc where a phase relative to the median one passes 2.
        "near 2 from the median": [
            (0.0, 2 * (1 + e), 2 * (1 + e) - d) for e in near for d in (2.5, 5.0, 800.0)
        ],
    }
    rng = np.random.default_rng(7)
    families["any"] = list(10 ** rng.uniform(-4, 3, (100, 3)) * rng.choice([-1, 1], (100, 3)))
    return families


def standing(phases, rng):
    """Triangles whose phases at xi = (0, 0, 1) are these, in any order of the vertices; half of
    them shifted along x, where a small gap survives only as far as the type holds it."""
    p = rng.permuted(np.asarray(phases, float), axis=1)
    p = (
        p
        + np.where(rng.random(len(p)) < 0.5, 0.0, rng.choice([-300.0, -1.0, 30.0], len(p)))[:, None]
    )
    corners = np.zeros((len(p), 3, 3))
    corners[:, 1, 0], corners[:, 2, 1] = 1.0, 1.0
    corners[:, :, 2] = p
    return corners


def rotation(rng):
    """A random orthogonal matrix."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q


@cache
def families():
    """Name -> (vertices (N, 3, 3), wavevector (3,))."""
    rng = np.random.default_rng(3)
    out = {name: (standing(p, rng), X) for name, p in _phases().items()}
    mixed = np.concatenate([v for v, _ in out.values()])
    for axis, name in ((0, "phases along z"), (1, "phases along y")):
        out[name] = (np.roll(mixed[axis::9], axis + 1, axis=2), tuple(np.eye(3)[axis]))
    slivers = [
        length * np.array([[0, 0, 0], [0, 0, 1], [0, 1 / aspect, at]]) @ rotation(rng)
        for length in (0.3, 3.0, 50.0)
        for aspect in (1e1, 1e2, 1e3, 1e4, 1e5, 1e6)
        for at in (0.0, 1e-5, 0.5, 1.0)
    ]
    out["slivers"] = (np.array(slivers), X)
    # In eighths, which float32 still holds at a million.
    steps = rng.integers(-64, 64, (60, 3, 3)) / 8
    out["far across"] = (steps + np.array([1e6, -1e6, 0.0]), X)
    out["far along"] = (steps + np.array([0.0, 0.0, 1e6]), X)
    turned = rotation(np.random.default_rng(8))
    turned *= np.sign(turned[2, 2])  # the band holds wavevectors of kx >= 0
    out["any direction"] = (mixed[2::6] @ turned, tuple(X @ turned))
    for name, unit in UNITS.items():
        out[name] = (mixed[::9] * unit, (0.0, 0.0, 1 / unit))
    return out
