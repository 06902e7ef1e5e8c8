"""The unrepaired mesh that readers of mesh files return."""

from __future__ import annotations

from typing import NamedTuple

from ..mesh import FloatArray, IntArray


class RawMesh(NamedTuple):
    """The content of a mesh file, before any repair.

    xyz : (V, 3) positions; faces : (F, 3) indices from 0; regions : (F, 2), or None without any.
    messages : what the reader had to leave out, in plain words.
    """

    xyz: FloatArray
    faces: IntArray
    regions: IntArray | None = None
    messages: tuple[str, ...] = ()
