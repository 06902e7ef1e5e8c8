"""Thin dents of cells: what a surface makes of something bright inside, near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid
from .cell_voxels import cell_voxels
from .outgrowths import RULES as OUTGROWTHS


@dataclass(frozen=True)
class DentRules:
    """What counts as one; in widths of the PSF, axis by axis, but at least in voxels.

    Attributes
    ----------
    thin
        Half its thickness, at most: as of an outgrowth.
    depth
        How deep in the cell it ends, at least; as an outgrowth is long. Measured: up to 1.2 in some
        200 simulated cells that are right (benchmarks.defaults); 4.6 to 6.4 in ten cells whose
        surfaces had been drawn onto bright spots inside.
    """

    thin: float = OUTGROWTHS.thin
    depth: float = OUTGROWTHS.length


RULES = DentRules()


def dents(mesh: Mesh, grid: Grid, optics: Optics) -> dict[int, tuple[float, float, float]]:
    """Where the deepest thin dent of each cell ends, um, Z Y X; cells without are left out.

    Vertices deep inside of the cell once all that is thin is filled: a dent may be thinner than a
    voxel.
    """
    spacing = np.minimum(np.asarray(grid.voxel_size) / np.asarray(optics.sigma_um), 1.0)
    rim = int(np.ceil(2 * RULES.thin / spacing.min())) + 1
    places, ends = mesh.vertices_numpy(), dict[int, tuple[float, float, float]]()
    for cell in cell_voxels(mesh, grid, rim):
        around = distance_transform_edt(~cell.own, sampling=spacing) > RULES.thin
        filled = cell.own | (distance_transform_edt(~around, sampling=spacing) > RULES.thin)
        depth = distance_transform_edt(filled, sampling=spacing)
        vertices = np.unique(mesh.faces[(mesh.regions == cell.region).any(axis=1)])
        inside = cell.at(depth, places[vertices])
        if inside.max() >= RULES.depth:
            z, y, x = places[vertices[inside.argmax()]].tolist()
            ends[cell.region] = z, y, x
    return ends
