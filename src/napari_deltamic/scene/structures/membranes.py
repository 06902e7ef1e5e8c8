"""Membranes: the faces of a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError
from ...fourier import Plan
from ...geometry.arrays import FloatArray, is_tensor
from ...geometry.mesh import Mesh
from ..effects import Effects
from .checked_numbers import Values, as_tensor, check_numbers
from .seen import act_on_object, joined_boxes, shares
from .site import CPU, Planned, Site, mesh_plan


@dataclass(frozen=True, eq=False)
class Surface:
    """Membranes: the faces of a mesh; a wall between two regions is two membranes.

    Attributes
    ----------
    mesh
        Vertices in um; rendering is differentiable in them where they are a tensor.
    density
        Fluorophores per um^2 of membrane: one number, or (F,).
    """

    mesh: Mesh
    density: Values = 1.0

    def __post_init__(self) -> None:
        check_numbers(self.density, len(self.mesh.faces), "density", "face")

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return self.mesh.vertices_numpy()

    def planned(self, site: Site) -> Planned:
        """See ``Structure``."""
        return _PlannedSurface(self, site, mesh_plan(self.mesh, site))


class _PlannedSurface:
    """See ``Planned``."""

    def __init__(self, surface: Surface, site: Site, plan: Plan) -> None:
        self._surface, self._site, self.plan = surface, site, plan
        mesh, there = surface.mesh, site.device
        self._faces = torch.as_tensor(mesh.faces, device=there)
        self._membranes = torch.as_tensor(mesh.membranes(), dtype=torch.float64, device=there)
        self._origin = torch.tensor(site.grid.origin, dtype=torch.float64, device=there)

    def transform(
        self, effects: Effects, vertices: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """See ``Planned``."""
        weight = self._weight(density)
        if vertices is None:
            vertices = as_tensor(self._surface.mesh.vertices)
        there = self._site.device if not act_on_object(effects) else CPU
        vertices, faces, weight = (t.to(there) for t in (vertices, self._faces, weight))
        placed = vertices - self._origin.to(vertices)
        seen = shares(weight, lambda: vertices[faces].mean(1), self._site.frame, effects)
        return joined_boxes([self.plan.transform(placed, faces, part) for part in seen])

    def _weight(self, density: Tensor | None) -> Tensor:
        weight = self._membranes
        own = self._surface.density
        if density is None and (is_tensor(own) or not np.array_equal(own, 1.0)):
            # A copy of an array: torch warns of those that are read-only.
            density = torch.tensor(own) if isinstance(own, np.ndarray) else torch.as_tensor(own)
        if density is None:
            return weight
        if density.ndim and density.shape != weight.shape:
            raise InputError(
                f"density must have shape ({len(weight)},), one number per face, "
                f"not {tuple(density.shape)}"
            )
        return weight * density.to(weight.device)
