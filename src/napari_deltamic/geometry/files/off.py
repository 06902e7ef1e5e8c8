"""Text files .off; one surface, without regions."""

from __future__ import annotations

from ..mesh import FloatArray, IntArray
from ..trimesh_exchange import outward
from .raw import RawMesh
from .with_trimesh import read_with_trimesh


def read_off(data: bytes) -> RawMesh:
    """Read positions and polygons, which are cut into triangles."""
    return read_with_trimesh(data, "off")[0]


def write_off(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    """Write a text file with every digit of the positions."""
    faces = outward(faces, regions)
    lines = ["OFF", f"{len(xyz)} {len(faces)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in xyz.tolist()]
    lines += [f"3 {i} {j} {k}" for i, j, k in faces.tolist()]
    return ("\n".join(lines) + "\n").encode()
