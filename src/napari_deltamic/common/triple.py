"""Three numbers, one along each axis."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

Triple = tuple[float, float, float]


def triple(values: Iterable[Any]) -> Triple:
    """Z, Y, X as plain numbers."""
    z, y, x = (float(v) for v in values)
    return z, y, x
