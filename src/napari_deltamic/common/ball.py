"""The ball of equal volume, which gives the size of something as one length."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def ball_radius(volume: ArrayLike) -> Any:
    """Radius (um) of a ball of the given volume (um^3); element by element for an array."""
    return np.cbrt(3 / (4 * np.pi) * np.asarray(volume))
