"""Multimaterial .rec files, text or binary.

Text: the number of vertices, a line x y z each; the number of faces, a line i j k a b each, with
indices from 0 and normals from region a to region b. Binary, as foambryo writes it: u64 number of
vertices, 3 f64 each; u64 number of faces, 3 u64 and 2 i32 each, little-endian.
"""

from __future__ import annotations

import struct

import numpy as np

from ...common.words import counted
from ...errors import InputError
from ..mesh import FloatArray, IntArray
from .raw import RawMesh

_FACE = np.dtype([("corners", "<u8", 3), ("regions", "<i4", 2)])  # by definition of the format


def read_rec(data: bytes) -> RawMesh:
    binary = _read_binary(data)
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
    return RawMesh(xyz, table[:, :3], table[:, 3:], messages)


def _read_binary(data: bytes) -> RawMesh | None:
    """Read the binary variant; None unless both counts fit the file's size, as text never does."""
    if len(data) < 16:
        return None
    (n_vertices,) = struct.unpack_from("<Q", data)
    end = 8 + 24 * n_vertices
    if end + 8 > len(data):
        return None
    (n_faces,) = struct.unpack_from("<Q", data, end)
    if end + 8 + _FACE.itemsize * n_faces != len(data):
        return None
    xyz = np.frombuffer(data, "<f8", 3 * n_vertices, 8).reshape(-1, 3)
    table = np.frombuffer(data, _FACE, n_faces, end + 8)
    return RawMesh(xyz, table["corners"].astype(np.int64), table["regions"].astype(np.int64))


def write_rec(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    lines = [str(len(xyz))]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in xyz.tolist()]
    lines.append(str(len(faces)))
    rows = np.concatenate([faces, regions], axis=1).tolist()
    lines += [" ".join(map(str, row)) for row in rows]
    return ("\n".join(lines) + "\n").encode()
