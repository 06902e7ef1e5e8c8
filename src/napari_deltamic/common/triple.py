"""Three numbers, one along each axis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Triple = tuple[float, float, float]


def triple(values: Iterable[Any]) -> Triple:
    """Three values (Z, Y, X) as a tuple of plain floats."""
    z, y, x = (float(v) for v in values)
    return z, y, x


def geometric_mean(sides: Sequence[float] | NDArray[Any]) -> float:
    """One length in place of three, such as a voxel's sides or a PSF's widths along Z, Y, X."""
    return float(np.prod(sides)) ** (1 / len(sides))
