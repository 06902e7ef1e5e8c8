"""Binary .ply files; regions are the face properties region_a and region_b."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import InputError
from ..mesh import FloatArray, IntArray
from .raw import RawMesh
from .with_trimesh import read_with_trimesh

_LARGEST = np.iinfo(np.int32).max  # largest region number that integers of a file hold


def read_ply(data: bytes) -> RawMesh:
    """Read positions, polygons (cut into triangles) and, where the file has them, regions."""
    raw, part = read_with_trimesh(data, "ply")
    return raw if part is None else raw._replace(regions=_regions(part, len(raw.faces)))


def _regions(part: Any, n_faces: int) -> IntArray | None:
    fields = part.metadata.get("_ply_raw", {}).get("face", {}).get("data", {})
    names = fields.dtype.names or () if isinstance(fields, np.ndarray) else fields
    if "region_a" not in names or "region_b" not in names:
        return None
    pairs = np.column_stack([np.asarray(fields[f"region_{side}"]).reshape(-1) for side in "ab"])
    if len(pairs) != n_faces:
        raise InputError("a .ply file with regions must hold triangles only")
    return pairs.astype(np.int64)


def write_ply(
    xyz: FloatArray,
    faces: IntArray,
    regions: IntArray,
    attributes: Mapping[str, FloatArray] | None = None,
) -> bytes:
    """Write a binary file in double precision (trimesh writes floats: 7 digits).

    Attributes, (F,) each, become further properties of the faces.
    """
    # The format has no integers of 64 bits, so larger numbers are written as doubles.
    name, kind = ("double", "<f8") if regions.max() > _LARGEST else ("int", "<i4")
    more = attributes or {}
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment positions in um\n"
        f"element vertex {len(xyz)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
        f"property {name} region_a\nproperty {name} region_b\n"
        + "".join(f"property double {attribute}\n" for attribute in more)
        + "end_header\n"
    )
    columns = [(attribute, "<f8") for attribute in more]
    layout = [("n", "u1"), ("corners", "<i4", 3), ("regions", kind, 2), *columns]
    table = np.empty(len(faces), layout)
    table["n"], table["corners"], table["regions"] = 3, faces, regions
    for attribute, values in more.items():
        table[attribute] = values
    return header.encode() + xyz.astype("<f8").tobytes() + table.tobytes()
