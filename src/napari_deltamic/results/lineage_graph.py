"""Tracked cells as a graph in the GEFF format, which trackers and lineage viewers read.

One node for each cell in each frame: place, number, sizes, and the ellipsoid with its moments; one
edge from each to itself in its next frame, two to its daughters where it divides. The format:
https://liveimagetrackingtools.org/geff
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..common.writing import folder_atomically
from ..errors import InputError
from ..measure.cells import measure_cells, moments
from ..measure.sides import Sides
from ..tracking import FrameResult, lineage

GEFF = "tracks.geff"  # a folder
_MEASURES = ("volume_um3", "area_um2", "sphericity")


def write_geff(path: str | os.PathLike[str], results: Sequence[FrameResult]) -> Path:
    """Write tracks as a GEFF folder; an existing one is replaced once the new one is complete.

    Nodes have ``t`` (frame), ``z``, ``y``, ``x`` (um), ``seg_id`` (the cell's number, as in labels
    and meshes), ``time_s``, ``volume_um3``, ``area_um2``, ``sphericity`` and ``ellipsoid``: the
    matrix whose eigenvalues are the squared half axes, um^2.

    Raises
    ------
    InputError
        If the package geff is not installed, no frame has a cell with a volume, or the folder
        cannot be written.
    """
    try:
        import geff
        from geff.core_io import write_arrays
    except ImportError:
        raise InputError("GEFF needs a package: pip install 'napari-deltamic[tracks]'") from None
    path = Path(path)
    nodes, edges = _graph(results)
    if not len(nodes["seg_id"]):
        raise InputError("no frame has a cell that could be a node")
    axes = [{"name": "t", "type": "time"}]
    axes += [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
    facts: dict[str, Any] = {
        "directed": True,
        "axes": axes,
        "node_props_metadata": {},
        "edge_props_metadata": {},
        "ellipsoid": "ellipsoid",
        "track_node_props": {"tracklet": "seg_id"},
    }
    with folder_atomically(path) as aside, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zarr warns about names and versions
        write_arrays(
            aside,
            np.arange(len(nodes["seg_id"]), dtype=np.uint64),
            {name: {"values": values, "missing": None} for name, values in nodes.items()},
            edges.astype(np.uint64),
            {},
            geff.GeffMetadata(**facts),
        )
    return path


def _graph(results: Sequence[FrameResult]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return properties of the nodes, (N, ...) each, and pairs of nodes (E, 2), earlier first."""
    rows: list[tuple[float, ...]] = []
    matrices: list[np.ndarray] = []
    numbers: dict[int, list[int]] = {}  # the nodes of each cell
    for result in results:
        if result.mesh is None:
            continue
        spread = moments(Sides.of(result.mesh))[2]
        for cell, covariance in zip(measure_cells(result.mesh), spread, strict=True):
            if not np.isfinite(covariance).all():
                continue  # an open surface has no centre
            numbers.setdefault(int(cell["region"]), []).append(len(rows))
            place = [float(cell[f"centroid_{axis}_um"]) for axis in "zyx"]
            sizes = [float(cell[name]) for name in _MEASURES]
            rows.append((result.frame, *place, int(cell["region"]), result.time, *sizes))
            matrices.append(5 * covariance)
    edges = [pair for own in numbers.values() for pair in pairwise(own)]
    for life in lineage(results):
        if life.parent in numbers and life.cell in numbers:
            edges.append((numbers[life.parent][-1], numbers[life.cell][0]))
    names = ("t", "z", "y", "x", "seg_id", "time_s", *_MEASURES)
    columns = np.array(rows, np.float64).reshape(-1, len(names)).T
    nodes: dict[str, np.ndarray] = dict(zip(names, columns, strict=True))
    for name in ("t", "seg_id"):
        nodes[name] = nodes[name].astype(np.int64)
    nodes["ellipsoid"] = np.array(matrices).reshape(-1, 3, 3)
    return nodes, np.array(sorted(edges), np.int64).reshape(-1, 2)
