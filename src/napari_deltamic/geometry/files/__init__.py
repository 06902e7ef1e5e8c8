"""Mesh files. They store x, y, z in um; memory holds Z, Y, X. ``formats.py`` lists the formats."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ...common.reading import one_reason, quiet
from ...common.words import counted
from ...common.writing import write_atomically
from ...errors import InputError, RepairWarning
from ..connected import pieces
from ..formats import MESH_FILES, MESH_FORMATS, MeshFormat, mesh_format
from ..mesh import OUTSIDE, FloatArray, Mesh
from ..mesh_repair import repair
from .raw import RawMesh


def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read a mesh file and repair it.

    Parameters
    ----------
    path : path
        A .obj, .off, .ply, .stl, .rec (text, or the binary variant) or legacy .vtk file, with
        positions x, y, z in um. Polygons are cut into triangles. Region pairs are read from .rec
        files, from the face properties region_a and region_b of a .ply file, from the cell data of
        these names in a .vtk file, and from groups region_A_B in a .obj file; without them the
        mesh is one region, (1, 0).

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
    kind = _format(path)
    read: Callable[[bytes], RawMesh] = _function("read", kind)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if not data.strip():
        raise InputError(f"{path}: the file is empty")
    try:
        with quiet("trimesh"):
            raw = read(data)
            if len(raw.faces) == 0:
                what = f"only points ({len(raw.xyz)}), no faces" if len(raw.xyz) else "no mesh"
                raise InputError(f"the file holds {what}")
            mesh, messages = repair(raw.xyz[:, ::-1], raw.faces, raw.regions)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # whatever a parser may raise on damaged data
        raise InputError(
            f"{path}: not a readable {path.suffix} mesh ({one_reason(error)})"
        ) from error
    for message in (*raw.messages, *messages, *_remarks(mesh, raw.regions is not None)):
        warnings.warn(f"{path.name}: {message}", RepairWarning, stacklevel=2)
    return mesh


def save_mesh(
    mesh: Mesh,
    path: str | os.PathLike[str],
    attributes: Mapping[str, FloatArray] | None = None,
) -> None:
    """Write a mesh file, with positions x, y, z in um.

    Parameters
    ----------
    mesh : Mesh
    path : path
        Ends in .obj, .off, .ply, .stl, .rec (text) or .vtk. Region pairs are kept in .ply and .vtk
        (as region_a and region_b of each face), .obj (as groups region_A_B) and .rec. STL and OFF
        cannot hold them, and STL keeps about 7 digits only; a mesh with regions other than (1, 0)
        gives a UserWarning there. The file appears whole or not at all.
    attributes : (F,) each, by name
        Numbers of the faces; .ply and .vtk files hold them.

    Raises
    ------
    InputError
        Naming the file and the reason: unknown extension, no place for attributes, or the file
        cannot be written.
    """
    path = Path(path)
    kind = _format(path)
    write: Callable[..., bytes] = _function("write", kind)
    more = {}
    if attributes:
        if not kind.attributes:
            known = " and ".join(one.suffix for one in MESH_FORMATS if one.attributes)
            raise InputError(f"{path}: only {known} files hold attributes")
        more["attributes"] = attributes
    if not kind.regions:
        pairs = mesh.interfaces()[0].tolist()
        if pairs != [[1, OUTSIDE]]:
            warnings.warn(
                f"{path.name}: {path.suffix} files cannot hold regions; use .ply, .obj or .rec "
                f"to keep the {counted(len(pairs), 'interface')}",
                UserWarning,
                stacklevel=2,
            )
    xyz = np.ascontiguousarray(mesh.vertices_numpy()[:, ::-1])
    write_atomically(path, write(xyz, mesh.faces, mesh.regions, **more))


def _remarks(mesh: Mesh, named: bool) -> list[str]:
    """Describe what cannot be repaired safely but may cause trouble: borders, and too many walls.

    named : whether the file names the regions of its faces.
    """
    found = []
    parts = 1 if named else int(pieces(mesh).max()) + 1
    if parts > 1:
        found.append(
            f"the file does not name its cells: {parts} separate surfaces count as one cell; "
            f"{', '.join(one.suffix for one in MESH_FORMATS if one.regions)} keep cells apart"
        )
    is_open = [str(k) for k in mesh.region_ids() if not mesh.is_closed(int(k))]
    if is_open:
        found.append(f"the surface of region {', '.join(is_open)} is open: it has no volume")
    n = int((mesh.edge_uses() > 3).sum())
    if n:
        found.append(
            f"four walls or more meet in {counted(n, 'edge')}; three would be free to move"
        )
    return found


def _format(path: Path) -> MeshFormat:
    kind = mesh_format(path)
    if kind is None:
        raise InputError(
            f"{path}: unknown mesh extension '{path.suffix}'; known are {', '.join(MESH_FILES)}"
        )
    return kind


def _function(verb: str, kind: MeshFormat) -> Any:
    """Return the function that reads or writes a format; its module is loaded only now."""
    return getattr(import_module(f"{__name__}.{kind.name}"), f"{verb}_{kind.name}")
