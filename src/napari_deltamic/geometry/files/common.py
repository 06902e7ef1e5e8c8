"""Mesh files of one surface: .ply (with regions as face properties), .stl, .off."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.files.raw import RawMesh
from napari_deltamic.geometry.mesh import FloatArray, IntArray

_LARGEST = np.iinfo(np.int32).max  # region that integers of files hold


def read_with_trimesh(data: bytes, kind: str) -> RawMesh:
    import trimesh  # slow to import, and not needed for .rec and .obj

    loaded = trimesh.load(io.BytesIO(data), file_type=kind, process=False)
    parts: list[Any]
    parts = list(loaded.geometry.values()) if hasattr(loaded, "geometry") else [loaded]
    xyz, faces, offset = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for part in parts:
        xyz.append(np.asarray(part.vertices, dtype=np.float64))
        faces.append(np.asarray(getattr(part, "faces", faces[0]), dtype=np.int64) + offset)
        offset += len(xyz[-1])
    regions = _ply_regions(parts[0], len(faces[-1])) if kind == "ply" and parts else None
    return RawMesh(np.concatenate(xyz), np.concatenate(faces), regions)


def _ply_regions(part: Any, n_faces: int) -> IntArray | None:
    fields = part.metadata.get("_ply_raw", {}).get("face", {}).get("data", {})
    names = fields.dtype.names or () if isinstance(fields, np.ndarray) else fields
    if "region_a" not in names or "region_b" not in names:
        return None
    pairs = np.column_stack([np.asarray(fields[f"region_{side}"]).reshape(-1) for side in "ab"])
    if len(pairs) != n_faces:
        raise InputError("a .ply file with regions must hold triangles only")
    return pairs.astype(np.int64)


def read_stl(data: bytes) -> RawMesh:
    raw = read_with_trimesh(data, "stl")
    # STL has no shared vertices: joining exact copies is reading, not repairing.
    xyz, index = np.unique(raw.xyz, axis=0, return_inverse=True)
    return RawMesh(xyz, index.reshape(-1)[raw.faces])


def write_ply(
    xyz: FloatArray,
    faces: IntArray,
    regions: IntArray,
    attributes: Mapping[str, FloatArray] | None = None,
) -> bytes:
    """Binary, in double precision (trimesh writes floats: 7 digits).

    Attributes (F,) are further properties of the faces.
    """
    # The format has no larger integers.
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


def write_off(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    faces = _outward(faces, regions)
    lines = ["OFF", f"{len(xyz)} {len(faces)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in xyz.tolist()]
    lines += [f"3 {i} {j} {k}" for i, j, k in faces.tolist()]
    return ("\n".join(lines) + "\n").encode()


def write_stl(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    import trimesh

    solid: Any = trimesh.Trimesh(xyz, _outward(faces, regions), process=False)
    return bytes(solid.export(file_type="stl"))


def _outward(faces: IntArray, regions: IntArray) -> IntArray:
    """Faces wound from the larger region number to the smaller, thus to the outside."""
    return np.where((regions[:, 0] < regions[:, 1])[:, None], faces[:, ::-1], faces)
