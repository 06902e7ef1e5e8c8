"""Balls as large as something else, for its size as one length."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def ball_radius(volume: ArrayLike) -> Any:
    """um: of a ball of so many um^3; of one number, or of each of several."""
    return np.cbrt(3 / (4 * np.pi) * np.asarray(volume))
