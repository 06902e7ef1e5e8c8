"""Thin outgrowths of cells, which surfaces form towards bright specks or neighbours beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from ..geometry.distance_transform import distance_transform
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid
from .cell_voxels import CellVoxels, cell_voxels, voxels_at


@dataclass(frozen=True)
class OutgrowthRules:
    """What counts as an outgrowth; lengths in widths of the PSF along each axis.

    Attributes
    ----------
    share
        Largest share of the cell's volume that is thin: a flat cell has more than this.
    thin
        Largest half thickness: the image shows little of what is thinner.
    length
        Least length out of the cell. Measured on 183 random scenes (``--anything`` of
        benchmarks.defaults): up to 2.0 where the error was below 0.3 voxel, but 4.5 to 6.6 in three
        of those; 2.6 to 22 in eight cells of five scenes that were 0.5 to 0.9 voxel off, one of
        which no other check found.
    fin
        Least area of both sides that reaches out as far, widths squared: parts thinner than a voxel
        hold no centre of one. Measured on 772 cells of 109 simulated scenes: 74 and 94 in two cells
        that had grown along a wall of cells without labels, 66 in a cell 0.6 voxel off; up to 32 in
        those within 0.2 voxel, including edges along which three cells meet, but 55 and 73 in two
        where slices were shifted.
    sheet
        Largest mean thickness of a fin. Measured: 0.12 and 0.21 in those two; 0.26 or more in right
        cells that have as much beyond, which are flat there or have arms.
    usual
        Least ratio to the median over all cells, for lengths and for fins. Chosen: in an embryo of
        56 cells the median length is 3.5, as walls between cells end in sharp edges there, and only
        one cell reaches out twice as far.
    crowd
        Fewest cells whose median tells what is usual. Chosen.
    """

    share: float = 0.3
    thin: float = 1.5
    length: float = 2.3
    fin: float = 60.0
    sheet: float = 0.25
    usual: float = 2.0
    crowd: int = 5


RULES = OutgrowthRules()
Place = tuple[float, float, float]


def outgrowths(mesh: Mesh, grid: Grid, optics: Optics) -> dict[int, Place]:
    """Where the longest thin outgrowth of each cell ends, um, Z Y X; only cells that have one.

    Cells that are thin as a whole have none, nor do cells that reach out no further than usual.
    """
    spacing = np.asarray(grid.voxel_size) / np.asarray(optics.sigma_um)
    rim = int(np.ceil((RULES.thin + RULES.length) / spacing.min())) + 1
    sides, faces = _Sides(mesh, grid, optics), mesh.faces_by_region()
    reaches, fins = dict[int, float](), dict[int, float]()
    tips, edges = dict[int, Place](), dict[int, Place]()
    for cell in cell_voxels(mesh, grid, rim):
        thick = distance_transform(cell.own, spacing) > RULES.thin
        if not thick.any():
            continue
        away = distance_transform(~thick, spacing) - RULES.thin
        out = np.where(cell.own, away, 0.0)
        if (out > 0).sum() > RULES.share * cell.own.sum():
            continue
        region, at = cell.region, np.unravel_index(int(out.argmax()), out.shape)
        z, y, x = (
            (np.asarray(at) + cell.first) * np.asarray(grid.voxel_size) + np.asarray(grid.origin)
        ).tolist()
        reaches[region], tips[region] = float(out.max()), (z, y, x)
        volume = float((out > RULES.length).sum() * np.prod(spacing))
        fins[region], edges[region] = sides.beyond(cell, away, faces[region], volume)
    far = {r: tips[r] for r in _unusual(reaches, RULES.length)}
    return {r: edges[r] for r in _unusual(fins, RULES.fin)} | far


class _Sides:
    """Middles of all triangles, and areas (widths squared; 0 for those outside of the image)."""

    def __init__(self, mesh: Mesh, grid: Grid, optics: Optics) -> None:
        corners = mesh.vertices_numpy()[mesh.faces]
        self.middles = corners.mean(1)
        a, b, c = np.moveaxis(corners / np.asarray(optics.sigma_um), 1, 0)
        index = voxels_at(self.middles, grid)
        shown = ((index >= 0) & (index < np.asarray(grid.shape))).all(1)
        self.areas = np.where(shown, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2, 0.0)

    def beyond(
        self,
        cell: CellVoxels,
        away: NDArray[np.floating],
        faces: NDArray[np.signedinteger],
        volume: float,
    ) -> tuple[float, Place]:
        """Area of a cell that reaches out like outgrowths, widths squared, and its far end, um.

        The area is 0 if the enclosed ``volume`` is too large for a thin sheet.
        """
        middles = self.middles[faces]
        far = np.where(self.areas[faces] > 0, cell.at(away, middles), 0.0)
        z, y, x = middles[far.argmax()].tolist()
        area = float(self.areas[faces][far > RULES.length].sum())
        return (area if 2 * volume <= RULES.sheet * area else 0.0), (z, y, x)


def _unusual(values: Mapping[int, float], least: float) -> list[int]:
    """Regions with a value of at least ``least`` that is unusual among all of them."""
    usual = median(values.values()) if len(values) >= RULES.crowd else 0.0
    bound = max(least, RULES.usual * usual)
    return [region for region, value in values.items() if value >= bound]
