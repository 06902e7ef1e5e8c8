"""Three numbers, one along each axis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Triple = tuple[float, float, float]


def triple(values: Iterable[Any]) -> Triple:
    """Z, Y, X as plain numbers."""
    z, y, x = (float(v) for v in values)
    return z, y, x


def geometric_mean(sides: Sequence[float] | NDArray[Any]) -> float:
    """One length for three, such as those of a voxel or the widths of a PSF along Z, Y, X."""
    return float(np.prod(sides)) ** (1 / len(sides))
