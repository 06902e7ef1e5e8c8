"""Clusters whose shape is known, fitted from their own rendered images."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.joined_spheres import joined_spheres
from napari_deltamic import FitState, GaussianPSF, Grid, Mesh, fit, load_mesh, render
from napari_deltamic.geometry.contacts import contacts
from napari_deltamic.geometry.foam import foam
from napari_deltamic.measure import junction_angles, surface_distance
from napari_deltamic.runs.settings import FitSettings

from ..figure import Figure, MissingData, Options, Row, at_most

LEVELS = (2.0, 1.35, 1.0)
PHOTONS = 40.0  # at the peak, where there is noise

# The double bubble: voxels of 1 um.
GRID, SIGMA = Grid((48, 48, 64), (1.0, 1.0, 1.0)), 1.5
RADIUS, CENTER, EDGE = 15.0, np.array([23.5, 23.7, 31.3]), 2.0


@dataclass(frozen=True)
class Fitted:
    """The end of a fit, and how long it took."""

    state: FitState
    seconds: float


def run(image: NDArray[np.float64], grid: Grid, start: Mesh, sigma: float) -> Fitted:
    """A fit from a start near the truth."""
    begun = time.perf_counter()
    *_, last = fit(image, grid, start, GaussianPSF(sigma), settings=FitSettings(levels=LEVELS))
    return Fitted(last, time.perf_counter() - begun)


def measured(truth: Mesh, grid: Grid, sigma: float, photons: float, seed: int) -> NDArray:
    """Its image, of the given photons at the peak; without noise where they are infinite."""
    image = np.maximum(render(truth, grid, GaussianPSF(sigma), 1e-4).numpy(), 0).astype(float)
    image /= image.max()
    if np.isinf(photons):
        return image
    return np.random.default_rng(seed).poisson(photons * image).astype(float)


def bubble(seed: int = 0) -> tuple[Mesh, Mesh]:
    """The double bubble, and two smaller spheres a little elsewhere."""
    half = np.array([0, 0, RADIUS / 2])
    moved = np.random.default_rng(seed).normal(0, 1.5, (2, 3))
    start = foam(np.stack([CENTER - half, CENTER + half]) + moved, np.full(2, 14.0), EDGE)
    return joined_spheres(CENTER, (RADIUS, RADIUS), RADIUS, 1.2), start


def double_bubble(options: Options) -> list[Row]:
    """Junction angles of the double bubble, without noise and with it."""
    truth, start = bubble()
    rows = []
    for photons in (np.inf, PHOTONS):
        fitted = run(measured(truth, GRID, SIGMA, photons, 0), GRID, start, SIGMA)
        (junction,) = junction_angles(fitted.state.mesh)
        angles = ", ".join(f"{a:.1f}" for a in junction.angles)
        error = surface_distance(fitted.state.mesh, truth).mean
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
    truth = truth.translated(-(low + high) / 2).scaled(60 / float((high - low).max()))
    truth = truth.translated((39.5,) * 3)
    grid, sigma = Grid((80, 80, 80), (1.0, 1.0, 1.0)), 2.0
    regions = truth.region_ids()
    centers = np.array([_centroid(truth, int(r)) for r in regions])
    radii = np.cbrt([3 * truth.region_volume(int(r)) / (4 * np.pi) for r in regions])
    # Spheres of a cell's volume leave gaps: a tenth more makes neighbours share a wall.
    start = foam(centers, 1.1 * radii, 3.0)
    rows = []
    for photons in (np.inf, PHOTONS):
        fitted = run(measured(truth, grid, sigma, photons, 0), grid, start, sigma)
        case = "no noise" if np.isinf(photons) else f"{photons:g} photons at the peak"
        right = contacts(fitted.state.mesh) == contacts(truth)
        name = f"cell4.rec at sigma of 2 voxels, mean surface error, {case}"
        error = surface_distance(fitted.state.mesh, truth).mean
        note = (
            f"{'every contact right' if right else 'contacts differ'}, "
            f"{fitted.seconds:.1f} s, {fitted.state.iteration} iterations"
        )
        if np.isinf(photons):
            rows.append(at_most(name, 0.1, error, "voxel", note))
        else:
            rows.append(Row(name, "", error, "voxel", None, note))
    return rows


def _centroid(mesh: Mesh, region: int) -> NDArray[np.float64]:
    surface = mesh.region_surface(region)
    corners = surface.vertices_numpy()[surface.faces]
    weight = surface.signed_volumes()
    return weight @ corners.sum(1) / (4 * weight.sum())


FIGURES: dict[str, Figure] = {"double bubble": double_bubble, "cell4": cell4}
