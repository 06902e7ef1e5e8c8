"""Light inside cells, as files of earlier versions have it: among the effects, by the name bulk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from .light import Light
from .scene import Scene
from .structures import Solid, Structure, Surface

_NAME = "bulk"


@dataclass(frozen=True)
class Inside:
    """What such a file says.

    Attributes
    ----------
    density
        Fluorophores per um^3 that the inside has more than the outside, for one per um^2 of
        membrane.
    regions
        Region -> factor on the density; 1 where not given.
    """

    density: float
    regions: Mapping[int, float]

    def added_to(self, light: Light) -> Light:
        """What shines with it. One number stands for all cells."""
        return replace(light, interior=light.interior + self.density)

    def added_to_scene(self, scene: Scene) -> Scene:
        """The scene with the inside of each of its surfaces."""
        solids: list[Structure] = []
        for structure in scene.structures:
            if isinstance(structure, Surface):
                ids = structure.mesh.region_ids().tolist()
                densities = {k: self.density * self.regions.get(k, 1.0) for k in ids}
                solids.append(Solid(structure.mesh, densities))
        return replace(scene, structures=(*scene.structures, *solids))


def without_inside(effects: Any) -> tuple[Any, Inside | None]:
    """Plain effects, names or a mapping to fields, without it; and what it says, if it is there."""
    named = isinstance(effects, (Mapping, list, tuple)) and _NAME in effects
    if not named:
        return effects, None
    if not isinstance(effects, Mapping):
        effects = {name: {} for name in effects}
    rest = {name: fields for name, fields in effects.items() if name != _NAME}
    fields = effects[_NAME] or {}
    factors = {int(k): float(v) for k, v in fields.get("regions", {}).items()}
    return rest, Inside(float(fields.get("density", 0.0)), factors)
