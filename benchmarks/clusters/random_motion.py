"""Random motion and remeshing of a foam: do its surfaces ever cross, crack or lose a label?

python -m benchmarks.clusters.random_motion [--steps 20000] [--cells 12] [--rough] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass

import numpy as np

from napari_deltamic.fitting.surface.collisions import CollisionGuard
from napari_deltamic.geometry import Mesh, remesh
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import smallest_angles
from napari_deltamic.geometry.topology.crossings import crosses

from ..figure import Figure, Options, Row, at_least, at_most

EDGE = 0.25  # um; the cells have radii of about 1 um
# Shares of the edge length by which a step moves the foam smoothly, and each vertex at random:
GENTLE = (0.06, 0.04)
ROUGH = (0.15, 0.05)  # presses cells into thin sheets, as the fit never does
# Others:
_PERIOD = 100  # steps in which the smooth motion goes and returns
_TENSION = 0.1  # share of the way to the mean of its neighbours that a vertex goes
_PRESSURE = 0.5  # share of its lost volume that a cell regains
_REMESH_EVERY = 5  # steps
_CHECK_EVERY = 100  # steps
_TOLD_EVERY = 500  # steps


@dataclass
class Outcome:
    """What became of a foam.

    crossings, cracks, labels : checks that found surfaces that cross; regions that are not closed;
        regions lost, without volume, or with other neighbours than at the start.
    angle : degrees, the first percentile of the smallest angles, at the worst check.
    held : share of the steps of vertices that the guard shortened.
    """

    cells: int
    faces: int
    steps: int
    checks: int
    crossings: int
    cracks: int
    labels: int
    angle: float
    angle_at_end: float
    held: float
    guard_ms: float
    remesh_ms: float
    seconds: float


def start(cells: int, seed: int = 0) -> Mesh:
    """A foam of cells that touch their neighbours."""
    random = np.random.default_rng(seed)
    centers = random.normal(size=(cells, 3)) * 1.5
    for _ in range(300):  # until they lie 1.6 um apart
        way = centers[:, None] - centers[None]
        apart = np.linalg.norm(way, axis=2) + 100 * np.eye(cells)
        push = (way / apart[..., None] * np.clip(1.6 - apart, 0, None)[..., None]).sum(1)
        centers += 0.2 * push - 0.01 * centers
    return foam(centers, np.full(cells, 1.1), EDGE)


class Motion:
    """The next place of each vertex of a foam that is swayed and shaken."""

    def __init__(self, mesh: Mesh, sizes: tuple[float, float], seed: int = 1) -> None:
        self._sway, self._shake = sizes
        self._random = np.random.default_rng(seed)
        self._volumes = mesh.volumes()
        self._extent = float(np.ptp(mesh.vertices_numpy(), axis=0).max())
        self._step = 0

    def next_places(self, mesh: Mesh) -> np.ndarray:
        """(V, 3) um."""
        if self._step % _PERIOD == 0:
            length = self._extent / self._random.uniform(0.5, 1.5, (6, 1))
            self._waves = 2 * np.pi / length * _directions(self._random, 6)
            self._ways = _directions(self._random, 6)
            self._phases = self._random.uniform(0, 2 * np.pi, 6)
        pace = np.sign(np.cos(2 * np.pi * (self._step % _PERIOD + 0.5) / _PERIOD))
        self._step += 1
        places = mesh.vertices_numpy()
        sway = np.sin(places @ self._waves.T + self._phases) @ self._ways
        shake = self._random.normal(size=places.shape) / np.sqrt(3)
        moved = EDGE * (self._sway * pace * sway + self._shake * shake)
        moved += _TENSION * (_neighbours_mean(mesh) - places) + self._pressed(mesh)
        return places + moved

    def _pressed(self, mesh: Mesh) -> np.ndarray:
        areas, normals, volumes = mesh.areas(), mesh.normals(), mesh.volumes()
        size = int(mesh.regions.max()) + 1
        surface = sum(np.bincount(mesh.regions[:, side], areas, size) for side in (0, 1))
        pressure = np.zeros(size)
        for region, volume in volumes.items():
            pressure[region] = _PRESSURE * (self._volumes[region] - volume) / surface[region]
        push = (pressure[mesh.regions[:, 0]] - pressure[mesh.regions[:, 1]]) * areas
        total = np.zeros((len(mesh.vertices), 3))
        weight = np.bincount(mesh.faces.ravel(), np.repeat(areas, 3), len(total))
        np.add.at(total, mesh.faces.ravel(), np.repeat(push[:, None] * normals, 3, axis=0))
        return total / np.maximum(weight, 1e-300)[:, None]


def _directions(random: np.random.Generator, n: int) -> np.ndarray:
    ways = random.normal(size=(n, 3))
    unit: np.ndarray = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    return unit


def _neighbours_mean(mesh: Mesh) -> np.ndarray:
    edges, places = mesh.edges(), mesh.vertices_numpy()
    ends = np.concatenate([edges, edges[:, ::-1]])
    count = np.bincount(ends[:, 0], minlength=len(places))
    total = [np.bincount(ends[:, 0], places[ends[:, 1], k], len(places)) for k in range(3)]
    mean: np.ndarray = np.stack(total, axis=1) / np.maximum(count, 1)[:, None]
    return mean


def shaken(mesh: Mesh, steps: int, sizes: tuple[float, float] = GENTLE) -> tuple[Mesh, Outcome]:
    """The mesh after a number of steps, and what was found on the way."""
    motion, guard = Motion(mesh, sizes), CollisionGuard()
    pairs, cells = mesh.interfaces()[0], len(mesh.region_ids())
    guard.watch(mesh)
    held = moves = crossings = cracks = labels = checks = 0
    worst, guard_s, remesh_s, began = 90.0, 0.0, 0.0, time.perf_counter()
    for step in range(1, steps + 1):
        end = motion.next_places(mesh)
        clock = time.perf_counter()
        reached = guard.limited(mesh.vertices_numpy(), end)
        guard_s += time.perf_counter() - clock
        held += 0 if reached is end else int((guard.held > 0).sum())
        moves += len(end)
        mesh = mesh.with_vertices(reached)
        if step % _REMESH_EVERY == 0:
            clock = time.perf_counter()
            mesh = remesh(mesh, EDGE, passes=1, apart=True).mesh
            remesh_s += time.perf_counter() - clock
            guard.watch(mesh)
        if step % _CHECK_EVERY == 0 or step == steps:
            checks += 1
            crossings += intersects(mesh)
            cracks += not mesh.is_closed()
            same = np.array_equal(mesh.interfaces()[0], pairs)
            labels += not (same and min(mesh.volumes().values()) > 0)
            angle = float(np.percentile(smallest_angles(mesh), 1))
            worst = min(worst, angle)
        if step % _TOLD_EVERY == 0:
            found = f"{crossings} crossings, {cracks} cracks, {labels} wrong labels"
            print(f"{step} steps: {found}, angle {angle:.1f}", file=sys.stderr, flush=True)
    took = time.perf_counter() - began
    return mesh, Outcome(
        cells,
        len(mesh.faces),
        steps,
        checks,
        crossings,
        cracks,
        labels,
        worst,
        angle,
        held / moves,
        1e3 * guard_s / steps,
        1e3 * remesh_s * _REMESH_EVERY / steps,
        took,
    )


def intersects(mesh: Mesh) -> bool:
    """Whether surfaces cross, as ipctk finds it; by our own search where that is missing."""
    try:
        import ipctk
    except ImportError:
        return crosses(mesh)
    places = np.asfortranarray(mesh.vertices_numpy())
    surface = ipctk.CollisionMesh(places, mesh.edges(), mesh.faces)
    return bool(ipctk.has_intersections(surface, places))


def random_motion(options: Options) -> list[Row]:
    """Checks that failed in 20,000 steps, and the worst angle."""
    mesh = start(12)
    _, o = shaken(mesh, 1000 if options.quick else 20_000)
    name = f"{o.cells} cells, {o.steps} random steps with remeshing"
    note = f"{o.faces} faces, {o.seconds:.0f} s"
    return [
        at_most(f"{name}, checks with crossings", 0, o.crossings, f"of {o.checks}", note),
        at_most(f"{name}, checks with cracks", 0, o.cracks, f"of {o.checks}"),
        at_most(f"{name}, checks with wrong labels", 0, o.labels, f"of {o.checks}"),
        at_least(f"{name}, 1 % smallest angle, worst check", 25, o.angle, "degrees"),
    ]


FIGURES: dict[str, Figure] = {"random motion": random_motion}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--cells", type=int, default=12)
    parser.add_argument("--rough", action="store_true", help="a stronger motion")
    parser.add_argument("--json", help="where to write the outcome")
    arguments = parser.parse_args()
    sizes = ROUGH if arguments.rough else GENTLE
    _, outcome = shaken(start(arguments.cells), arguments.steps, sizes)
    text = json.dumps(asdict(outcome), indent=1)
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            file.write(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
