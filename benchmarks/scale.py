"""What each operation on meshes costs as cells become many.

python -m benchmarks.scale [--cells 1 30 100 1000] [--seed 0] [--only NAME ...] [--json FILE]

Foams of cells of one size fill an ellipsoid; 1000 of them fill one of 256 x 512 x 512 voxels.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from napari_deltamic.fitting.surface.collisions import CollisionGuard
from napari_deltamic.fitting.surface.growth_alarm import GrowthAlarm, shrunken
from napari_deltamic.fitting.surface.topology import _meet
from napari_deltamic.geometry import Mesh, mesh_from_labels, remesh
from napari_deltamic.geometry.topology.crossings import crossings
from napari_deltamic.geometry.topology.rearranging import give_way
from napari_deltamic.geometry.topology.small_pieces import small_pieces
from napari_deltamic.geometry.topology.thin_places import (
    ThinPlace,
    short_junctions,
    small_walls,
    thin_places,
)
from napari_deltamic.measure import measure_cells

CELLS = (1, 30, 100, 1000)
_MOST, _SHAPE = 1000, np.array([256, 512, 512])  # the largest foam and its image
_REPEATS = 3
_CURVED = 8.0  # edges: radius of the walls that are brought together
_LEFT = 0.15  # edges: what is left between them
_PLACES = 200  # compared with each other
_MOVED = 0.05  # edges: a step of the guard


@dataclass(frozen=True)
class Foam:
    """Labels of cells in voxels of 1 um, and the centres that they grew from."""

    labels: NDArray[np.int32]
    centers: NDArray[np.float64]
    radius: float


def foam_labels(cells: int, seed: int = 0) -> Foam:
    """A foam of cells of about one size: the nearest of shaken centres, within spheres."""
    rng = np.random.default_rng([seed, cells])
    shape = np.ceil(_SHAPE * (cells / _MOST) ** (1 / 3)).astype(int)
    half = 0.44 * shape
    radius = float((half.prod() / cells) ** (1 / 3))
    inner = half - 0.8 * radius
    cloud = rng.uniform(-1, 1, (400 * cells, 3))
    cloud = cloud[(cloud**2).sum(1) < 1] * inner
    centers = cloud[:cells].copy()
    for _ in range(25):  # Lloyd
        nearest = cKDTree(centers).query(cloud)[1]
        count = np.maximum(np.bincount(nearest, minlength=cells), 1)
        centers = np.stack([np.bincount(nearest, cloud[:, k], cells) / count for k in range(3)], 1)
    centers = (shape - 1) / 2 + centers + rng.normal(0, 0.06 * radius, centers.shape)
    reach = 1.25 * radius
    labels, square = np.zeros(shape, np.int32), np.full(shape, reach**2)
    for k, center in enumerate(centers):
        low = np.floor(center - reach).astype(int).clip(0)
        high = np.minimum(np.ceil(center + reach).astype(int) + 1, shape)
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        away = [np.arange(a, b) - c for a, b, c in zip(low, high, center, strict=True)]
        own = sum(x**2 for x in np.ix_(*away))
        nearer = own < square[box]
        labels[box][nearer], square[box][nearer] = k + 1, own[nearer]
    return Foam(labels, centers, radius)


def dented(mesh: Mesh, cell: int, edge: float, towards: NDArray[np.float64]) -> Mesh:
    """The mesh with two opposite walls of a cell brought together along a line through its middle.

    Space is squeezed towards the middle, which cannot make surfaces cross.
    """
    vertices = mesh.vertices_numpy()
    own = np.unique(mesh.faces[(mesh.regions == cell).any(1)])
    middle = vertices[own].mean(0)
    axis = towards / np.linalg.norm(towards)
    along = (vertices - middle) @ axis
    across = np.linalg.norm(vertices - middle - along[:, None] * axis, axis=1)
    line = own[across[own] < 1.5 * edge]
    high, low = along[line].max(), along[line].min()
    center, height = (high + low) / 2, (high - low) / 2
    along = along - center
    # As two spheres that nearly touch.
    left = (_LEFT * edge + across**2 / (_CURVED * edge)) / (2 * height)
    squeezed = left / (1 + left**4) ** 0.25
    # Linear within the cell, then back to what is not moved at twice its height.
    size = np.abs(along)
    inner = np.minimum(size, 1.2 * height) * squeezed
    outer = np.clip(size - 1.2 * height, 0, 1.2 * height) * (2 - squeezed)
    rest = np.clip(size - 2.4 * height, 0, None)
    moved = np.sign(along) * (inner + outer + rest)
    return mesh.with_vertices(vertices + (moved - along)[:, None] * axis)


def timed(work: Callable[[], object], repeats: int = _REPEATS) -> float:
    """Median seconds."""
    took = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return median(took)


def fresh(mesh: Mesh) -> Mesh:
    """The same mesh with nothing known about it yet."""
    return Mesh(mesh.vertices, mesh.faces, mesh.regions)


def operations(cells: int, seed: int, only: list[str] | None) -> dict[str, float]:
    """Seconds of each operation (faces and GB for two of the rows), by name."""
    found: dict[str, float] = {}
    foam = foam_labels(cells, seed)
    began = time.perf_counter()
    mesh = mesh_from_labels(foam.labels, (1.0,) * 3, gap=0)
    found["mesh from labels"] = time.perf_counter() - began
    found["faces"] = len(mesh.faces)
    found["peak memory (GB)"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    edge = mesh.median_edge()

    def add(name: str, work: Callable[[], object], repeats: int = _REPEATS) -> None:
        if only is None or any(o in name for o in only):
            found[name] = timed(work, repeats)
            print(f"  {cells} cells, {name}: {found[name]:.3f} s", file=sys.stderr, flush=True)

    add("edges, walls of a new mesh", lambda: (fresh(mesh).edges(), fresh(mesh).interfaces()))
    add("is closed", lambda: fresh(mesh).is_closed(), 1)
    mesh.edges(), mesh.interfaces()
    add("crossings", lambda: crossings(mesh))
    add("guard: watch a mesh", lambda: CollisionGuard().watch(mesh))
    guard = CollisionGuard()
    guard.watch(mesh)
    steps = _Steps(mesh, edge, guard)
    add("guard: a step", steps.go, 11)
    moved = steps.mesh
    add("remesh, one pass", lambda: remesh(moved, edge, passes=1, apart=True), 1)
    add("remesh, three passes", lambda: remesh(moved, edge, passes=3, apart=True), 1)
    add("thin places", lambda: thin_places(mesh, 0.25 * edge))
    add("thin places, wide", lambda: thin_places(mesh, 1.6 * edge))
    add("small walls", lambda: small_walls(mesh, edge**2, 0.5 * edge))
    add("short junctions", lambda: short_junctions(mesh, edge))
    add("small pieces", lambda: small_pieces(mesh, edge**3))
    alarm = GrowthAlarm(mesh)
    add("growth alarm", lambda: alarm.check(moved))
    add("shrunken", lambda: shrunken(mesh, 1.0))
    add("measure cells", lambda: measure_cells(mesh))
    places = _made_up(mesh, seed)
    add("places that meet", lambda: [[_meet(p, q, edge) for p in places[::10]] for q in places])
    if cells > 1:
        flips = small_walls(mesh, 16 * edge**2)[:1]
        add("give way: a small wall", lambda: give_way(mesh, flips, edge), 1)
        dent = remesh(dented(mesh, cells // 2, edge, np.array([0.3, 0.5, 0.8])), edge, 2).mesh
        thin = thin_places(dent, 0.3 * edge, apart=2.5 * edge)[:1]
        assert thin, "the dent has made no thin place"
        add("give way: a thin place", lambda: give_way(dent, thin, edge), 1)
    return found


class _Steps:
    """A mesh that is shaken, under the guard."""

    def __init__(self, mesh: Mesh, edge: float, guard: CollisionGuard) -> None:
        self.mesh, self._guard, self._size = mesh, guard, _MOVED * edge
        self._rng = np.random.default_rng(1)

    def go(self) -> None:
        start = self.mesh.vertices_numpy()
        end = start + self._rng.normal(0, self._size, start.shape)
        self.mesh = self.mesh.with_vertices(self._guard.limited(start, end))


def _made_up(mesh: Mesh, seed: int) -> list[ThinPlace]:
    rng = np.random.default_rng(seed)
    vertices = mesh.vertices_numpy()
    picked = vertices[rng.integers(len(vertices), size=_PLACES)]
    return [ThinPlace((1,), (2, 3), p + rng.normal(size=(40, 3)), 1.0) for p in picked]


def table(found: dict[int, dict[str, float]]) -> str:
    """Markdown: a row for each operation, a column for each number of cells."""
    names = list(dict.fromkeys(name for column in found.values() for name in column))
    lines = [
        "| | " + " | ".join(f"{n} cells" for n in found) + " |",
        "|---|" + "---:|" * len(found),
    ]
    for name in names:
        values = [column.get(name) for column in found.values()]
        shown = ["" if v is None else f"{v:.0f}" if name == "faces" else f"{v:.3g}" for v in values]
        lines.append(f"| {name} | " + " | ".join(shown) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="+", default=list(CELLS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", help="parts of names of operations")
    parser.add_argument("--json", type=Path, help="where to write the seconds")
    given = parser.parse_args()
    found = {n: operations(n, given.seed, given.only) for n in sorted(given.cells)}
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(table(found))


if __name__ == "__main__":
    main()
