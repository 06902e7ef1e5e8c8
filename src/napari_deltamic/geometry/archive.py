"""Arrays and texts in one zip file: written whole or not at all, and never trusted when read.

Each array is a member ``NAME.npy`` in NumPy's own format, so that the file can be read without
this package. Nothing in it is ever executed: arrays of Python objects are neither written nor read.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..common.reading import LARGEST_TEXT, json_values, one_reason
from ..common.writing import write_atomically
from ..errors import InputError
from . import Mesh

# The most that a file may unpack to: this many times its size on disk, or this many bytes,
# whichever is more. Images unpack to two to ten times their size; labels, which repeat a few
# values, to up to a thousand times. Without a limit a forged file could fill the memory.
_GROWTH, _SMALL = 200, 1 << 29  # bytes
_PIECE = 1 << 22  # bytes read at a time, or an array would be in memory twice
_LEVEL = 1  # of the compression: higher ones take five times as long for a few per cent


class ArchiveWriter:
    """Collects members in memory, compressed; :meth:`write` makes the file."""

    def __init__(self) -> None:
        self._buffer = io.BytesIO()
        self._zip = zipfile.ZipFile(self._buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL)

    def add_array(self, name: str, array: NDArray[Any]) -> None:
        """Add an array of numbers, bit for bit; it is not copied."""
        if array.dtype.hasobject:
            raise InputError(f"{name} holds Python objects, which cannot be saved")
        with self._zip.open(f"{name}.npy", "w", force_zip64=True) as stream:
            np.lib.format.write_array(
                stream, np.asanyarray(array), version=(1, 0), allow_pickle=False
            )

    def add_text(self, name: str, text: str) -> None:
        """Add a text."""
        self._zip.writestr(name, text.encode())

    def add_json(self, name: str, values: Any) -> None:
        """Add plain values (JSON types and NumPy scalars) as a JSON text."""
        self.add_text(name, json.dumps(values, indent=1, default=_plain))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file. InputError if it cannot be written; an existing file then stays as is."""
        self._zip.close()
        # The buffer itself, not a copy: a large image should not be in memory twice.
        write_atomically(path, cast(bytes, self._buffer.getbuffer()))


class ArchiveReader:
    """Reads and checks the members of a file; made by :func:`opened`."""

    def __init__(self, file: zipfile.ZipFile, most: int) -> None:
        self._zip = file
        self._left = most  # bytes that may still be unpacked
        self.names = frozenset(file.namelist())

    def array(self, name: str) -> NDArray[Any]:
        """Return an array. InputError if it is missing or damaged."""
        info = self._info(f"{name}.npy")
        with self._zip.open(info) as stream:
            if np.lib.format.read_magic(stream) != (1, 0):
                raise InputError(f"{name} is damaged")
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
            # Checked before memory is allocated: a damaged header may claim any shape.
            size = prod(shape) * dtype.itemsize
            if dtype.hasobject or size != info.file_size - stream.tell():
                raise InputError(f"{name} is damaged")
            self._take(size)
            array = np.empty(shape, dtype, order="F" if fortran else "C")
            if size:
                _fill(stream, array.reshape(-1, order="A").view(np.uint8))
        return array

    def text(self, name: str) -> str:
        """Return a text. InputError if it is missing or damaged."""
        info = self._info(name)
        if info.file_size > LARGEST_TEXT:
            raise InputError(f"{name} is too long")
        self._take(info.file_size)
        return self._zip.read(info).decode()

    def json(self, name: str) -> Any:
        """Return the values of a JSON text. InputError if it is missing or damaged."""
        return json_values(self.text(name))

    def _take(self, size: int) -> None:
        """Count bytes before they are unpacked. InputError if all so far exceed the limit."""
        self._left -= size
        if self._left < 0:
            raise InputError("it would unpack to far more than it can hold")

    def _info(self, name: str) -> zipfile.ZipInfo:
        if name not in self.names:
            raise InputError(f"it has no {name}")
        return self._zip.getinfo(name)


@contextmanager
def opened(path: str | os.PathLike[str], what: str) -> Iterator[ArchiveReader]:
    """Open a file for reading; error messages say that it should be ``what``.

    Raises
    ------
    InputError
        In one line, with the path: the file is missing, unreadable, no zip file or damaged, or
        the block raised anything because of its content.
    """
    path = Path(path)
    try:
        most = max(_SMALL, _GROWTH * path.stat().st_size)
        with zipfile.ZipFile(path) as file:
            yield ArchiveReader(file, most)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except zipfile.BadZipFile as error:
        raise InputError(f"{path}: not {what}, or a damaged one") from error
    except InputError as error:
        raise InputError(f"{path}: not {what}, or a damaged one ({error})") from error
    except Exception as error:  # whatever may be raised on damaged data
        raise InputError(f"{path}: not {what}, or a damaged one ({one_reason(error)})") from error


class MeshWriter:
    """Writes meshes into an archive; faces and regions that several share are stored once."""

    def __init__(self, archive: ArchiveWriter) -> None:
        self._archive = archive
        self._shapes: list[Mesh] = []

    def add(self, name: str, mesh: Mesh) -> dict[str, Any]:
        """Write a mesh; returns plain values by which :meth:`MeshReader.mesh` finds it again."""
        self._archive.add_array(name, mesh.vertices_numpy())
        for k, other in enumerate(self._shapes):
            if _same_faces(mesh, other):
                return {"vertices": name, "faces": k}
        k = len(self._shapes)
        self._shapes.append(mesh)
        self._archive.add_array(f"faces/{k}/corners", mesh.faces)
        self._archive.add_array(f"faces/{k}/regions", mesh.regions)
        return {"vertices": name, "faces": k}


class MeshReader:
    """Reads what a :class:`MeshWriter` wrote; meshes share faces in memory as in the file."""

    def __init__(self, archive: ArchiveReader) -> None:
        self._archive = archive
        self._shapes: dict[int, Mesh] = {}

    def mesh(self, facts: Mapping[str, Any]) -> Mesh:
        """Return the mesh that ``MeshWriter.add`` described. InputError if missing or damaged."""
        vertices, k = self._archive.array(facts["vertices"]), int(facts["faces"])
        if k in self._shapes:
            return self._shapes[k].with_vertices(vertices)
        faces, regions = (self._archive.array(f"faces/{k}/{n}") for n in ("corners", "regions"))
        self._shapes[k] = Mesh(vertices, faces, regions)
        return self._shapes[k]


def _same_faces(a: Mesh, b: Mesh) -> bool:
    if len(a.vertices) != len(b.vertices):
        return False
    if a.faces is b.faces and a.regions is b.regions:
        return True
    return np.array_equal(a.faces, b.faces) and np.array_equal(a.regions, b.regions)


def _fill(stream: Any, flat: NDArray[np.uint8]) -> None:
    view = flat.data
    done = 0
    while done < len(view):
        piece = stream.read(min(_PIECE, len(view) - done))
        if not piece:
            raise InputError("it ends too early")
        view[done : done + len(piece)] = piece
        done += len(piece)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is no plain value")
