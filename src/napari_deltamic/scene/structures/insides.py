"""Insides: the filled regions of a mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ...common.kept import kept
from ...errors import InputError
from ...fourier import Plan
from ...fourier.solid import contrasts, jumps, sides_of, solid_transform
from ...fourier.solid_plan import SolidPlan
from ...geometry.mesh import FloatArray, Mesh
from ...geometry.windings import right_side_out
from ..effects import Effects
from ..grid import Grid
from .checked_numbers import Values, as_tensor, check_numbers
from .seen import act_on_object, joined_boxes, shares
from .site import CPU, Planned, Site, mesh_plan


@dataclass(frozen=True, eq=False)
class Solid:
    """The inside of the regions of a mesh: cytoplasm, nuclei, a filled bead.

    Attributes
    ----------
    mesh
        Closed regions; rendering is differentiable in the vertices if they are a tensor. Regions
        that are inside out are turned, with a RepairWarning.
    density
        Fluorophores per um^3: one number for all regions, a mapping by region number (0 for those
        not named), or (R,) in the order of ``mesh.region_ids()``.
    """

    mesh: Mesh
    density: Values | Mapping[int, float] = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "mesh", right_side_out(self.mesh))
        ids = self.mesh.region_ids()
        if isinstance(self.density, Mapping):
            unknown = [k for k in self.density if k not in ids]
            if unknown:
                raise InputError(f"the mesh has no region {unknown[0]}")
            check_numbers(np.array(list(self.density.values()), float), None, "density", "region")
        else:
            check_numbers(self.density, len(ids), "density", "region")
        for region, density in zip(ids.tolist(), self.densities().tolist(), strict=True):
            if density and not self.mesh.is_closed(region):
                raise InputError(f"region {region} is not closed: a solid needs closed surfaces")

    def densities(self) -> Tensor:
        """Return (R,) fluorophores per um^3, in the order of ``mesh.region_ids()``."""
        ids = self.mesh.region_ids().tolist()
        if isinstance(self.density, Mapping):
            return torch.tensor([float(self.density.get(k, 0.0)) for k in ids])
        return torch.as_tensor(self.density, dtype=torch.float64).expand(len(ids))

    @cached_property
    def _middles(self) -> Tensor:
        """The places (R, 3) um at which effects on the object act on the regions."""
        return torch.stack([_middle(self.mesh, k) for k in self.mesh.region_ids()])

    def contrasts(
        self,
        effects: Effects,
        frame: Grid,
        factors: Tensor | None = None,
        device: torch.device = CPU,
    ) -> list[Tensor]:
        """Return (F,) signal per um^3 behind each face minus that in front, with the effects.

        Differentiable in ``factors`` (R,) on the densities of the regions. Two results if the PSF
        changes with depth: the signal seen through the PSF of the first slice, and of the last.
        """
        there, count = device if not act_on_object(effects) else CPU, len(self.mesh.region_ids())
        if factors is not None and factors.shape != (count,):
            shape = tuple(factors.shape)
            raise InputError(f"one number per region is needed: shape ({count},), not {shape}")
        own = self.densities().to(there, torch.float64)
        own = own if factors is None else own * factors.to(own)
        seen = shares(own, lambda: self._middles, frame, effects)
        return [jumps(self._sides_on(device), densities.to(device)) for densities in seen]

    @kept
    def _sides_on(self, device: torch.device) -> Tensor:
        return sides_of(self.mesh.regions, self.mesh.region_ids()).to(device)

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return self.mesh.vertices_numpy()

    def planned(self, site: Site) -> Planned:
        """See ``Structure``."""
        ids, own = self.mesh.region_ids(), self.densities().detach().to(torch.float64)
        contrast = contrasts(self.mesh.regions, ids, own).numpy()
        plan = mesh_plan(self.mesh, site, contrast)
        local = self.mesh.vertices_numpy() - np.asarray(site.grid.origin)
        solid_plan = SolidPlan.of(plan, local, self.mesh.faces, contrast, site.stretch)
        return _PlannedSolid(self, site, solid_plan)


class _PlannedSolid:
    """See ``Planned``."""

    def __init__(self, solid: Solid, site: Site, plan: SolidPlan) -> None:
        self._solid, self._site, self._plan = solid, site, plan
        self._faces = torch.as_tensor(solid.mesh.faces).to(site.device)

    @property
    def plan(self) -> Plan:
        """See ``Planned``."""
        return self._plan.plan

    def transform(
        self, effects: Effects, vertices: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """See ``Planned``."""
        placed = self._site.local(
            as_tensor(self._solid.mesh.vertices) if vertices is None else vertices
        ).to(self._site.device)
        seen = self._solid.contrasts(effects, self._site.frame, density, placed.device)
        boxes = [solid_transform(self._plan, placed, self._faces, each) for each in seen]
        return joined_boxes(boxes)


def _middle(mesh: Mesh, region: int) -> Tensor:
    used = np.unique(mesh.faces[mesh.faces_by_region()[region]])
    return as_tensor(mesh.vertices)[torch.from_numpy(used)].detach().to(torch.float64).mean(0)
