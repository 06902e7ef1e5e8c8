"""What readers of mesh files hand on: a mesh before any repair."""

from __future__ import annotations

from typing import NamedTuple

from ..mesh import FloatArray, IntArray


class RawMesh(NamedTuple):
    """What a file holds: positions in x, y, z, before any repair.

    xyz : (V, 3); faces : (F, 3) from 0; regions : (F, 2), or None where the format has none.
    messages : what the reader had to leave out, in plain words.
    """

    xyz: FloatArray
    faces: IntArray
    regions: IntArray | None = None
    messages: tuple[str, ...] = ()
