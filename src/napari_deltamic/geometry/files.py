"""Mesh files: .obj .off .ply .stl .rec. They store x, y, z in um; memory holds Z, Y, X."""

from __future__ import annotations

import io
import os
import re
import struct
import uuid
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry.mesh import OUTSIDE, FloatArray, IntArray, Mesh
from napari_deltamic.geometry.repair import counted, repair

_REC_FACE = np.dtype([("corners", "<u8", 3), ("regions", "<i4", 2)])
_GROUP = re.compile(r"region_(\d+)_(\d+)")


class _Raw(NamedTuple):
    """What a file holds: positions in x, y, z, before any repair."""

    xyz: FloatArray
    faces: IntArray
    regions: IntArray | None = None
    messages: tuple[str, ...] = ()


def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read a mesh file and repair it.

    Parameters
    ----------
    path : path
        A .obj, .off, .ply, .stl or .rec file (text, or the binary variant), with positions
        x, y, z in um. Polygons are cut into triangles. Region pairs are read from .rec files, from
        the face properties region_a and region_b of a .ply file, and from groups region_A_B in a
        .obj file; without them the mesh is one region, (1, 0).

    Returns
    -------
    Mesh
        With vertices in Z, Y, X. Each change made by ``repair`` is one RepairWarning.

    Raises
    ------
    InputError
        Naming the file and the reason: missing, unknown extension, empty, damaged, no faces,
        indices out of range, positions that are not finite.
    """
    path = Path(path)
    read = _by_extension(path, _READERS)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if not data.strip():
        raise InputError(f"{path}: the file is empty")
    try:
        raw = read(data)
        if len(raw.faces) == 0:
            what = f"only points ({len(raw.xyz)}), no faces" if len(raw.xyz) else "no mesh"
            raise InputError(f"the file holds {what}")
        mesh, messages = repair(raw.xyz[:, ::-1], raw.faces, raw.regions)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # whatever a parser may raise on damaged data
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a readable {path.suffix} mesh ({reason})") from error
    for message in (*raw.messages, *messages):
        warnings.warn(f"{path.name}: {message}", RepairWarning, stacklevel=2)
    return mesh


def save_mesh(mesh: Mesh, path: str | os.PathLike[str]) -> None:
    """Write a mesh file, with positions x, y, z in um.

    Parameters
    ----------
    mesh : Mesh
    path : path
        Ends in .obj, .off, .ply, .stl or .rec (text). Region pairs are kept in .ply (as face
        properties region_a and region_b), .obj (as groups region_A_B) and .rec. STL and OFF
        cannot hold them, and STL keeps about 7 digits only; a mesh with regions other than (1, 0)
        gives a UserWarning there. The file appears whole or not at all.

    Raises
    ------
    InputError
        Naming the file and the reason: unknown extension, or the file cannot be written.
    """
    path = Path(path)
    write = _by_extension(path, _WRITERS)
    if path.suffix.lower() in (".stl", ".off"):
        pairs = mesh.interfaces()[0].tolist()
        if pairs != [[1, OUTSIDE]]:
            warnings.warn(
                f"{path.name}: {path.suffix} files cannot hold regions; use .ply, .obj or .rec "
                f"to keep the {counted(len(pairs), 'interface')}",
                UserWarning,
                stacklevel=2,
            )
    xyz = np.ascontiguousarray(mesh.vertices_numpy()[:, ::-1])
    write_atomically(path, write(xyz, mesh.faces, mesh.regions))


def write_atomically(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file under another name in the same folder, then rename it.

    A reader never sees half a file. Raises InputError if it cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        with temporary.open("xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _by_extension(path: Path, table: dict[str, Any]) -> Any:
    try:
        return table[path.suffix.lower()]
    except KeyError:
        raise InputError(
            f"{path}: unknown mesh extension '{path.suffix}'; known are {', '.join(table)}"
        ) from None


# ---- formats that trimesh reads ------------------------------------------------------------------


def _read_with_trimesh(data: bytes, kind: str) -> _Raw:
    import trimesh  # slow to import, and not needed for .rec and .obj

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its remarks are not for our user
        loaded = trimesh.load(io.BytesIO(data), file_type=kind, process=False)
    parts: list[Any]
    parts = list(loaded.geometry.values()) if hasattr(loaded, "geometry") else [loaded]
    xyz, faces, offset = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for part in parts:
        xyz.append(np.asarray(part.vertices, dtype=np.float64))
        faces.append(np.asarray(getattr(part, "faces", faces[0]), dtype=np.int64) + offset)
        offset += len(xyz[-1])
    regions = _ply_regions(parts[0], len(faces[-1])) if kind == "ply" and parts else None
    return _Raw(np.concatenate(xyz), np.concatenate(faces), regions)


def _ply_regions(part: Any, n_faces: int) -> IntArray | None:
    fields = part.metadata.get("_ply_raw", {}).get("face", {}).get("data", {})
    names = fields.dtype.names or () if isinstance(fields, np.ndarray) else fields
    if "region_a" not in names or "region_b" not in names:
        return None
    pairs = np.column_stack([np.asarray(fields[f"region_{side}"]).reshape(-1) for side in "ab"])
    if len(pairs) != n_faces:
        raise InputError("a .ply file with regions must hold triangles only")
    return pairs.astype(np.int64)


def _read_stl(data: bytes) -> _Raw:
    raw = _read_with_trimesh(data, "stl")
    # STL has no shared vertices: joining exact copies is reading, not repairing.
    xyz, index = np.unique(raw.xyz, axis=0, return_inverse=True)
    return _Raw(xyz, index.reshape(-1)[raw.faces])


# ---- .obj ----------------------------------------------------------------------------------------


def _read_obj(data: bytes) -> _Raw:
    """Positions, polygons, region groups. (trimesh drops groups and splits by material.)"""
    xyz: list[list[float]] = []
    corners: list[tuple[int, int, int]] = []
    pairs: list[tuple[int, int] | None] = []
    group: tuple[int, int] | None = None
    n_short = 0
    text = data.decode("utf-8", errors="replace").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), 1):
        kind, _, rest = line.partition("#")[0].strip().partition(" ")
        try:
            if kind == "v":
                x, y, z = (float(word) for word in rest.split()[:3])
                xyz.append([x, y, z])
            elif kind == "f":
                polygon = [_obj_index(word, len(xyz)) for word in rest.split()]
                n_short += len(polygon) < 3
                for k in range(2, len(polygon)):
                    corners.append((polygon[0], polygon[k - 1], polygon[k]))
                    pairs.append(group)
            elif kind in ("g", "o"):
                match = _GROUP.fullmatch(rest.strip())
                group = (int(match[1]), int(match[2])) if match else None
        except ValueError as error:
            raise InputError(f"line {number} is not readable: {line.strip()[:60]!r}") from error
    regions = None
    if any(pairs):
        if not all(pairs):
            raise InputError(f"{pairs.count(None)} faces are in no group region_A_B")
        regions = np.array(pairs, dtype=np.int64)
    short = f"ignored {counted(n_short, 'face')} with fewer than three corners"
    return _Raw(
        np.reshape(xyz, (-1, 3)).astype(np.float64),
        np.reshape(corners, (-1, 3)).astype(np.int64),
        regions,
        (short,) if n_short else (),
    )


def _obj_index(word: str, n_vertices: int) -> int:
    """Indices start at 1; negative ones count back from the last vertex so far."""
    index = int(word.partition("/")[0])
    if index == 0:
        raise ValueError("index 0")
    return index - 1 if index > 0 else n_vertices + index


def _write_obj(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in xyz.tolist()]
    for a, b in np.unique(regions, axis=0).tolist():
        lines.append(f"g region_{a}_{b}")
        rows = (regions == (a, b)).all(axis=1)
        lines += [f"f {i} {j} {k}" for i, j, k in (faces[rows] + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


# ---- .rec ----------------------------------------------------------------------------------------


def _read_rec(data: bytes) -> _Raw:
    binary = _read_rec_binary(data)
    if binary is not None:
        return binary
    words = data.decode("ascii").split()
    n_vertices = int(words[0])
    end = 1 + 3 * n_vertices
    if n_vertices < 0 or len(words) <= end:
        raise InputError(f"the file says {n_vertices} vertices, but ends before the faces")
    n_faces = int(words[end])
    stop = end + 1 + 5 * n_faces
    if n_faces < 0 or len(words) < stop:
        raise InputError(f"the file says {n_faces} faces, but ends before the last one")
    xyz = np.array(words[1:end], dtype=np.float64).reshape(-1, 3)
    table = np.array(words[end + 1 : stop], dtype=np.int64).reshape(-1, 5)
    rest = len(words) - stop
    messages = (f"ignored {counted(rest, 'value')} after the last face",) if rest else ()
    return _Raw(xyz, table[:, :3], table[:, 3:], messages)


def _read_rec_binary(data: bytes) -> _Raw | None:
    """None unless both counts fit the size of the file exactly, as text never does."""
    if len(data) < 16:
        return None
    (n_vertices,) = struct.unpack_from("<Q", data)
    end = 8 + 24 * n_vertices
    if end + 8 > len(data):
        return None
    (n_faces,) = struct.unpack_from("<Q", data, end)
    if end + 8 + _REC_FACE.itemsize * n_faces != len(data):
        return None
    xyz = np.frombuffer(data, "<f8", 3 * n_vertices, 8).reshape(-1, 3)
    table = np.frombuffer(data, _REC_FACE, n_faces, end + 8)
    return _Raw(xyz, table["corners"].astype(np.int64), table["regions"].astype(np.int64))


def _write_rec(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    lines = [str(len(xyz))]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in xyz.tolist()]
    lines.append(str(len(faces)))
    rows = np.concatenate([faces, regions], axis=1).tolist()
    lines += [" ".join(map(str, row)) for row in rows]
    return ("\n".join(lines) + "\n").encode()


# ---- writers -------------------------------------------------------------------------------------


def _write_ply(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    """Binary, in double precision (trimesh writes floats: 7 digits)."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment positions in um\n"
        f"element vertex {len(xyz)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
        "property int region_a\nproperty int region_b\nend_header\n"
    )
    table = np.empty(len(faces), [("n", "u1"), ("corners", "<i4", 3), ("regions", "<i4", 2)])
    table["n"], table["corners"], table["regions"] = 3, faces, regions
    return header.encode() + xyz.astype("<f8").tobytes() + table.tobytes()


def _write_off(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    faces = _outward(faces, regions)
    lines = ["OFF", f"{len(xyz)} {len(faces)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in xyz.tolist()]
    lines += [f"3 {i} {j} {k}" for i, j, k in faces.tolist()]
    return ("\n".join(lines) + "\n").encode()


def _write_stl(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    import trimesh

    solid: Any = trimesh.Trimesh(xyz, _outward(faces, regions), process=False)
    return bytes(solid.export(file_type="stl"))


def _outward(faces: IntArray, regions: IntArray) -> IntArray:
    """Faces wound from the larger region number to the smaller, thus to the outside."""
    return np.where((regions[:, 0] < regions[:, 1])[:, None], faces[:, ::-1], faces)


_READERS: dict[str, Callable[[bytes], _Raw]] = {
    ".obj": _read_obj,
    ".off": lambda data: _read_with_trimesh(data, "off"),
    ".ply": lambda data: _read_with_trimesh(data, "ply"),
    ".stl": _read_stl,
    ".rec": _read_rec,
}
_WRITERS: dict[str, Callable[[FloatArray, IntArray, IntArray], bytes]] = {
    ".obj": _write_obj,
    ".off": _write_off,
    ".ply": _write_ply,
    ".stl": _write_stl,
    ".rec": _write_rec,
}
