"""What of a mesh shines: its membranes, the inside of its cells, or both."""

from __future__ import annotations

from dataclasses import dataclass

from ..common.choices import Structure


@dataclass(frozen=True)
class Light:
    """Membranes and insides relative to each other; an amplitude scales both.

    Attributes
    ----------
    membrane
        Factor on the densities of the faces; 0 where membranes do not shine.
    interior
        Fluorophores per um^3 that every cell has more than the outside, for one per um^2 of
        membrane; below 0 where the medium around is brighter. 0: insides are not computed.
    """

    membrane: float = 1.0
    interior: float = 0.0

    def of(self, surface: bool) -> float:
        """The factor on a surface, or on a solid."""
        return self.membrane if surface else self.interior


def structure_of(light: Light) -> Structure:
    """What shines, by name."""
    if not light.interior:
        return "membrane"
    return "both" if light.membrane else "interior"


MEMBRANES = Light()
INSIDES = Light(membrane=0.0, interior=1.0)
