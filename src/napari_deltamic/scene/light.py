"""Which part of a mesh shines: its membranes, the inside of its cells, or both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.choices import Structure


@dataclass(frozen=True)
class Light:
    """Brightness of membranes and insides relative to each other; an amplitude scales both.

    Attributes
    ----------
    membrane
        Factor on the densities of the faces; 0 if membranes do not shine.
    interior
        Fluorophores per um^3 in every cell minus those outside, for one per um^2 of membrane;
        negative if the medium around is brighter. 0: insides are not computed.
    cells
        Pairs of a region's number and the brightness of its inside relative to ``interior``; 1 for
        regions that are not named.
    """

    membrane: float = 1.0
    interior: float = 0.0
    cells: tuple[tuple[int, float], ...] = ()

    def of(self, surface: bool) -> float:
        """Return the factor on a surface, or on a solid."""
        return self.membrane if surface else self.interior

    def of_cells(self, regions: Sequence[int] | NDArray) -> NDArray[np.float64]:
        """Return (R,) how bright the insides of these regions are, relative to ``interior``."""
        known = dict(self.cells)
        return np.array([known.get(int(k), 1.0) for k in regions], dtype=np.float64)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Light:
        """Make a light from the values in a file. KeyError if one is missing."""
        cells = tuple((int(k), float(by)) for k, by in values["cells"])
        return cls(float(values["membrane"]), float(values["interior"]), cells)

    def insides(self) -> Light:
        """Return only the insides, with ``interior`` 1."""
        return Light(0.0, 1.0, self.cells)


def structure_of(light: Light) -> Structure:
    """Return the name of what shines."""
    if not light.interior:
        return "membrane"
    return "both" if light.membrane else "interior"


MEMBRANES = Light()
INSIDES = Light(membrane=0.0, interior=1.0)
