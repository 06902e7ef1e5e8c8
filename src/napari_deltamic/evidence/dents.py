"""Thin dents of cells, which surfaces form towards something bright inside the cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.distance_transform import distance_transform
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid
from .cell_voxels import cell_voxels
from .outgrowths import RULES as OUTGROWTHS


@dataclass(frozen=True)
class DentRules:
    """What counts as a dent; in widths of the PSF along each axis, but at least a voxel each.

    Attributes
    ----------
    thin
        Largest half thickness: as for an outgrowth.
    depth
        Least depth in the cell at which it ends: as the length of an outgrowth. Measured: up to 1.2
        in some 200 simulated cells that are right (benchmarks.defaults); 4.6 to 6.4 in ten cells
        whose surfaces had been drawn onto bright spots inside.
    wall
        Area of both sides deeper than ``thin``, widths squared, from which on it may follow a wall:
        as for a fin. Measured: 109 in a cell whose label held two, 2 to 11 in three others with
        dents.
    """

    thin: float = OUTGROWTHS.thin
    depth: float = OUTGROWTHS.length
    wall: float = OUTGROWTHS.fin


RULES = DentRules()


@dataclass(frozen=True)
class Dent:
    """A thin dent.

    Attributes
    ----------
    end
        Where it ends, um, Z Y X.
    wall
        Whether it is as wide as where a wall between two cells draws the surface in.
    """

    end: tuple[float, float, float]
    wall: bool = False


def dents(mesh: Mesh, grid: Grid, optics: Optics) -> dict[int, Dent]:
    """The deepest thin dent of each cell; cells without one are left out.

    It is found by vertices that lie deep inside the cell once everything thin is filled, since a
    dent may be thinner than a voxel.
    """
    size = np.asarray(grid.voxel_size)
    spacing = np.minimum(size / np.asarray(optics.sigma_um), 1.0)
    rim = int(np.ceil(2 * RULES.thin / spacing.min())) + 1
    places, faces, found = mesh.vertices_numpy(), mesh.faces_by_region(), dict[int, Dent]()
    for cell in cell_voxels(mesh, grid, rim):
        around = distance_transform(~cell.own, spacing) > RULES.thin
        filled = cell.own | (distance_transform(~around, spacing) > RULES.thin)
        depth = distance_transform(filled, spacing)
        own = mesh.faces[faces[cell.region]]
        vertices = np.unique(own)
        inside = cell.at(depth, places[vertices])
        if inside.max() >= RULES.depth:
            z, y, x = places[vertices[inside.argmax()]].tolist()
            corners = places[own]
            deep = cell.at(depth, corners.mean(1)) > RULES.thin
            a, b, c = np.moveaxis(corners[deep] * spacing / size, 1, 0)
            area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
            found[cell.region] = Dent((z, y, x), area >= RULES.wall)
    return found
