"""The scene: structures, optics and effects in one object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from ..errors import InputError
from ..geometry.mesh import IntArray, Mesh
from ..optics import Optics
from .effects import Effects, as_effects
from .structures import Solid, Structure, Surface, Values


@dataclass(frozen=True, eq=False)
class Scene:
    """What the microscope looks at, and through which optics.

    Attributes
    ----------
    structures
        One or several things that shine: surfaces, solids, filaments, points.
    optics
        The PSF.
    effects
        Optional parts of image formation, or their names; absent ones are not computed. An effect
        on the object (attenuation, a PSF that changes with depth) acts on all structures.
    """

    structures: tuple[Structure, ...]
    optics: Optics
    effects: Effects = field(default_factory=Effects)

    def __post_init__(self) -> None:
        given = self.structures
        structures = tuple(given) if isinstance(given, (list, tuple)) else (given,)
        if not structures:
            raise InputError("a scene needs a structure: a surface, solid, filament or points")
        object.__setattr__(self, "structures", structures)
        object.__setattr__(self, "effects", as_effects(self.effects))

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        optics: Optics,
        effects: Effects | Sequence[str] = (),
        density: Values | None = None,
        insides: bool = False,
    ) -> Self:
        """Make a scene of a mesh's membranes, by default equally dense, with insides if asked."""
        surface = Surface(mesh) if density is None else Surface(mesh, density)
        structures: tuple[Structure, ...] = (surface, Solid(mesh)) if insides else (surface,)
        return cls(structures, optics, as_effects(effects))

    @property
    def surface(self) -> Surface:
        """The first of its surfaces."""
        return next(s for s in self.structures if isinstance(s, Surface))

    @property
    def mesh(self) -> Mesh:
        """The mesh of its first surface."""
        return self.surface.mesh

    def on_one_mesh(self) -> tuple[Structure, ...]:
        """The structures that move with the scene's mesh: those with the first one's triangles.

        Their winding may differ: a solid turns a region that is inside out.
        """
        meshed = [s for s in self.structures if isinstance(s, (Surface, Solid))]
        return tuple(s for s in meshed if _same_triangles(s.mesh.faces, meshed[0].mesh.faces))

    def with_effects(self, effects: Effects | Sequence[str]) -> Self:
        """Return the scene with other effects."""
        return replace(self, effects=as_effects(effects))


def _same_triangles(one: IntArray, other: IntArray) -> bool:
    if one.shape != other.shape:
        return False
    return np.array_equal(one, other) or np.array_equal(np.sort(one, 1), np.sort(other, 1))
