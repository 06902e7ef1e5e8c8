"""Clusters whose shape is known, fitted from their own rendered images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.joined_spheres import joined_spheres
from benchmarks.shapes import scaled
from napari_deltamic import GaussianPSF, Grid, Mesh, load_mesh, render
from napari_deltamic.geometry.contacts import contacts
from napari_deltamic.measure import junction_angles, surface_distance
from napari_deltamic.tracking.alarms import looks

from ..default_command import fitted
from ..figure import Figure, MissingData, Options, Row, at_most

PHOTONS = 40.0  # at the peak, where there is noise

# The double bubble: voxels of 1 um.
GRID, SIGMA = Grid((48, 48, 64), (1.0, 1.0, 1.0)), 1.5
RADIUS, CENTER = 15.0, np.array([23.5, 23.7, 31.3])


def measured(truth: Mesh, grid: Grid, sigma: float, photons: float, seed: int) -> NDArray:
    """Its image, of the given photons at the peak; without noise where they are infinite."""
    image = np.maximum(render(truth, grid, GaussianPSF(sigma), 1e-4).numpy(), 0).astype(float)
    image /= image.max()
    if np.isinf(photons):
        return image
    return np.random.default_rng(seed).poisson(photons * image).astype(float)


def bubble(seed: int = 0) -> tuple[Mesh, NDArray[np.float64]]:
    """The double bubble, and two smaller spheres (2, 4) a little elsewhere: z y x radius."""
    half = np.array([0, 0, RADIUS / 2])
    moved = np.random.default_rng(seed).normal(0, 1.5, (2, 3))
    centers = np.stack([CENTER - half, CENTER + half]) + moved
    spheres = np.column_stack([centers, np.full(2, 14.0)])
    return joined_spheres(CENTER, (RADIUS, RADIUS), RADIUS, 1.2), spheres


def double_bubble(options: Options) -> list[Row]:
    """Junction angles of the double bubble, without noise and with it."""
    truth, start = bubble()
    rows = []
    for photons in (np.inf, PHOTONS):
        found = fitted(measured(truth, GRID, SIGMA, photons, 0), GRID.voxel_size, start).mesh
        (junction,) = junction_angles(found)
        angles = ", ".join(f"{a:.1f}" for a in junction.angles)
        error = surface_distance(found, truth).mean
        case = "no noise" if np.isinf(photons) else f"{photons:g} photons at the peak"
        rows.append(
            at_most(
                f"double bubble, junction angles from 120, {case}",
                2.0,
                float(np.abs(junction.angles - 120).max()),
                "degrees",
                f"{angles} (outside, cells); along the junction +- {junction.spread.max():.1f}; "
                f"surface error {error:.3f} voxel",
            )
        )
    return rows


def cell4(options: Options) -> list[Row]:
    """The four-cell embryo of the paper's authors, from four spheres."""
    path = options.data / "multimaterial" / "deltamic__cell4.rec"
    if not path.is_file():
        raise MissingData(f"no {path.name} in {path.parent} (DELTAMIC_DATA names the folder)")
    truth = load_mesh(path)
    low, high = truth.bounds()
    truth = scaled(truth.translated(-(low + high) / 2), 60 / float((high - low).max()))
    truth = truth.translated((39.5,) * 3)
    grid, sigma = Grid((80, 80, 80), (1.0, 1.0, 1.0)), 2.0
    cells = looks(truth).values()
    # Spheres of a cell's volume leave gaps: a tenth more makes neighbours share a wall.
    spheres = np.array([[*cell.center, 1.1 * cell.radius] for cell in cells])
    rows = []
    for photons in (np.inf, PHOTONS):
        outcome = fitted(measured(truth, grid, sigma, photons, 0), grid.voxel_size, spheres)
        case = "no noise" if np.isinf(photons) else f"{photons:g} photons at the peak"
        right = contacts(outcome.mesh) == contacts(truth)
        name = f"cell4.rec at sigma of 2 voxels, mean surface error, {case}"
        error = surface_distance(outcome.mesh, truth).mean
        note = f"{'every contact right' if right else 'contacts differ'}, {outcome.note}"
        if np.isinf(photons):
            rows.append(at_most(name, 0.1, error, "voxel", note))
        else:
            rows.append(Row(name, "", error, "voxel", None, note))
    return rows


FIGURES: dict[str, Figure] = {"double bubble": double_bubble, "cell4": cell4}
