"""Tensions of a cluster at rest that were put in, and that come out of a fit to its image.

``python -m benchmarks.tensions --page docs/measurements.md``. Every wall of a few cells has a
tension of its own. Their shape is brought to rest: the sum of tensions times areas falls as far as
it can at fixed volumes. It is rendered with 40 photons, fitted from its labels as `fit` does, and
the tensions are read from the angles.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

import napari_deltamic as nd
from napari_deltamic.fitting.job import assemble, start
from napari_deltamic.geometry import mesh_from_labels
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import remesh
from napari_deltamic.measure import Measurements, measure
from napari_deltamic.measure.junctions import junction_lengths
from napari_deltamic.measure.of_fit import known_of
from napari_deltamic.measure.tensions import walls_around
from napari_deltamic.runs.settings import RunSettings, SceneSettings

from .figure import Row, at_most
from .page import put_between, table

VOXEL, SIGMA, PHOTONS = 0.2, 0.26, 40.0
RADIUS, AWAY = 2.4, 2.1  # um; of the spheres, and of their centres from the middle
EDGES = (0.5, 0.4, 0.3, 0.3)  # um; of the meshes that come to rest, one after the other
STEPS = 600  # of each
STIFF = 100.0  # of volumes: tensions over um
LONG = 3.0  # PSF widths; shorter junctions do not count
Pair = tuple[int, int]
Floats = NDArray[np.float64]


def cluster() -> nd.Mesh:
    """Four cells, each of which touches the three others."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    return foam(AWAY * corners, np.full(4, RADIUS), EDGES[0])


def tensions_of(mesh: nd.Mesh, seed: int) -> dict[Pair, float]:
    """1 for walls to the outside, 0.6 to 1.4 between cells."""
    rng = np.random.default_rng(seed)
    pairs = [(a, b) for a, b in mesh.interfaces()[0].tolist()]
    return {pair: 1.0 if pair[1] == 0 else float(rng.uniform(0.6, 1.4)) for pair in pairs}


def at_rest(mesh: nd.Mesh, tensions: dict[Pair, float]) -> nd.Mesh:
    """The mesh with the least sum of tensions times areas at its volumes."""
    wanted = np.array(list(mesh.volumes().values()))
    for edge in EDGES:
        mesh = remesh(mesh, edge).mesh
        mesh = mesh.with_vertices(_minimised(mesh, tensions, wanted))
    return mesh


def _minimised(mesh: nd.Mesh, tensions: dict[Pair, float], wanted: Floats) -> Floats:
    faces, regions = mesh.faces, mesh.regions
    pairs, wall = mesh.interfaces()
    pull = np.array([tensions.get((a, b), 1.0) for a, b in pairs.tolist()])[wall]
    ids = mesh.region_ids()
    sign = (regions[:, :1] == ids).astype(float) - (regions[:, 1:] == ids)  # (F, C)

    def energy(flat: Floats) -> tuple[float, Floats]:
        v = flat.reshape(-1, 3)
        p, q, r = (v[faces[:, k]] for k in range(3))
        normal = np.cross(q - p, r - p)
        twice = np.linalg.norm(normal, axis=1)
        unit = normal / np.maximum(twice, 1e-12)[:, None]
        # Z, Y, X components are left-handed: hence the signs.
        volumes = -np.einsum("fc,fi,fi->c", sign, p, np.cross(q, r)) / 6
        off = volumes - wanted
        inward = -(sign @ (STIFF * off))[:, None] / 6
        gradient = np.zeros_like(v)
        for k, (b, c) in enumerate(((q, r), (r, p), (p, q))):
            each = 0.5 * pull[:, None] * np.cross(unit, c - b) + inward * np.cross(b, c)
            np.add.at(gradient, faces[:, k], each)
        value = float(pull @ twice) / 2 + STIFF / 2 * float(off @ off)
        return value, gradient.reshape(-1)

    begin = mesh.vertices_numpy().reshape(-1)
    found = minimize(energy, begin, jac=True, method="L-BFGS-B", options={"maxiter": STEPS})
    return np.asarray(found.x).reshape(-1, 3)


def fitted(truth: nd.Mesh, seed: int) -> Measurements:
    """What is measured on a fit to one noisy image."""
    low, high = truth.bounds()
    size = np.ceil((high - low + 8 * SIGMA) / VOXEL).astype(int)
    z, y, x = (int(n) for n in size)
    grid = nd.Grid((z, y, x), (VOXEL,) * 3)
    mesh = truth.translated((size - 1) * VOXEL / 2 - (low + high) / 2)
    scene = nd.Scene((nd.Surface(mesh),), nd.GaussianPSF((SIGMA,) * 3))
    made = nd.simulate(scene, grid, photons=PHOTONS, seed=seed, accuracy=1e-4)
    assert made.labels is not None
    begin = mesh_from_labels(made.labels, grid.voxel_size, grid.origin)
    known = SceneSettings(voxel_size=grid.voxel_size, sigma=(SIGMA,) * 3)
    job = assemble(RunSettings(image="", seeds="", scene=known), made.image, grid, begin, "labels")
    *_, last = start(job)
    return measure(last.mesh, known_of(last, grid))


def compared(found: Measurements, truth: nd.Mesh, tensions: dict[Pair, float]) -> Floats:
    """Relative errors of the walls that have a junction long enough, with equal means."""
    long = {
        pair
        for regions, length in junction_lengths(truth).items()
        if length > LONG * SIGMA
        for pair in walls_around(regions)
    }
    rows = [
        (float(row["tension"]), tensions[pair])
        for row in found.walls.rows
        if isinstance(row["tension"], float)
        and (pair := (row["region_a"], row["region_b"])) in tensions
        and pair in long
    ]
    measured, exact = np.array(rows).T
    return np.asarray(measured / measured.mean() * exact.mean() / exact - 1)


def rows(draws: int) -> list[Row]:
    """The bars."""
    begin = cluster()
    tensions = tensions_of(begin, 0)
    truth = at_rest(begin, tensions)
    clean = compared(measure(truth), truth, tensions)
    noisy = [compared(fitted(truth, seed), truth, tensions) for seed in range(draws)]
    off = np.concatenate(noisy)
    words = f"{len(clean)} walls of 4 cells, tensions of 0.6 to 1.4"
    note = f"{len(off)} walls in {draws} draws of noise, largest {100 * np.abs(off).max():.1f} %"
    return [
        Row("cluster at rest: rms error, no image", "-", 100 * _rms(clean), "%", None, words),
        at_most("cluster at rest: rms error of tensions", 5.0, 100 * _rms(off), "%", note),
    ]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tensions", description=__doc__)
    parser.add_argument("--draws", type=int, default=2, help="of noise")
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    found = rows(chosen.draws)
    print(table(found))
    if chosen.page is not None:
        put_between(chosen.page, "tensions", table(found))
    return 1 if any(row.passed is False for row in found) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
