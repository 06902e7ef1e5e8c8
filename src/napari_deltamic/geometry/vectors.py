"""Lengths and products of many vectors: several times faster than NumPy's for rows of three."""

from __future__ import annotations

import numpy as np

from .mesh import FloatArray


def lengths(vectors: FloatArray) -> FloatArray:
    """Return lengths (N,) of vectors (N, 3)."""
    z, y, x = vectors.T
    found: FloatArray = np.sqrt(z * z + y * y + x * x)
    return found


def crossed(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return cross products (3, N) of vectors (3, N)."""
    (a, b, c), (d, e, f) = one, other
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d])
