"""Launches the kernels of ``csrc/particle_mesh_cuda.cu`` in the right order on the right arrays.

Like :mod:`.transform`, it does not depend on where they run.
"""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor

from ..points import Listed
from ..spreading import Elements
from .build import Kernels, PointBuild, pointer


class _Grid(ctypes.Structure):
    _fields_ = (
        ("shape", ctypes.c_int * 3),
        ("width", ctypes.c_int * 3),
        ("degree", ctypes.c_int * 3),
        ("first", ctypes.c_int * 3),
        ("scale", ctypes.c_double * 3),
    )


class _Rules(ctypes.Structure):
    _fields_ = (
        ("barycentric", ctypes.c_void_p),
        ("weights", ctypes.c_void_p),
        ("corners", ctypes.c_int),
    )


class _Arrays:
    """Arrays in the types that the kernels take, with points on a grid."""

    def __init__(
        self,
        kernels: Kernels[PointBuild],
        vertices: Tensor,
        elements: Elements,
        device: torch.device,
    ) -> None:
        spreading = elements.spreading
        self.kernels, self.device = kernels, device
        self.real = kernels.build.kind
        self.vertices = _double(vertices, device)
        self.elements = elements.corners.to(device, torch.int64).contiguous()
        self.listed: Listed = elements.points.listed(device)
        self.count, self.corners = elements.corners.shape
        coefficients = spreading.coefficients(self.real, device)
        sizes = [c.numel() for c in coefficients]
        first = (0, sizes[0], sizes[0] + sizes[1])
        self.coefficients = spreading.joined_coefficients(self.real, device)
        self.grid = _Grid(
            spreading.shape,
            tuple(c.shape[1] for c in coefficients),
            tuple(len(c) - 1 for c in coefficients),
            first,
            spreading.scale,
        )
        places = self.listed.barycentric, self.listed.weights
        self.rules = _Rules(*(p.data_ptr() for p in places), self.corners)

    def located(self, density: Tensor, vectors: Tensor | None = None) -> Tensor:
        """Return the points located on the grid, in a format that only kernels read."""
        size = self.kernels.build.point_bytes * self.listed.count
        out = torch.empty(size, dtype=torch.uint8, device=self.device)
        self._launch(
            "locate",
            self.listed.count,
            1,
            pointer(self.vertices),
            pointer(self.elements),
            pointer(density),
            ctypes.c_void_p(None) if vectors is None else pointer(vectors),
            pointer(self.listed.element),
            pointer(self.listed.place),
            self.rules,
            ctypes.c_int(self.listed.count),
            self.grid,
            pointer(out),
        )
        return out

    def on_grid(self, name: str, planes: int, located: Tensor, *arrays: Tensor) -> None:
        """Launch a kernel that takes points, the grid and some arrays."""
        self._launch(
            name,
            self.listed.count,
            planes,
            pointer(located),
            ctypes.c_int(self.listed.count),
            self.grid,
            pointer(self.coefficients),
            *map(pointer, arrays),
        )

    def summed(self, field: Tensor, slopes: bool) -> Tensor:
        """Return sums (E, corners, 1 or 4) of a field on the grid over the elements' points."""
        parts, what = (4, "slopes") if slopes else (1, "values")
        field = field.to(self.real).contiguous()
        ones = torch.ones(self.count, dtype=torch.float64, device=self.device)
        values = torch.empty(self.listed.count * parts, dtype=self.real, device=self.device)
        name = "gather_slopes" if slopes else "gather"
        self.on_grid(name, 1, self.located(ones), field, values)
        sums = torch.empty(self.count, self.corners, parts, dtype=torch.float64, device=self.device)
        self._launch(
            f"sum_{what}",
            self.count,
            self.corners,
            pointer(values),
            pointer(self.listed.start),
            pointer(self.listed.place),
            self.rules,
            ctypes.c_int(self.count),
            self.grid,
            pointer(sums),
        )
        return sums

    def pulled(self, density: Tensor, sums: Tensor) -> tuple[Tensor, Tensor]:
        """Return gradients in corners (E, corners, 3) and densities (E,)."""
        by_corner = torch.empty(
            self.count, self.corners, 3, dtype=torch.float64, device=self.device
        )
        by_density = torch.empty(self.count, dtype=torch.float64, device=self.device)
        self._launch(
            "pull",
            self.count,
            1,
            pointer(self.vertices),
            pointer(self.elements),
            pointer(density),
            ctypes.c_int(self.corners),
            ctypes.c_int(self.count),
            pointer(sums),
            pointer(by_corner),
            pointer(by_density),
        )
        return by_corner, by_density

    def _launch(self, name: str, count: int, across: int, *arguments: Any) -> None:
        if count:
            blocks = -(-count // self.kernels.build.threads)
            self.kernels.launch(name, (blocks, across), arguments)


def spread(
    kernels: Kernels[PointBuild],
    vertices: Tensor,
    elements: Elements,
    density: Tensor,
    device: torch.device,
    vectors: Tensor | None = None,
) -> Tensor:
    """Spread as :func:`napari_deltamic.fourier.particle_mesh.spread` does."""
    e = _Arrays(kernels, vertices, elements, device)
    along = None if vectors is None else _double(vectors, device)
    located = e.located(_double(density, device), along)
    grid = torch.zeros(elements.spreading.shape, dtype=e.real, device=device)
    name = "spread" if vectors is None else "spread_dipoles"
    e.on_grid(name, elements.spreading.kernels[0].width, located, grid)
    return grid


def gather(
    kernels: Kernels[PointBuild],
    vertices: Tensor,
    elements: Elements,
    field: Tensor,
    slopes: bool,
) -> Tensor:
    """Gather as :func:`napari_deltamic.fourier.particle_mesh.gather` does."""
    e = _Arrays(kernels, vertices, elements, field.device)
    return e.summed(field, slopes)


def pull(
    kernels: Kernels[PointBuild],
    vertices: Tensor,
    elements: Elements,
    density: Tensor,
    field: Tensor,
) -> tuple[Tensor, Tensor]:
    """Pull as :func:`napari_deltamic.fourier.particle_mesh.pull` does."""
    e = _Arrays(kernels, vertices, elements, field.device)
    by_corner, by_density = e.pulled(_double(density, field.device), e.summed(field, True))
    by_vertex = torch.zeros(len(vertices), 3, dtype=torch.float64, device=field.device)
    by_vertex.index_add_(0, e.elements.reshape(-1), by_corner.reshape(-1, 3))
    return by_vertex.to(vertices), by_density.to(density)


def _double(t: Tensor, device: torch.device) -> Tensor:
    return t.detach().to(device, torch.float64).resolve_neg().contiguous()
