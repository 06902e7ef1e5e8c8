"""All that is fitted, as one vector: vertices, densities, PSF and effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import FloatArray


@dataclass(frozen=True, eq=False)
class Variables:
    """What a fit looks for, or a gradient by it.

    Attributes
    ----------
    vertices
        (V, 3) um.
    density
        (D,) log density of each vertex or wall; D = 0 where it is uniform.
    optics
        (P,) unbounded numbers of the PSF, see :meth:`Optics.parameters`; P = 0 where it is held.
    effects
        (E,) numbers of the fitted effects in units of their scale; E = 0 where none is fitted.
    """

    vertices: FloatArray
    density: FloatArray
    optics: FloatArray
    effects: FloatArray

    def flat(self) -> FloatArray:
        """(3 V + D + P + E,)."""
        parts = (self.vertices.ravel(), self.density, self.optics, self.effects)
        return np.concatenate(parts)

    def with_flat(self, numbers: FloatArray) -> Variables:
        """The same blocks with other numbers."""
        ends = np.cumsum([self.vertices.size, len(self.density), len(self.optics)])
        v, d, p, e = np.split(numbers, ends)
        return Variables(v.reshape(-1, 3), d, p, e)

    @property
    def on_surface(self) -> int:
        """How many of the numbers belong to vertices and densities; they come first."""
        return self.vertices.size + len(self.density)
