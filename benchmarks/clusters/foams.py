"""Foams of cells, rendered with noise and fitted from spheres around shifted centres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import GaussianPSF, Grid, Mesh, render
from napari_deltamic.geometry.contacts import wall_areas
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.measure import surface_distance
from napari_deltamic.results.picture import picture

from ..default_command import fitted
from ..figure import Figure, Options, Row, at_least, at_most

CELLS = (4, 8, 16, 32)
SHOWN = 16  # in the picture
SIDES = {4: 56, 8: 64, 16: 88, 32: 104}  # voxels of 1 um
RADIUS, SIGMA, PHOTONS = 11.0, 1.5, 40.0
SHIFT = 1.0  # um, standard deviation of the centres' shift along each axis
TRUE_EDGE, EDGE = 2.0, 2.5


@dataclass(frozen=True)
class Scene:
    """What is known, what is seen, and where the fit starts: spheres (cells, 4), z y x radius."""

    truth: Mesh
    image: NDArray[np.float64]
    grid: Grid
    spheres: NDArray[np.float64]

    @property
    def start(self) -> Mesh:
        """The cells that spheres make where they overlap."""
        return foam(self.spheres[:, :3], self.spheres[:, 3], EDGE)


def scene(cells: int, seed: int = 0) -> Scene:
    """A clump of cells of one size; their image; spheres a little smaller, a little elsewhere."""
    side = SIDES[cells]
    centers = clump(cells, side, seed)
    truth = foam(centers, np.full(cells, RADIUS), TRUE_EDGE)
    grid = Grid((side,) * 3, (1.0,) * 3)
    image = render(truth, grid, GaussianPSF(SIGMA), 1e-4).numpy().clip(0)
    photons = 2 + PHOTONS * image / image.max()
    noisy = np.random.default_rng(seed + 1).poisson(photons).astype(np.float64)
    moved = centers + np.random.default_rng(seed + 2).normal(0, SHIFT, centers.shape)
    return Scene(truth, noisy, grid, np.column_stack([moved, np.full(cells, RADIUS - 1)]))


def clump(cells: int, side: int, seed: int) -> NDArray[np.float64]:
    """(cells, 3) centres that overlap with their neighbours, in the middle of a cube."""
    rng = np.random.default_rng(seed)
    centers = side / 2 + rng.normal(size=(cells, 3)) * side / 8
    for _ in range(200):
        apart = centers[:, None] - centers[None]
        distance = np.linalg.norm(apart, axis=-1) + 100 * np.eye(cells)
        push = np.clip(1.5 * RADIUS - distance, 0, None) / distance
        centers += 0.2 * (apart * push[..., None]).sum(1)
        centers -= 0.01 * (centers - centers.mean(0))
    return np.asarray(centers - centers.mean(0) + (side - 1) / 2)


def foam_rows(cells: int, options: Options) -> list[Row]:
    """Cells found, error of the surface, contacts and overlap."""
    known = scene(cells)
    outcome = fitted(known.image, known.grid.voxel_size, known.spheres)
    found = outcome.mesh
    if options.pictures is not None and cells == SHOWN:
        drawn = picture(known.image, outcome.rendered, found, known.grid)
        drawn.savefig(options.pictures / "clusters_foam.png")
    here, there = (
        voxel_labels(mesh, known.grid.shape, known.grid.voxel_size) for mesh in (known.truth, found)
    )
    names = known.truth.region_ids()
    names = names[names > 0]
    dice = [
        2 * ((here == k) & (there == k)).sum() / ((here == k).sum() + (there == k).sum())
        for k in names
    ]
    areas, own = wall_areas(known.truth), wall_areas(found)
    missing, extra = areas.keys() - own.keys(), own.keys() - areas.keys()
    name = f"foam of {cells}"
    small = ", ".join(f"{areas[pair]:.0f}" for pair in sorted(missing)) or "none"
    return [
        at_least(f"{name}, cells found", cells, int((np.array(dice) > 0.5).sum()), ""),
        at_most(
            f"{name}, mean surface error",
            0.15,
            surface_distance(found, known.truth).mean,
            "voxel",
            outcome.note,
        ),
        at_most(
            f"{name}, contacts wrong",
            0,
            len(missing) + len(extra),
            f"of {len(areas)}",
            f"areas of the missing ones (um^2): {small}; extra: {len(extra)}",
        ),
        at_least(f"{name}, mean Dice", 0.98, float(np.mean(dice)), "", f"least {np.min(dice):.4f}"),
    ]


def foams(options: Options) -> list[Row]:
    """All sizes."""
    return [
        row
        for cells in (CELLS[:2] if options.quick else CELLS)
        for row in foam_rows(cells, options)
    ]


FIGURES: dict[str, Figure] = {"foams": foams}
