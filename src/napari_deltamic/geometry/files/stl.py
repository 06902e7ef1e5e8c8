"""Binary .stl files; one surface, without regions."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..mesh import FloatArray, IntArray
from ..trimesh_exchange import outward
from .raw import RawMesh
from .with_trimesh import read_with_trimesh


def read_stl(data: bytes) -> RawMesh:
    """Read triangles; equal corners become one vertex."""
    raw = read_with_trimesh(data, "stl")[0]
    # STL has no shared vertices: joining exact copies is reading, not repairing.
    xyz, index = np.unique(raw.xyz, axis=0, return_inverse=True)
    return RawMesh(xyz, index.reshape(-1)[raw.faces])


def write_stl(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    """Write a binary file with about 7 digits, the precision of the format."""
    import trimesh

    solid: Any = trimesh.Trimesh(xyz, outward(faces, regions), process=False)
    return bytes(solid.export(file_type="stl"))
