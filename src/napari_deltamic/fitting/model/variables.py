"""All that is fitted, as one vector: vertices, densities, insides, PSF and effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry.mesh import FloatArray


@dataclass(frozen=True, eq=False)
class Variables:
    """What a fit looks for, or a gradient by it.

    Attributes
    ----------
    vertices
        (V, 3) um.
    density
        (D,) log density of each vertex or wall; D = 0 where it is uniform.
    insides
        (R,) by how much the inside of each region is brighter than what they share, of that; R = 0
        where insides do not shine, or are alike.
    optics
        (P,) unbounded numbers of the PSF, see :meth:`Optics.parameters`; P = 0 where it is held.
    effects
        (E,) numbers of the fitted effects in units of their scale; E = 0 where none is fitted.
    """

    vertices: FloatArray
    density: FloatArray
    insides: FloatArray
    optics: FloatArray
    effects: FloatArray

    def flat(self) -> FloatArray:
        """(3 V + D + R + P + E,)."""
        parts = (
            self.vertices.ravel(),
            self.density,
            self.insides,
            self.optics,
            self.effects,
        )
        return np.concatenate(parts)

    def with_flat(self, numbers: FloatArray) -> Variables:
        """The same blocks with other numbers."""
        blocks = self.vertices.size, len(self.density), len(self.insides), len(self.optics)
        v, d, r, p, e = np.split(numbers, np.cumsum(blocks))
        return Variables(v.reshape(-1, 3), d, r, p, e)

    @property
    def on_surface(self) -> int:
        """How many of the numbers belong to vertices and densities; they come first."""
        return self.vertices.size + len(self.density)
