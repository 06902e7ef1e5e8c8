"""Arrays on the device that depend only on a band or on the faces of a mesh, and are kept."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...common.kept import Kept

_SEGMENT = np.dtype([("kz", "i4"), ("ky", "i4"), ("kx", "i4"), ("length", "i4"), ("offset", "i8")])
_KEPT = 8


@dataclass(frozen=True)
class Layout:
    """A band cut into segments, on the device."""

    table: Tensor
    segments: int
    wavevectors: int
    largest: tuple[int, int, int]
    source: Tensor  # keeps its memory from being given to another tensor


_layouts: Kept[Layout] = Kept(_KEPT)
_incidences: Kept[tuple[Tensor, Tensor, Tensor]] = Kept(_KEPT)


def layout_of(rows: Tensor, device: torch.device, width: int) -> Layout:
    """Return the segments of a band; the last few are kept, so that a fit need not remake them."""
    known = contents(rows)
    key = None if known is None else (known, device, stream_of(device), width)
    return _layouts.get(key, lambda: _cut(rows, device, width))


def _cut(rows: Tensor, device: torch.device, width: int) -> Layout:
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
    return Layout(plain, len(row), int(r[:, 2].sum()), largest, rows)


def corners_of_vertices(faces: Tensor, vertices: int) -> tuple[Tensor, Tensor]:
    """Return corners (3F,) sorted by vertex, and where those of each vertex begin (V + 1,)."""

    def make() -> tuple[Tensor, Tensor, Tensor]:
        ordered, order = torch.sort(faces.reshape(-1), stable=True)
        every = torch.arange(vertices + 1, device=faces.device)
        return order, torch.searchsorted(ordered, every), faces

    known = contents(faces)
    key = None if known is None else (known, stream_of(faces.device), vertices)
    return _incidences.get(key, make)[:2]


def contents(t: Tensor) -> Hashable | None:
    """Return a key for a tensor's contents, valid while the tensor is alive; None if impossible.

    It is impossible in ``torch.inference_mode``, whose tensors do not count their changes.
    """
    if t.is_inference():
        return None
    return t.data_ptr(), t._version, tuple(t.shape), t.stride(), t.dtype, t.device


def stream_of(device: torch.device) -> int:
    """Return the handle of torch's current stream; other streams may not see its results yet."""
    return int(torch.cuda.current_stream(device).cuda_stream) if device.type == "cuda" else 0
