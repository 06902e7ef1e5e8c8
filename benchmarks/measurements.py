"""Measured numbers whose truth is known, at 40 photons: shapes in closed form, another channel.

    python -m benchmarks.measurements [--draws N] [--page docs/measurements.md]

Shapes are rendered from fine meshes, with Poisson noise, and fitted as ``fit`` does from a label
image. Volumes, areas and curvatures are compared with those of the fine meshes (within 0.2 % of
the smooth shapes), angles and tensions with the smooth shapes. The channel is one of 32 cells,
with walls that differ ten times in brightness, 200 nm beside the mesh, its PSF wider than given.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import napari_deltamic as nd
from benchmarks.double_bubble import DoubleBubble
from benchmarks.shapes import torus
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.job import assemble, start
from napari_deltamic.geometry import mesh_from_labels, sphere
from napari_deltamic.measure import Measurements, measure
from napari_deltamic.measure.of_fit import known_of, replicas_at
from napari_deltamic.runs.settings import RunSettings, SceneSettings

from .figure import Row, at_least, at_most
from .page import put_between, table

VOXEL, SIGMA, PHOTONS = 0.2, 0.26, 40.0
FINE = 0.08  # um; edges of the meshes that images are made of
RATIOS = (0.6, 1.0, 1.4, 1.8)  # of the shared wall's tension to those of the others
RADIUS = 2.4  # um; of both caps of a double bubble with a flat wall


@dataclass(frozen=True)
class Shape:
    """A shape as it is rendered, and its angles and tensions; whether its cells are smooth."""

    name: str
    mesh: nd.Mesh
    smooth: bool = True
    angles: tuple[float, ...] = ()
    tensions: tuple[float, ...] = ()


@dataclass
class Errors:
    """What was found, over all shapes and draws."""

    volume: list[float] = field(default_factory=list)  # relative
    angle: list[float] = field(default_factory=list)  # degrees
    tension: list[float] = field(default_factory=list)  # relative
    deviations: dict[str, list[float]] = field(default_factory=dict)  # off, in standard errors

    def add_deviation(self, name: str, found: object, exact: object, error: object) -> None:
        """One number that has a standard error."""
        known = isinstance(found, float) and isinstance(error, float)
        if known and isinstance(exact, float):
            self.deviations.setdefault(name, []).append((found - exact) / error)


def shapes() -> list[Shape]:
    """The closed forms."""
    found = [
        Shape("sphere", sphere((0, 0, 0), 2.2, edge_length=FINE)),
        Shape("spheroid", sphere((0, 0, 0), (1.7, 2.8, 1.7), edge_length=FINE)),
        Shape("torus", torus((0, 0, 0), 2.4, 1.0, edge_length=FINE)),
    ]
    for ratio in RATIOS:
        # The rim of two spheres whose centres are a ratio of their radius apart.
        bubble = DoubleBubble(RADIUS * np.sqrt(1 - ratio**2 / 4), (1.0, 1.0, ratio))
        found.append(
            Shape(
                f"double bubble {ratio:g}",
                bubble.mesh(FINE * 2),
                False,
                angles=tuple(bubble.angles),
                tensions=tuple(np.array(bubble.tensions) / np.mean(bubble.tensions)),
            )
        )
    return found


def fitted(shape: Shape, seed: int) -> tuple[Measurements, str]:
    """The measurements of a fit to one noisy image of a shape, and why it has no errors."""
    low, high = shape.mesh.bounds()
    size = np.ceil((high - low + 8 * SIGMA) / VOXEL).astype(int)
    middle = (size - 1) * VOXEL / 2
    # Off the voxels by another part of a voxel in each draw.
    middle += np.random.default_rng(seed).uniform(-0.5, 0.5, 3) * VOXEL
    z, y, x = (int(n) for n in size)
    grid = nd.Grid((z, y, x), (VOXEL,) * 3)
    optics = nd.GaussianPSF((SIGMA,) * 3)
    truth = shape.mesh.translated(middle - (low + high) / 2)
    scene = nd.Scene((nd.Surface(truth),), optics)
    made = nd.simulate(scene, grid, photons=PHOTONS, seed=seed, accuracy=1e-4)
    assert made.labels is not None
    begin = mesh_from_labels(made.labels, grid.voxel_size, grid.origin)
    settings = RunSettings(
        image="", seeds="", scene=SceneSettings(voxel_size=grid.voxel_size, sigma=(SIGMA,) * 3)
    )
    job = assemble(settings, made.image, grid, begin, "labels")
    *_, last = start(job)
    why, replicas = "", None
    try:
        replicas = replicas_at(made.image, grid, last, job.settings.fit)
    except InputError as error:
        why = str(error)
    return measure(last.mesh, known_of(last, grid, replicas=replicas)), why


def compare(shape: Shape, found: Measurements, errors: Errors) -> None:
    """Add what one fit is off by."""
    exact = measure(shape.mesh).cells.rows
    if len(found.cells.rows) != len(exact):
        raise SystemExit(f"{shape.name}: {len(found.cells.rows)} cells were found")
    for row, true in zip(found.cells.rows, exact, strict=True):
        volume, right = row["volume_um3"], true["volume_um3"]
        assert isinstance(volume, float), row["note"]
        assert isinstance(right, float), true["note"]
        errors.volume.append(volume / right - 1)
        errors.add_deviation("volume", volume, right, row["volume_se_um3"])
        errors.add_deviation("area", row["area_um2"], true["area_um2"], row["area_se_um2"])
        if shape.smooth:
            name = "mean_curvature_per_um"
            error = row["mean_curvature_se_per_um"]
            errors.add_deviation("mean curvature", row[name], true[name], error)
    if not shape.angles:
        return
    (junction,) = found.junctions.rows
    for name, opening in zip("abc", shape.angles, strict=True):
        angle, error = junction[f"angle_{name}_deg"], junction[f"angle_{name}_se_deg"]
        assert isinstance(angle, float)
        errors.angle.append(angle - opening)
        errors.add_deviation("angle", angle, opening, error)
    for row, relative in zip(found.walls.rows, shape.tensions, strict=True):
        tension = row["tension"]
        assert isinstance(tension, float), row["note"]
        errors.tension.append(tension / relative - 1)
        errors.add_deviation("tension", tension, relative, row["tension_se"])


def rows_of(errors: Errors, draws: int) -> list[Row]:
    """The bars."""

    def rms(values: list[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    note = f"{draws} draws of noise each"
    found = [
        at_most("volume: largest error", 1.0, 100 * max(map(abs, errors.volume)), "%", note),
        at_most("angles: largest error", 2.0, max(map(abs, errors.angle)), "degrees", note),
        at_most("tensions: rms error", 5.0, 100 * rms(errors.tension), "%", "ratios 0.6 to 1.8"),
    ]
    for name, values in errors.deviations.items():
        within = 100 * float(np.mean(np.abs(values) <= 2))
        spread = f"rms {rms(values):.2f} standard errors, mean {np.mean(values):+.2f}"
        found.append(
            at_least(f"{name}: within 2 standard errors", 95, within, "%", f"{spread}, {note}")
        )
        one = 100 * float(np.mean(np.abs(values) <= 1))
        found.append(
            Row(f"{name}: within 1 standard error", "63 to 73", one, "%", 63 <= one <= 73, note)
        )
    return found


def without_noise() -> list[Row]:
    """What the numbers of meshes with all vertices on the smooth shape are off by."""
    angles, tensions = [], []
    for ratio in RATIOS:
        for tilt in (0.0, 0.2):
            bubble = DoubleBubble(3.0, (1.0, 0.9, ratio), tilt)
            measured = measure(bubble.mesh(0.3))
            (row,) = measured.junctions.rows
            angles += [row[f"angle_{x}_deg"] - a for x, a in zip("abc", bubble.angles, strict=True)]
            exact = np.array(bubble.tensions) / np.mean(bubble.tensions)
            tensions += list(np.array(measured.walls.values("tension"), float) / exact - 1)
    note = "vertices on the shape, no image"
    return [
        Row("angles: largest error", "-", float(np.abs(angles).max()), "degrees", None, note),
        Row("tensions: largest error", "-", 100 * float(np.abs(tensions).max()), "%", None, note),
    ]


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measurements", description=__doc__)
    parser.add_argument("--draws", type=int, default=3, help="of noise, for each shape")
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    errors = Errors()
    for shape in shapes():
        for seed in range(chosen.draws):
            found, why = fitted(shape, seed)
            compare(shape, found, errors)
            last = ", ".join(f"{100 * e:+.2f} %" for e in errors.volume[-len(found.cells.rows) :])
            print(f"{shape.name}, draw {seed}: volume {last} {why}", file=sys.stderr, flush=True)
    rows = [*without_noise(), *rows_of(errors, chosen.draws)]
    print(table(rows))
    if chosen.page is not None:
        put_between(chosen.page, "measurements", table(rows))
    return 1 if any(row.passed is False for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
