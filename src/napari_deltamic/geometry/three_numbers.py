"""Checks three numbers of a user, one along each axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from .mesh import FloatArray


def three_numbers(
    values: Sequence[float] | FloatArray, name: str, *, positive: bool = True
) -> FloatArray:
    """Return (3,) um, Z, Y, X. InputError (with ``name``) unless finite and, if asked, positive."""
    array = np.asarray(values, np.float64)
    if array.shape != (3,) or not np.isfinite(array).all() or (positive and (array <= 0).any()):
        raise InputError(f"{name} must be 3 {'positive ' * positive}numbers (um, Z, Y, X)")
    return array
