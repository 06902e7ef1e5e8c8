"""What the kernels of ``csrc/mesh_ft_cuda.cu`` are launched on, and in which order.

Independent of where they run: a :class:`Kernels` has a ``launch`` and arrays live on the device of
the vertices. On a GPU that is :mod:`.device`; the tests run the same code on the host.
"""

from __future__ import annotations

import ctypes
import warnings
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

_SEGMENT = np.dtype([("kz", "i4"), ("ky", "i4"), ("kx", "i4"), ("length", "i4"), ("offset", "i8")])
_SUMS = 10  # of a face: sums_per_face
_TRIANGLE_BYTES = 104
_WAVES = 4  # times all blocks that a device holds at once: evens out what blocks take
_PARTIAL_BYTES = 1 << 29  # of partial sums, at most
_KEPT = 8  # layouts


class OutOfMemoryWarning(UserWarning):
    """The device has less memory than was asked for; the work is cut into smaller pieces."""


@dataclass(frozen=True)
class Build:
    """Numbers that the source is compiled with.

    real : type of the inner loops. width : wavevectors in a segment. threads : in a block.
    tile : faces or segments in shared memory. resident : blocks that a multiprocessor holds.
    """

    real: str
    width: int
    threads: int = 128
    tile: int = 64
    resident: int = 5

    @property
    def face_bytes(self) -> int:
        """Size of what is kept of a face of a band."""
        return 96 if self.real == "float" else 176

    @property
    def defines(self) -> list[str]:
        """Options of the compiler."""
        return [
            f"-DDELTAMIC_REAL={self.real}",
            f"-DDELTAMIC_WIDTH={self.width}",
            f"-DDELTAMIC_THREADS={self.threads}",
            f"-DDELTAMIC_TILE={self.tile}",
            f"-DDELTAMIC_RESIDENT={self.resident}",
        ]


SINGLE, DOUBLE = Build("float", 8), Build("double", 4, resident=2)


class Kernels(Protocol):
    """Compiled kernels of one type on one device."""

    build: Build
    multiprocessors: int

    def launch(self, name: str, grid: tuple[int, int], arguments: Sequence[Any]) -> None:
        """Start a kernel on the current stream; the arguments are ctypes values."""


# ------------------------------------------------------------------------------------- bands


def band_forward(
    kernels: Kernels,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    rows: Tensor,
    spacing: Sequence[float],
) -> Tensor:
    """As ``deltamic::band_ft``."""
    layout = _layout(rows, vertices.device, kernels.build.width)
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
                _pointer(prepared),
                ctypes.c_int(mesh.count),
                ctypes.c_int(per_part),
                _pointer(layout.table),
                ctypes.c_int(layout.segments),
                ctypes.c_longlong(layout.wavevectors),
                _pointer(out),
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
    """As ``deltamic::band_ft_backward``."""
    layout = _layout(rows, vertices.device, kernels.build.width)
    mesh = _Mesh(vertices, faces, density)
    if not mesh.count or not layout.wavevectors:
        return torch.zeros_like(vertices), torch.zeros_like(density)
    prepared = _prepare_band(kernels, mesh, layout, spacing, backward=True)
    incoming = _incoming(kernels, grad)
    across = _blocks(kernels, mesh.count)
    parts, per_part, sums = _parts(
        kernels, layout.segments, across, _SUMS * mesh.count, _real(kernels), vertices.device
    )
    kernels.launch(
        "band_backward",
        (across, parts),
        [
            _pointer(prepared),
            ctypes.c_int(mesh.count),
            _pointer(layout.table),
            ctypes.c_int(layout.segments),
            ctypes.c_int(per_part),
            _pointer(incoming),
            _pointer(sums),
        ],
    )
    arguments = [_pointer(sums), ctypes.c_int(parts), *(ctypes.c_double(s) for s in spacing)]
    return _gradients(kernels, "face_gradient", mesh, arguments, vertices, density)


# -------------------------------------------------------------------------- any wavevectors


def list_forward(
    kernels: Kernels, vertices: Tensor, faces: Tensor, density: Tensor, wavevectors: Tensor
) -> Tensor:
    """As ``deltamic::mesh_ft``."""
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
                _pointer(prepared),
                ctypes.c_int(mesh.count),
                ctypes.c_int(per_part),
                _pointer(xi),
                ctypes.c_longlong(len(xi)),
                _pointer(out),
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
    """As ``deltamic::mesh_ft_backward``."""
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
            _pointer(prepared),
            ctypes.c_int(mesh.count),
            _pointer(xi),
            ctypes.c_longlong(len(xi)),
            ctypes.c_int(per_part),
            _pointer(incoming),
            _pointer(sums),
        ],
    )
    arguments = [_pointer(sums), ctypes.c_int(parts)]
    return _gradients(kernels, "list_face_gradient", mesh, arguments, vertices, density)


# ------------------------------------------------------------------------ triangles and layouts


class _Mesh:
    """Contiguous arrays in the types that the kernels take."""

    def __init__(self, vertices: Tensor, faces: Tensor, density: Tensor) -> None:
        self.vertices = vertices.detach().to(torch.float64).contiguous()
        self.faces = faces.to(torch.int64).contiguous()
        self.density = density.detach().to(torch.float64).contiguous()
        self.count = len(faces)

    @property
    def pointers(self) -> list[Any]:
        return [
            _pointer(self.vertices),
            _pointer(self.faces),
            _pointer(self.density),
            ctypes.c_int(self.count),
        ]


@dataclass(frozen=True)
class _Layout:
    """A band cut into segments, on the device."""

    table: Tensor
    segments: int
    wavevectors: int
    largest: tuple[int, int, int]
    source: Tensor  # keeps its memory from being given to another tensor


_layouts: OrderedDict[Any, _Layout] = OrderedDict()


def _layout(rows: Tensor, device: torch.device, width: int) -> _Layout:
    """The segments of a band; the last few are kept, so that a fit does not make them anew."""
    key = (rows.data_ptr(), rows._version, len(rows), device, width)
    if key not in _layouts:
        _layouts[key] = _cut(rows, device, width)
        if len(_layouts) > _KEPT:
            _layouts.popitem(last=False)
    _layouts.move_to_end(key)
    return _layouts[key]


def _cut(rows: Tensor, device: torch.device, width: int) -> _Layout:
    r = rows.detach().cpu().numpy().astype(np.int64)
    pieces = -(-r[:, 2] // width)
    row = np.repeat(np.arange(len(r)), pieces)
    place = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    start = np.cumsum(r[:, 2]) - r[:, 2]
    table = np.zeros(len(row), _SEGMENT)
    table["kz"], table["ky"], table["kx"] = r[row, 0], r[row, 1], place * width
    table["length"] = np.minimum(r[row, 2] - place * width, width)
    table["offset"] = start[row] + place * width
    plain = torch.from_numpy(table.view(np.uint8).copy()).to(device)
    largest = (0, 0, 0)
    if len(r):
        largest = (int(abs(r[:, 0]).max()), int(abs(r[:, 1]).max()), max(int(r[:, 2].max()) - 1, 0))
    return _Layout(plain, len(row), int(r[:, 2].sum()), largest, rows)


def _prepare_band(
    kernels: Kernels, mesh: _Mesh, layout: _Layout, spacing: Sequence[float], backward: bool
) -> Tensor:
    size = mesh.count * kernels.build.face_bytes
    out = torch.empty(size, dtype=torch.uint8, device=mesh.vertices.device)
    arguments = [
        *mesh.pointers,
        *(ctypes.c_double(s) for s in spacing),
        *(ctypes.c_int(k) for k in layout.largest),
        ctypes.c_int(backward),
        _pointer(out),
    ]
    kernels.launch("prepare_band", (_blocks(kernels, mesh.count), 1), arguments)
    return out


def _prepare_list(kernels: Kernels, mesh: _Mesh, backward: bool) -> Tensor:
    size = mesh.count * _TRIANGLE_BYTES
    out = torch.empty(size, dtype=torch.uint8, device=mesh.vertices.device)
    arguments = [*mesh.pointers, ctypes.c_int(backward), _pointer(out)]
    kernels.launch("prepare_list", (_blocks(kernels, mesh.count), 1), arguments)
    return out


# ------------------------------------------------------------------------------- sums of parts


def _parts(
    kernels: Kernels, work: int, across: int, size: int, dtype: torch.dtype, device: torch.device
) -> tuple[int, int, Tensor]:
    """Into how many parts the work of a thread is cut, how long each is, and room for their sums.

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
            tell_out_of_memory("the transform runs in fewer, larger pieces")


def _summed(
    kernels: Kernels,
    mesh: _Mesh,
    wavevectors: int,
    across: int,
    run: Callable[[int, int, Tensor], None],
) -> Tensor:
    """Parts of the faces, run and added up; (K,) complex."""
    size, device = 2 * wavevectors, mesh.vertices.device
    parts, per_part, sums = _parts(kernels, mesh.count, across, size, _real(kernels), device)
    run(parts, per_part, sums)
    if parts > 1:
        total = torch.empty(size, dtype=sums.dtype, device=device)
        arguments = [_pointer(sums), ctypes.c_int(parts), ctypes.c_longlong(size), _pointer(total)]
        kernels.launch("add_parts", (_blocks(kernels, size), 1), arguments)
        sums = total
    return torch.view_as_complex(sums.reshape(-1, 2))


def _gradients(
    kernels: Kernels,
    name: str,
    mesh: _Mesh,
    sums: list[Any],
    vertices: Tensor,
    density: Tensor,
) -> tuple[Tensor, Tensor]:
    """From sums per face to gradients of vertices and densities."""
    device, number = vertices.device, len(vertices)
    corners = torch.empty(9 * mesh.count, dtype=torch.float64, device=device)
    by_density = torch.empty(mesh.count, dtype=torch.float64, device=device)
    blocks = _blocks(kernels, mesh.count)
    arguments = [*mesh.pointers, *sums, _pointer(corners), _pointer(by_density)]
    kernels.launch(name, (blocks, 1), arguments)
    order, start = _corners_of_vertices(mesh.faces, number)
    by_vertex = torch.empty(number, 3, dtype=torch.float64, device=device)
    arguments = [
        _pointer(corners),
        _pointer(order),
        _pointer(start),
        ctypes.c_int(number),
        _pointer(by_vertex),
    ]
    kernels.launch("vertex_gradient", (_blocks(kernels, number), 1), arguments)
    return by_vertex.to(vertices.dtype), by_density.to(density.dtype)


_incidences: OrderedDict[Any, tuple[Tensor, Tensor, Tensor]] = OrderedDict()


def _corners_of_vertices(faces: Tensor, vertices: int) -> tuple[Tensor, Tensor]:
    """Corners (3F,) in the order of their vertices, and where each vertex begins (V + 1,)."""
    key = (faces.data_ptr(), faces._version, len(faces), faces.device, vertices)
    if key not in _incidences:
        ordered, order = torch.sort(faces.reshape(-1), stable=True)
        every = torch.arange(vertices + 1, device=faces.device)
        _incidences[key] = order, torch.searchsorted(ordered, every), faces
        if len(_incidences) > _KEPT:
            _incidences.popitem(last=False)
    _incidences.move_to_end(key)
    return _incidences[key][:2]


# ------------------------------------------------------------------------------------- helpers


def tell_out_of_memory(what: str) -> None:
    """Warn that the device's memory is short and what is done about it."""
    warnings.warn(f"the memory of the GPU is short: {what}", OutOfMemoryWarning, stacklevel=2)


def _pointer(t: Tensor) -> ctypes.c_void_p:
    return ctypes.c_void_p(t.data_ptr())


def _real(kernels: Kernels) -> torch.dtype:
    return torch.float32 if kernels.build.real == "float" else torch.float64


def _new(kernels: Kernels, mesh: _Mesh, size: int) -> Tensor:
    kind = torch.complex64 if kernels.build.real == "float" else torch.complex128
    return torch.empty(size, dtype=kind, device=mesh.vertices.device)


def _incoming(kernels: Kernels, grad: Tensor) -> Tensor:
    kind = torch.complex64 if kernels.build.real == "float" else torch.complex128
    return torch.view_as_real(grad.detach().to(kind).resolve_conj().contiguous())


def _blocks(kernels: Kernels, count: int) -> int:
    return -(-count // kernels.build.threads)
