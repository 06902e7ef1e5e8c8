"""Where structures are transformed, and the protocols that each kind of structure follows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from ...fourier import Plan, make_plan
from ...fourier.filament import LinePlan
from ...fourier.plan import Cutoff, Method
from ...fourier.spreading import Transfer
from ...geometry.mesh import FloatArray, Mesh
from ..effects import Effects
from ..grid import Grid

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Site:
    """Where and how structures are transformed.

    Attributes
    ----------
    grid, frame
        Grid of the image, and that of the whole image, to which effects refer.
    fft_shape
        Shape of the periodic grid.
    width
        Of the PSF, um along Z, Y, X (see :func:`napari_deltamic.fourier.make_plan`).
    aligned
        Whether the axes of the PSF are those of the grid.
    cutoff
        Where the OTF ends, for a PSF that is not Gaussian.
    transfer
        |OTF|, with blur and effects.
    stretch
        Factor by which edges of a mesh may grow before its plan no longer holds.
    device
        Where structures are transformed.
    plan
        Plan for the triangles of meshes; by default the cheapest for the accuracy.
    """

    grid: Grid
    frame: Grid
    fft_shape: tuple[int, int, int]
    width: tuple[float, float, float]
    accuracy: float
    method: Method | None
    aligned: bool
    cutoff: Cutoff | None = None
    transfer: Transfer | None = None
    stretch: float = 1.0
    device: torch.device = CPU
    plan: Plan | None = None

    def local(self, positions: Tensor) -> Tensor:
        """Return positions relative to the centre of the first voxel."""
        origin = torch.tensor(self.grid.origin, dtype=positions.dtype, device=positions.device)
        return positions - origin


class Planned(Protocol):
    """A structure planned for a site."""

    @property
    def plan(self) -> Plan | LinePlan:
        """The plan; transforms lie on the box of its band."""

    def transform(
        self, effects: Effects, vertices: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """Return u_hat with the effects on the object; two boxes if the PSF changes with depth.

        Differentiable. vertices : (V, 3) um, near those of the plan; None: those. density : for a
        surface (F,), instead of its own; for a solid (R,), segments (S,) or points (P,), factors
        on its own.
        """


class Structure(Protocol):
    """Something that shines."""

    def positions(self) -> FloatArray:
        """Return (N, 3) um: points whose bounds are those of the structure."""

    def planned(self, site: Site) -> Planned:
        """Plan the structure for a site; called by :class:`~..render.Renderer`."""


def mesh_plan(mesh: Mesh, site: Site, contrast: np.ndarray | None = None) -> Plan:
    """Return the plan for the triangles of a mesh, or, with contrasts, for their insides."""
    return site.plan or make_plan(
        mesh.vertices_numpy() - np.asarray(site.grid.origin),
        mesh.faces,
        site.fft_shape,
        site.grid.voxel_size,
        site.width,
        site.accuracy,
        site.method,
        margin=site.stretch,
        aligned=site.aligned,
        cutoff=site.cutoff,
        device=site.device.type,
        transfer=site.transfer,
        contrast=contrast,
    )
