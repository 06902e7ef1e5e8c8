"""How far a step may lead: within bounds, near to where its objective holds, without collisions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry.mesh import FloatArray
from ...geometry.vectors import lengths
from ..model.density import RULES as DENSITY
from ..model.imaging import Imaging
from ..model.unequal_insides import Insides
from ..model.variables import Variables
from ..surface.collisions import CollisionGuard


@dataclass(frozen=True, eq=False)
class Limits:
    """What steps of one objective are held to.

    Attributes
    ----------
    around
        (V, 3) um: where the objective was posed.
    farthest
        um that a vertex may go away from there.
    imaging
        Bounds of the PSF and of effects.
    guard
        Against collisions, if any.
    """

    around: FloatArray
    farthest: float
    imaging: Imaging
    guard: CollisionGuard | None = None

    def within(self, start: Variables, end: Variables) -> Variables:
        """The point nearest to the end that a step from the start may reach."""
        away = end.vertices - self.around
        far = lengths(away)[:, None] / self.farthest
        vertices = self.around + away / np.maximum(far, 1.0)
        if self.guard is not None:
            vertices = self.guard.limited(start.vertices, vertices)
        return Variables(
            vertices,
            np.clip(end.density, -DENSITY.limit, DENSITY.limit),
            Insides.bounded(end.insides),
            *self.imaging.bounded(end.optics, end.effects),
        )
