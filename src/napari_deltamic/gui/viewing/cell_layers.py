"""Cells as layers: meshes and points of files, and labels with their measurements."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, RepairWarning
from ...geometry import Mesh, load_mesh
from ...results.features import features_of
from ...runs.seeds import POINTS_FILE, PointSeeds, read_points
from .colours import surface_look, vertex_values
from .frame import MADE_BY_FIT, ORIGIN, OWN, Frame
from .own_layers import Surface

_AXES = ("z", "y", "x")
FILE = "file"  # key under OWN


@dataclass(frozen=True)
class LoadedMesh:
    """A mesh from a file, and a mark by which it is recognised later.

    mark : of the file and of what was read from it.
    remarks : what had to be repaired, in plain words.
    """

    path: str
    mesh: Mesh
    mark: str
    remarks: tuple[str, ...]


def load_meshes(paths: list[str]) -> list[LoadedMesh]:
    """Read mesh files; InputError names the first that cannot be used."""
    return [_load(str(Path(path).absolute())) for path in paths]


def load_seeds(paths: list[str]) -> list[LoadedMesh | PointSeeds]:
    """The same of files of meshes or points."""
    full = [str(Path(path).absolute()) for path in paths]
    return [read_points(p) if p.lower().endswith(POINTS_FILE) else _load(p) for p in full]


def surface_layer(loaded: LoadedMesh, frame: Frame) -> Surface:
    """A Surface layer of a mesh whose coordinates are um in a frame."""
    mesh = loaded.mesh
    return Surface(
        # Not float32: a fit of the layer is then that of the file, to the last digit.
        (mesh.vertices_numpy(), mesh.faces, vertex_values(mesh)),
        name=Path(loaded.path).stem,
        opacity=0.6,
        **surface_look(),
        metadata={
            OWN: {
                "regions": mesh.regions,
                FILE: {"path": loaded.path, "mark": loaded.mark},
                ORIGIN: frame.translate,
            }
        },
        **frame.layer_options(),
    )


def unchanged_file(layer: Any, frame: Frame) -> str:
    """The file that a layer was made from, if it would still give the same seeds; else ''.

    The layer may have been edited or moved since, and so may the file.
    """
    known = layer.metadata.get(OWN, {})
    file = known.get(FILE)
    if not isinstance(file, dict) or layer.ndim != 3:
        return ""
    scale, shift = frame.data_to_um(layer)
    if not (np.allclose(scale, 1, rtol=1e-9) and np.allclose(shift, 0, atol=1e-9)):
        return ""
    mark = _mark(str(file.get("path")), layer.data[0], layer.data[1], known.get("regions"))
    return str(file["path"]) if mark and mark == file.get("mark") else ""


def labels_options(rows: Iterable[Mapping[str, Any]], frame: Frame, name: str) -> dict[str, Any]:
    """Options of a Labels layer of cells, with their measurements as features."""
    return {
        **frame.image_options(),
        "axis_labels": _AXES,
        "name": name,
        "opacity": 0.4,
        "features": features_of(rows),
        "metadata": {OWN: dict(MADE_BY_FIT)},
    }


def _load(path: str) -> LoadedMesh:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = load_mesh(path)
    remarks = [str(w.message) for w in caught if issubclass(w.category, RepairWarning)]
    mark = _mark(path, mesh.vertices_numpy(), mesh.faces, mesh.regions)
    if not mark:
        raise InputError(f"cannot read {path}")
    return LoadedMesh(path, mesh, mark, tuple(remarks))


def _mark(path: str, vertices: Any, faces: Any, regions: Any) -> str:
    """A mark that changes when the file or any of the arrays does; '' if the file is missing."""
    try:
        found = Path(path).stat()
    except OSError:
        return ""
    digest = hashlib.sha256(f"{found.st_size} {found.st_mtime_ns}".encode())
    for array in (vertices, faces, regions):
        digest.update(str(np.shape(array)).encode())
        digest.update(np.ascontiguousarray(array, np.float64).tobytes())
    return digest.hexdigest()
