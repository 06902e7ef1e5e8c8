"""The table of cells: everything that is measured on each cell."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..common.table import Table, Value, columns, notes, table_of
from ..geometry.border import cut_cells
from ..geometry.contacts import contact_areas, neighbours, wall_areas
from ..geometry.mesh import OUTSIDE
from .cells import measure_cells, moments, principal_axes
from .discrete_curvature import cell_curvature
from .known import Known
from .sides import Sides
from .standard_errors import error_columns
from .tensions import Estimate

CELL_COLUMNS = (
    *columns(
        """
        region: number of the cell in mesh and labels
        volume_um3: enclosed volume: sum over faces of signed tetrahedra
        area_um2: of its whole surface, walls to other cells included
        sphericity: pi^(1/3) (6 V)^(2/3) / A: area of the ball of the same volume over the area;
            1 for a ball
        centroid_z_um: centre of the volume
        centroid_y_um: centre of the volume
        centroid_x_um: centre of the volume
        n_contacts: number of other cells with which it shares a wall
        neighbours: their numbers, with spaces between
        contact_area_um2: area of its walls to other cells
        free_area_um2: area of its walls to the outside
        half_axis_1_um: longest half axis of the ellipsoid of equal second moments
        half_axis_2_um: the middle one
        half_axis_3_um: the shortest one
        axis_1_z: direction of the longest axis; its largest component is positive
        axis_1_y: direction of the longest axis
        axis_1_x: direction of the longest axis
        mean_curvature_integral_um: integral of (k1 + k2) / 2 over the surface: 1/2 sum over
            edges of length times turn of the normal (Steiner); ridges along junctions count; 4 pi r
            for a ball
        mean_curvature_per_um: this integral over the area; 1 / r for a ball
        gaussian_curvature_integral: integral of k1 k2: sum over vertices of 2 pi minus the
            angles there
        handles: holes through the cell, from Gauss and Bonnet: the number of its closed surfaces,
            minus that integral / (4 pi); 0 for a ball, 1 for a torus
        density: mean density of its membranes relative to that of all, by area
        pressure_per_um: above the outside, by Laplace's law over its walls, in mean tensions of
            the cluster
        """
    ),
    *error_columns("cells"),
    *columns(
        """
        cut_by_border: yes where it reaches the centres of the outermost voxels, else no
        explained: share of what varies around it that the fit explains
        grade: good, fair or poor: how good its shape is
        shape_error_um: what its surface is thought to be off by: noise, misfit, prior, what the
            model lacks
        note: why cells of this row are empty, and caveats
        """
    ),
)

_CUT = "the border of the image cuts it"


def cells_table(sides: Sides, known: Known, pressures: Mapping[int, Estimate]) -> Table:
    """Return a table with one row for each cell, ordered by region number."""
    cut = None if known.grid is None else cut_cells(sides.mesh, known.grid)
    parts = (
        measure_cells(sides.mesh),
        _axes(sides),
        _curvatures(sides),
        _contacts(sides),
        _densities(sides, known),
    )
    rows = []
    for region, *found in zip(sides.cells.tolist(), *parts, strict=True):
        row: dict[str, Value] = {}
        for part in found:
            row |= part
        pressure = pressures.get(region, Estimate())
        row["pressure_per_um"], row["pressure_se_per_um"] = pressure.value, pressure.error
        row["cut_by_border"] = None if cut is None else "yes" if region in cut else "no"
        row["explained"] = known.explained.get(region)
        judged = known.judgements.get(region)
        if judged is not None:
            row["grade"], row["shape_error_um"] = judged.grade, judged.shape_error_um
        row["note"] = notes(
            said := "" if judged is None else judged.reasons,
            _about_volume(row),
            _about_curvature(row),
            _CUT if row["cut_by_border"] == "yes" and _CUT not in said else "",
            _about_pressure(row, pressure),
        )
        rows.append(row)
    return table_of("cells", CELL_COLUMNS, rows)


def _about_volume(row: Mapping[str, Value]) -> str:
    volume = row["volume_um3"]
    known = isinstance(volume, float) and np.isfinite(volume)
    return "" if known else "no volume: its surface is open or inside out"


def _about_pressure(row: Mapping[str, Value], pressure: Estimate) -> str:
    if not pressure.reason:
        return ""
    return f"no pressure: {pressure.reason if row['n_contacts'] else 'it touches no other cell'}"


def _about_curvature(row: Mapping[str, Value]) -> str:
    return "" if row["handles"] is not None else "no curvature: its surface is open, or pinched"


def _axes(sides: Sides) -> list[dict[str, Value]]:
    axes, directions = principal_axes(moments(sides)[2])
    return [
        {
            **{f"half_axis_{k + 1}_um": float(a) for k, a in enumerate(half)},
            **{f"axis_1_{name}": float(d) for name, d in zip("zyx", way[0], strict=True)},
        }
        for half, way in zip(axes, directions, strict=True)
    ]


def _curvatures(sides: Sides) -> list[dict[str, Value]]:
    found = cell_curvature(sides)
    areas = sides.total(sides.mesh.areas()[sides.face])
    return [
        {
            "mean_curvature_integral_um": float(mean),
            "mean_curvature_per_um": float(mean / area) if area > 0 else None,
            "gaussian_curvature_integral": float(gaussian),
            "handles": round(parts - gaussian / (4 * np.pi)) if np.isfinite(gaussian) else None,
        }
        for mean, gaussian, parts, area in zip(
            found.mean, found.gaussian, found.parts.tolist(), areas, strict=True
        )
    ]


def _contacts(sides: Sides) -> list[dict[str, Value]]:
    others, areas = neighbours(sides.mesh), wall_areas(sides.mesh)
    shared = dict.fromkeys(others, 0.0)
    for pair, area in contact_areas(sides.mesh).items():
        for cell in pair:
            shared[cell] += area
    return [
        {
            "neighbours": " ".join(map(str, others[cell])),
            "contact_area_um2": shared[cell],
            "free_area_um2": areas.get((OUTSIDE, cell), 0.0),
        }
        for cell in sides.cells.tolist()
    ]


def _densities(sides: Sides, known: Known) -> list[dict[str, Value]]:
    if known.density is None:
        return [{"density": None} for _ in sides.cells]
    areas = sides.mesh.areas()[sides.face]
    total = sides.total(areas * known.density[sides.face])
    area = sides.total(areas)
    mean = total.sum() / area.sum()
    share = np.divide(total, area * mean, out=np.full(len(area), np.nan), where=area * mean > 0)
    return [{"density": float(d)} for d in share]
