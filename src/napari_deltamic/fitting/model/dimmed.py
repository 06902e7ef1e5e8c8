"""What dark nuclei dim of the light of the insides around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...scene import Grid
from ...scene.effects import Effects
from ...scene.render import offset


def with_nuclei(
    even: NDArray[np.float32],
    dimmed: NDArray[np.float32] | None,
    background: float,
    effects: Effects,
    grid: Grid,
) -> NDArray[np.float32]:
    """(Z, Y, X) the image of even insides, with what nuclei dim; what effects add is as bright."""
    if dimmed is None:
        return even
    added = offset(effects, grid)
    dark = np.float32(background) if added is None else added.numpy() + np.float32(background)
    shown: NDArray[np.float32] = (dark + dimmed * (even - dark)).astype(np.float32)
    return shown
