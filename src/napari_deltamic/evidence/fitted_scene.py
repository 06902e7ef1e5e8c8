"""A fitted scene: everything that the expected image depends on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene.effects import Effects


@dataclass(frozen=True)
class FittedScene:
    """Everything that the expected image depends on.

    Attributes
    ----------
    mesh, optics, effects
        As they were fitted.
    amplitude, background
        Expected image = amplitude * rendered image + background + what effects add.
    density
        (F,) of the membranes relative to the mean; None where it is the same everywhere.
    """

    mesh: Mesh
    optics: Optics
    effects: Effects
    amplitude: float
    background: float
    density: np.ndarray | None = None
