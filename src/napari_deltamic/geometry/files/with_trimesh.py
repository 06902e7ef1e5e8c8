"""Reading by trimesh, which several formats share."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from .raw import RawMesh


def read_with_trimesh(data: bytes, kind: str) -> tuple[RawMesh, Any]:
    """Return the mesh of a file, all its parts merged, and its first part as trimesh's object."""
    import trimesh  # slow to import, and not needed for every format

    loaded = trimesh.load(io.BytesIO(data), file_type=kind, process=False)
    parts: list[Any]
    parts = list(loaded.geometry.values()) if hasattr(loaded, "geometry") else [loaded]
    xyz, faces, offset = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for part in parts:
        xyz.append(np.asarray(part.vertices, dtype=np.float64))
        faces.append(np.asarray(getattr(part, "faces", faces[0]), dtype=np.int64) + offset)
        offset += len(xyz[-1])
    return RawMesh(np.concatenate(xyz), np.concatenate(faces)), parts[0] if parts else None
