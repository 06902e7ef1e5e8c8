"""Wavefront .obj files; regions are groups named region_A_B."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from ...common.words import counted
from ...errors import InputError
from ..mesh import FloatArray, IntArray
from .raw import RawMesh

_GROUP = re.compile(r"region_(\d+)_(\d+)")


def read_obj(data: bytes) -> RawMesh:
    """Read positions, polygons and region groups (trimesh drops groups and splits by material)."""
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
    return RawMesh(
        np.reshape(xyz, (-1, 3)).astype(np.float64),
        np.reshape(corners, (-1, 3)).astype(np.int64),
        regions,
        (short,) if n_short else (),
    )


def _obj_index(word: str, n_vertices: int) -> int:
    """Convert a file's index: from 1, or negative, counted back from the last vertex so far."""
    index = int(word.partition("/")[0])
    if index == 0:
        raise ValueError("index 0")
    return index - 1 if index > 0 else n_vertices + index


def write_obj(xyz: FloatArray, faces: IntArray, regions: IntArray) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in xyz.tolist()]
    changes = np.flatnonzero((regions[1:] != regions[:-1]).any(axis=1)) + 1
    for first, stop in pairwise([0, *changes.tolist(), len(faces)]):  # keeps the order of faces
        lines.append("g region_{}_{}".format(*regions[first]))
        lines += [f"f {i} {j} {k}" for i, j, k in (faces[first:stop] + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()
