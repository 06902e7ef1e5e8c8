"""Legacy .vtk files; regions are the cell data region_a and region_b.

The format is that of "VTK File Formats", The VTK User's Guide: a header of four lines, then blocks
named by keywords, as text or big-endian binary. Read: the polygons of POLYDATA and
UNSTRUCTURED_GRID, up to version 5.1. Written: version 3.0, POLYDATA, binary, doubles.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.words import counted
from ...errors import InputError
from ..mesh import FloatArray, IntArray
from .raw import RawMesh

_TYPES = {
    "unsigned_char": "u1",
    "char": "i1",
    "unsigned_short": "u2",
    "short": "i2",
    "unsigned_int": "u4",
    "int": "i4",
    "unsigned_long": "u8",
    "long": "i8",
    "float": "f4",
    "double": "f8",
    "vtkidtype": "i8",
    "vtktypeint64": "i8",
    "vtktypeint32": "i4",
    "vtktypeuint8": "u1",
}
# By definition of the format: the cell types triangle, polygon, quad; numbers of each item.
_POLYGONS = (5, 7, 9)
_PER_TUPLE = {"NORMALS": 3, "VECTORS": 3, "TENSORS": 9}


def read_vtk(data: bytes) -> RawMesh:
    """Read positions, polygons (cut into triangles) and, where the file has them, regions."""
    return _Reader(data).mesh()


def write_vtk(
    xyz: FloatArray,
    faces: IntArray,
    regions: IntArray,
    attributes: Mapping[str, FloatArray] | None = None,
) -> bytes:
    """Write binary POLYDATA in double precision; attributes, (F,) each, become cell data."""
    cells = np.column_stack([np.full(len(faces), 3), faces])
    blocks = [
        b"# vtk DataFile Version 3.0\nmesh in um, x y z\nBINARY\nDATASET POLYDATA\n",
        f"POINTS {len(xyz)} double\n".encode() + xyz.astype(">f8").tobytes(),
        f"\nPOLYGONS {len(faces)} {cells.size}\n".encode() + cells.astype(">i4").tobytes(),
        f"\nCELL_DATA {len(faces)}\n".encode(),
    ]
    for name, column in zip(("region_a", "region_b"), regions.T, strict=True):
        kind, size = ("int", ">i4") if column.max() <= np.iinfo(np.int32).max else ("long", ">i8")
        blocks.append(f"SCALARS {name} {kind} 1\nLOOKUP_TABLE default\n".encode())
        blocks.append(column.astype(size).tobytes() + b"\n")
    for name, values in (attributes or {}).items():
        blocks.append(f"SCALARS {name} double 1\nLOOKUP_TABLE default\n".encode())
        blocks.append(np.asarray(values).astype(">f8").tobytes() + b"\n")
    return b"".join(blocks)


class _Reader:
    """Reads a file from start to end: the current place, and what was found before it."""

    def __init__(self, data: bytes) -> None:
        self.data, self.place = data, 0
        self.xyz: FloatArray = np.zeros((0, 3))
        self.polygons: list[IntArray] = []
        self.kinds: IntArray | None = None  # of the cells of an unstructured grid
        self.cell_data: dict[str, NDArray[Any]] = {}
        self.section = ""
        first = self._line().lower()
        if not first.startswith("# vtk datafile version"):
            raise InputError("it does not begin as a legacy .vtk file; .vtu and .vtp are not read")
        self.new = float(first.split()[-1]) >= 5
        self._line()  # the title
        self.binary = self._line().upper() == "BINARY"
        kind = self._line().upper().split()
        if kind not in (["DATASET", "POLYDATA"], ["DATASET", "UNSTRUCTURED_GRID"]):
            raise InputError("a .vtk file of POLYDATA or UNSTRUCTURED_GRID is needed")

    def mesh(self) -> RawMesh:
        """Read the whole file and return its mesh."""
        while self.place < len(self.data):
            words = self._line().split()
            if words:
                self._block(words[0].upper(), words)
        kept = [k for k, polygon in enumerate(self.polygons) if self._is_polygon(k, polygon)]
        faces = [
            (p[0], p[j - 1], p[j])
            for p in (self.polygons[k] for k in kept)
            for j in range(2, len(p))
        ]
        regions = None
        if {"region_a", "region_b"} <= set(self.cell_data):
            pairs = np.column_stack([self.cell_data[f"region_{side}"] for side in "ab"])
            if len(pairs) != len(self.polygons):
                raise InputError("the regions are not one pair for each cell")
            repeats = [len(self.polygons[k]) - 2 for k in kept]
            regions = np.repeat(pairs[kept].astype(np.int64), repeats, axis=0)
        dropped = len(self.polygons) - len(kept)
        plain = "is no polygon" if dropped == 1 else "are no polygons"
        text = f"ignored {counted(dropped, 'cell')} that {plain}"
        table = np.reshape(faces, (-1, 3)).astype(np.int64)
        return RawMesh(self.xyz, table, regions, (text,) if dropped else ())

    def _is_polygon(self, k: int, polygon: IntArray) -> bool:
        return len(polygon) > 2 and (self.kinds is None or int(self.kinds[k]) in _POLYGONS)

    def _block(self, name: str, words: list[str]) -> None:
        if name == "POINTS":
            self.xyz = (
                self._numbers(3 * self._count(words[1]), words[2]).reshape(-1, 3).astype(np.float64)
            )
        elif name in ("POLYGONS", "CELLS"):
            self.polygons += self._cells(self._count(words[1]), self._count(words[2]))
        elif name in ("VERTICES", "LINES", "TRIANGLE_STRIPS"):
            # Cell data has values for these cells too, so they keep their place.
            cells = self._cells(self._count(words[1]), self._count(words[2]))
            self.polygons += [cell[:1] for cell in cells]
        elif name == "CELL_TYPES":
            self.kinds = self._numbers(self._count(words[1]), "int").astype(np.int64)
        elif name in ("CELL_DATA", "POINT_DATA"):
            self.section, self.count = name, self._count(words[1])
        elif name == "SCALARS":
            width = self._count(words[3]) if len(words) > 3 else 1
            start = self.place
            if self._line().split()[:1] != ["LOOKUP_TABLE"]:
                self.place = start
            self._keep(words[1], self._numbers(width * self.count, words[2]))
        elif name in _PER_TUPLE:
            self._numbers(_PER_TUPLE[name] * self.count, words[2])
        elif name == "TEXTURE_COORDINATES":
            self._numbers(self._count(words[2]) * self.count, words[3])
        elif name == "FIELD":
            self._fields(self._count(words[2]))
        elif name == "LOOKUP_TABLE":
            self._numbers(4 * self._count(words[2]), "unsigned_char" if self.binary else "float")
        elif name == "METADATA":
            while self._line():
                pass
        else:
            raise InputError(f"the block '{words[0][:30]}' is not known")

    def _fields(self, count: int) -> None:
        for _ in range(count):
            words = self._line().split()
            while not words and self.place < len(self.data):
                words = self._line().split()
            name, width, tuples, kind = words[:4]
            self._keep(name, self._numbers(self._count(width) * self._count(tuples), kind))

    def _keep(self, name: str, values: NDArray[Any]) -> None:
        if self.section == "CELL_DATA":
            self.cell_data[name] = values

    def _cells(self, count: int, size: int) -> list[IntArray]:
        """Read the vertices of each cell."""
        if not self.new:
            table = self._numbers(size, "int").astype(np.int64)
            cells, place = [], 0
            for _ in range(count):
                length = int(table[place])
                if length < 0 or place + 1 + length > size:
                    raise InputError("a cell is longer than its block")
                cells.append(table[place + 1 : place + 1 + length])
                place += 1 + length
            return cells
        offsets = self._numbers(count, self._line().split()[1]).astype(np.int64)
        corners = self._numbers(size, self._line().split()[1]).astype(np.int64)
        if count and (offsets[0] < 0 or offsets[-1] > size or (np.diff(offsets) < 0).any()):
            raise InputError("the cells do not lie one after the other")
        return [corners[a:b] for a, b in pairwise(offsets.tolist())]

    def _count(self, word: str) -> int:
        """Convert a count; an error if it is more than the file has bytes."""
        count = int(word)
        if not 0 <= count <= len(self.data):
            raise InputError(f"it says that it holds {word[:20]} of something, which it cannot")
        return count

    def _line(self) -> str:
        end = self.data.find(b"\n", self.place)
        end = len(self.data) if end < 0 else end
        line = self.data[self.place : end]
        self.place = end + 1
        return line.decode("ascii", errors="replace").strip()

    def _numbers(self, count: int, kind: str) -> NDArray[Any]:
        """Read the next ``count`` numbers."""
        dtype = np.dtype(_TYPES[kind.lower()]).newbyteorder(">")
        if self.binary:
            stop = self.place + count * dtype.itemsize
            if stop > len(self.data):
                raise InputError("the file ends too early")
            found = np.frombuffer(self.data, dtype, count, self.place)
            # A line break ends the block.
            self.place = stop + (self.data[stop : stop + 1] == b"\n")
            return found
        words: list[bytes] = []
        if count > len(self.data) - self.place:
            raise InputError("the file ends too early")
        while len(words) < count:
            if self.place >= len(self.data):
                raise InputError("the file ends too early")
            end = self.data.find(b"\n", self.place)
            end = len(self.data) if end < 0 else end
            words += self.data[self.place : end].split()
            self.place = end + 1
        return np.array(words[:count], dtype=np.float64 if dtype.kind == "f" else np.int64)
