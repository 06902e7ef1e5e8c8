"""Launches the kernels of ``csrc/mesh_ft_cuda.cu`` in the right order on the right arrays.

Independent of where they run: a :class:`Kernels` has a ``launch`` and arrays live on the device of
the vertices. On a GPU that is :mod:`.device`; the tests run the same code on the host.
"""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from .build import ClosedFormBuild, OutOfMemoryWarning, pointer
from .build import Kernels as KernelsOf
from .layout import Layout, corners_of_vertices, layout_of

Kernels = KernelsOf[ClosedFormBuild]

_SUMS = 10  # of a face: sums_per_face
_TRIANGLE_BYTES = 104
_WAVES = 4  # times all blocks that a device holds at once: evens out what blocks take
_PARTIAL_BYTES = 1 << 29  # of partial sums, at most


# ------------------------------------------------------------------------------------- bands


def band_forward(
    kernels: Kernels,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    rows: Tensor,
    spacing: Sequence[float],
) -> Tensor:
    """Compute ``deltamic::band_ft`` in the kernels' precision; returns (K,) complex."""
    layout = layout_of(rows, vertices.device, kernels.build.width)
    mesh = _Mesh(vertices, faces, density)
    if not mesh.count or not layout.wavevectors:
        return _new(kernels, mesh, layout.wavevectors).zero_()
    prepared = _prepare_band(kernels, mesh, layout, spacing, backward=False)
    across = _blocks(kernels, layout.segments)

    def run(parts: int, per_part: int, out: Tensor) -> None:
        kernels.launch(
            "band_forward",
            (across, parts),
            [
                pointer(prepared),
                ctypes.c_int(mesh.count),
                ctypes.c_int(per_part),
                pointer(layout.table),
                ctypes.c_int(layout.segments),
                ctypes.c_longlong(layout.wavevectors),
                pointer(out),
            ],
        )

    return _summed(kernels, mesh, layout.wavevectors, across, run)


def band_backward(
    kernels: Kernels,
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    rows: Tensor,
    spacing: Sequence[float],
) -> tuple[Tensor, Tensor]:
    """Compute ``deltamic::band_ft_backward``: gradients in vertices and densities."""
    layout = layout_of(rows, vertices.device, kernels.build.width)
    mesh = _Mesh(vertices, faces, density)
    if not mesh.count or not layout.wavevectors:
        return torch.zeros_like(vertices), torch.zeros_like(density)
    prepared = _prepare_band(kernels, mesh, layout, spacing, backward=True)
    incoming = _incoming(kernels, grad)
    across = _blocks(kernels, mesh.count)
    parts, per_part, sums = _parts(
        kernels, layout.segments, across, _SUMS * mesh.count, kernels.build.kind, vertices.device
    )
    kernels.launch(
        "band_backward",
        (across, parts),
        [
            pointer(prepared),
            ctypes.c_int(mesh.count),
            pointer(layout.table),
            ctypes.c_int(layout.segments),
            ctypes.c_int(per_part),
            pointer(incoming),
            pointer(sums),
        ],
    )
    arguments = [pointer(sums), ctypes.c_int(parts), *(ctypes.c_double(s) for s in spacing)]
    return _gradients(kernels, "face_gradient", mesh, arguments, vertices, density)


# -------------------------------------------------------------------------- any wavevectors


def list_forward(
    kernels: Kernels, vertices: Tensor, faces: Tensor, density: Tensor, wavevectors: Tensor
) -> Tensor:
    """Compute ``deltamic::mesh_ft`` in the kernels' precision; returns (K,) complex."""
    mesh = _Mesh(vertices, faces, density)
    xi = wavevectors.to(torch.float64).contiguous()
    if not mesh.count or not len(xi):
        return _new(kernels, mesh, len(xi)).zero_()
    prepared = _prepare_list(kernels, mesh, backward=False)
    across = _blocks(kernels, len(xi))

    def run(parts: int, per_part: int, out: Tensor) -> None:
        kernels.launch(
            "list_forward",
            (across, parts),
            [
                pointer(prepared),
                ctypes.c_int(mesh.count),
                ctypes.c_int(per_part),
                pointer(xi),
                ctypes.c_longlong(len(xi)),
                pointer(out),
            ],
        )

    return _summed(kernels, mesh, len(xi), across, run)


def list_backward(
    kernels: Kernels,
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    wavevectors: Tensor,
) -> tuple[Tensor, Tensor]:
    """Compute ``deltamic::mesh_ft_backward``: gradients in vertices and densities."""
    mesh = _Mesh(vertices, faces, density)
    xi = wavevectors.to(torch.float64).contiguous()
    if not mesh.count or not len(xi):
        return torch.zeros_like(vertices), torch.zeros_like(density)
    prepared = _prepare_list(kernels, mesh, backward=True)
    incoming = _incoming(kernels, grad)
    across = _blocks(kernels, mesh.count)
    parts, per_part, sums = _parts(
        kernels, len(xi), across, _SUMS * mesh.count, torch.float64, vertices.device
    )
    kernels.launch(
        "list_backward",
        (across, parts),
        [
            pointer(prepared),
            ctypes.c_int(mesh.count),
            pointer(xi),
            ctypes.c_longlong(len(xi)),
            ctypes.c_int(per_part),
            pointer(incoming),
            pointer(sums),
        ],
    )
    arguments = [pointer(sums), ctypes.c_int(parts)]
    return _gradients(kernels, "list_face_gradient", mesh, arguments, vertices, density)


# ------------------------------------------------------------------------------------ triangles


class _Mesh:
    """Contiguous arrays in the types that the kernels take."""

    def __init__(self, vertices: Tensor, faces: Tensor, density: Tensor) -> None:
        self.vertices = vertices.detach().to(torch.float64).resolve_neg().contiguous()
        self.faces = faces.to(torch.int64).contiguous()
        self.density = density.detach().to(torch.float64).resolve_neg().contiguous()
        self.count = len(faces)

    @property
    def pointers(self) -> list[Any]:
        return [
            pointer(self.vertices),
            pointer(self.faces),
            pointer(self.density),
            ctypes.c_int(self.count),
        ]


def _prepare_band(
    kernels: Kernels, mesh: _Mesh, layout: Layout, spacing: Sequence[float], backward: bool
) -> Tensor:
    size = mesh.count * kernels.build.face_bytes
    out = torch.empty(size, dtype=torch.uint8, device=mesh.vertices.device)
    arguments = [
        *mesh.pointers,
        *(ctypes.c_double(s) for s in spacing),
        *(ctypes.c_int(k) for k in layout.largest),
        ctypes.c_int(backward),
        pointer(out),
    ]
    kernels.launch("prepare_band", (_blocks(kernels, mesh.count), 1), arguments)
    return out


def _prepare_list(kernels: Kernels, mesh: _Mesh, backward: bool) -> Tensor:
    size = mesh.count * _TRIANGLE_BYTES
    out = torch.empty(size, dtype=torch.uint8, device=mesh.vertices.device)
    arguments = [*mesh.pointers, ctypes.c_int(backward), pointer(out)]
    kernels.launch("prepare_list", (_blocks(kernels, mesh.count), 1), arguments)
    return out


# ------------------------------------------------------------------------------- sums of parts


def _parts(
    kernels: Kernels, work: int, across: int, size: int, dtype: torch.dtype, device: torch.device
) -> tuple[int, int, Tensor]:
    """Return how many parts a thread's work is cut into, their length, and room for their sums.

    A grid of ``across`` blocks alone would leave most of a large GPU idle. Parts are multiples of a
    tile; their number depends on the problem and the device alone, and so do the bits of a result.
    """
    build = kernels.build
    wanted = -(-_WAVES * kernels.multiprocessors * build.resident // across)
    fitting = max(1, _PARTIAL_BYTES // (size * torch.empty(0, dtype=dtype).element_size()))
    parts = max(1, min(wanted, fitting, -(-work // build.tile)))
    while True:
        per_part = -(-work // (parts * build.tile)) * build.tile
        parts = -(-work // per_part)
        try:
            return parts, per_part, torch.empty(parts * size, dtype=dtype, device=device)
        except torch.OutOfMemoryError:
            if parts == 1:
                raise
            parts = -(-parts // 2)
            text = "the memory of the GPU is short: the transform runs in fewer, larger pieces"
            warnings.warn(text, OutOfMemoryWarning, stacklevel=2)


def _summed(
    kernels: Kernels,
    mesh: _Mesh,
    wavevectors: int,
    across: int,
    run: Callable[[int, int, Tensor], None],
) -> Tensor:
    """Run the parts of the faces and add up their results; (K,) complex."""
    device = mesh.vertices.device
    parts, per_part, sums = _parts(
        kernels, mesh.count, across, wavevectors, _complex(kernels), device
    )
    run(parts, per_part, sums)
    if parts == 1:
        return sums
    total, reals = _new(kernels, mesh, wavevectors), 2 * wavevectors
    arguments = [pointer(sums), ctypes.c_int(parts), ctypes.c_longlong(reals), pointer(total)]
    kernels.launch("add_parts", (_blocks(kernels, reals), 1), arguments)
    return total


def _gradients(
    kernels: Kernels,
    name: str,
    mesh: _Mesh,
    sums: list[Any],
    vertices: Tensor,
    density: Tensor,
) -> tuple[Tensor, Tensor]:
    """Turn sums per face into gradients in vertices (V, 3) and densities (F,)."""
    device, number = vertices.device, len(vertices)
    corners = torch.empty(9 * mesh.count, dtype=torch.float64, device=device)
    by_density = torch.empty(mesh.count, dtype=torch.float64, device=device)
    blocks = _blocks(kernels, mesh.count)
    arguments = [*mesh.pointers, *sums, pointer(corners), pointer(by_density)]
    kernels.launch(name, (blocks, 1), arguments)
    order, start = corners_of_vertices(mesh.faces, number)
    by_vertex = torch.empty(number, 3, dtype=torch.float64, device=device)
    arguments = [
        pointer(corners),
        pointer(order),
        pointer(start),
        ctypes.c_int(number),
        pointer(by_vertex),
    ]
    kernels.launch("vertex_gradient", (_blocks(kernels, number), 1), arguments)
    return by_vertex.to(vertices.dtype), by_density.to(density.dtype)


# ------------------------------------------------------------------------------------- helpers


def _complex(kernels: Kernels) -> torch.dtype:
    return torch.complex64 if kernels.build.real == "float" else torch.complex128


def _new(kernels: Kernels, mesh: _Mesh, size: int) -> Tensor:
    return torch.empty(size, dtype=_complex(kernels), device=mesh.vertices.device)


def _incoming(kernels: Kernels, grad: Tensor) -> Tensor:
    held = grad.detach().to(_complex(kernels)).resolve_conj().resolve_neg().contiguous()
    return torch.view_as_real(held)


def _blocks(kernels: Kernels, count: int) -> int:
    return -(-count // kernels.build.threads)
