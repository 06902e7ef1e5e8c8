"""The table of cells: everything that is measured on each."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from napari_deltamic.geometry.contacts import neighbours
from napari_deltamic.geometry.mesh import OUTSIDE
from napari_deltamic.measure.cells import measure_cells, moments, principal_axes
from napari_deltamic.measure.discrete_curvature import cell_curvature, turning_gradient
from napari_deltamic.measure.known import Known, area_gradient, volume_gradient
from napari_deltamic.measure.sides import Sides
from napari_deltamic.measure.table import Column, Table, Value, notes, table_of
from napari_deltamic.measure.tensions import Estimate

CELL_COLUMNS = (
    Column("region", "", "number of the cell in mesh and labels"),
    Column("volume_um3", "um^3", "enclosed volume: sum over faces of signed tetrahedra"),
    Column("area_um2", "um^2", "of its whole surface, walls to other cells included"),
    Column(
        "sphericity",
        "",
        "pi^(1/3) (6 V)^(2/3) / A: area of the ball of the same volume over the area; 1 for a ball",
    ),
    Column("centroid_z_um", "um", "centre of the volume"),
    Column("centroid_y_um", "um", "centre of the volume"),
    Column("centroid_x_um", "um", "centre of the volume"),
    Column("n_contacts", "", "number of other cells with which it shares a wall"),
    Column("neighbours", "", "their numbers, with spaces between"),
    Column("contact_area_um2", "um^2", "area of its walls to other cells"),
    Column("free_area_um2", "um^2", "area of its walls to the outside"),
    Column("half_axis_1_um", "um", "longest half axis of the ellipsoid of equal second moments"),
    Column("half_axis_2_um", "um", "the middle one"),
    Column("half_axis_3_um", "um", "the shortest one"),
    Column("axis_1_z", "", "direction of the longest axis; its largest component is positive"),
    Column("axis_1_y", "", "direction of the longest axis"),
    Column("axis_1_x", "", "direction of the longest axis"),
    Column(
        "mean_curvature_integral_um",
        "um",
        "integral of (k1 + k2) / 2 over the surface: 1/2 sum over edges of length times turn of "
        "the normal (Steiner); ridges along junctions count; 4 pi r for a ball",
    ),
    Column("mean_curvature_per_um", "1/um", "this integral over the area; 1 / r for a ball"),
    Column(
        "gaussian_curvature_integral",
        "",
        "integral of k1 k2: sum over vertices of 2 pi minus the angles there",
    ),
    Column(
        "handles",
        "",
        "holes through the cell, from Gauss and Bonnet: 1 - that integral / (4 pi); 0 for a ball, "
        "1 for a torus",
    ),
    Column("density", "", "mean density of its membranes relative to that of all, by area"),
    Column(
        "pressure_per_um",
        "1/um",
        "above the outside, by Laplace's law over its walls, in mean tensions of the cluster",
    ),
    Column("pressure_se_per_um", "1/um", "standard error of the pressure"),
    Column("volume_se_um3", "um^3", "standard error of the volume, from the fit"),
    Column("area_se_um2", "um^2", "standard error of the area, from the fit"),
    Column("sphericity_se", "", "standard error of the sphericity, from the fit"),
    Column(
        "mean_curvature_se_per_um", "1/um", "standard error of the mean curvature, from the fit"
    ),
    Column("cut_by_border", "", "yes where it reaches beyond the outermost voxels, else no"),
    Column("explained", "", "share of what varies around it that the fit explains"),
    Column("note", "", "why cells of this row are empty, and what to mind"),
)


def cells_table(sides: Sides, known: Known, pressures: Mapping[int, Estimate]) -> Table:
    """One row for each cell, by region number."""
    cut = known.cut(sides)
    parts = (
        measure_cells(sides.mesh),
        _axes(sides),
        _curvatures(sides),
        _contacts(sides),
        _densities(sides, known),
        _errors(sides, known),
    )
    rows = []
    for k, (region, *found) in enumerate(zip(sides.cells.tolist(), *parts, strict=True)):
        row: dict[str, Value] = {}
        for part in found:
            row |= part
        pressure = pressures.get(region, Estimate())
        row["pressure_per_um"], row["pressure_se_per_um"] = pressure.value, pressure.error
        row["cut_by_border"] = None if cut is None else "yes" if cut[k] else "no"
        row["explained"] = known.explained.get(region)
        row["note"] = notes(
            _about_volume(row),
            _about_curvature(row),
            "cut by the border of the image" if cut is not None and cut[k] else "",
            f"no pressure: {pressure.reason}" if pressure.reason else "",
            known.doubts.get(region, ""),
        )
        rows.append(row)
    return table_of("cells", CELL_COLUMNS, rows)


def _about_volume(row: Mapping[str, Value]) -> str:
    volume = row["volume_um3"]
    known = isinstance(volume, float) and np.isfinite(volume)
    return "" if known else "no volume: its surface is open or inside out"


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
            "handles": round(1 - gaussian / (4 * np.pi)) if np.isfinite(gaussian) else None,
        }
        for mean, gaussian, area in zip(found.mean, found.gaussian, areas, strict=True)
    ]


def _contacts(sides: Sides) -> list[dict[str, Value]]:
    mesh = sides.mesh
    inner = (mesh.regions != OUTSIDE).all(1)
    areas = mesh.areas()[sides.face]
    shared = sides.total(np.where(inner[sides.face], areas, 0.0))
    free = sides.total(np.where(inner[sides.face], 0.0, areas))
    others = neighbours(mesh)
    return [
        {
            "neighbours": " ".join(map(str, others[int(cell)])),
            "contact_area_um2": float(contact),
            "free_area_um2": float(outer),
        }
        for cell, contact, outer in zip(sides.cells, shared, free, strict=True)
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


def _errors(sides: Sides, known: Known) -> list[dict[str, Value]]:
    if known.deviation is None:
        return [{} for _ in sides.cells]
    bends = cell_curvature(sides).mean
    volumes, areas = moments(sides)[0], sides.total(sides.mesh.areas()[sides.face])
    rows: list[dict[str, Value]] = []
    for k, (volume, area) in enumerate(zip(volumes, areas, strict=True)):
        faces = np.zeros(len(sides.mesh.faces), bool)
        faces[sides.face[sides.cell == k]] = True
        of_area = area_gradient(sides.mesh, faces)
        row: dict[str, Value] = {"area_se_um2": known.deviation(of_area)}
        if np.isfinite(bends[k]) and area > 0:
            of_bend = turning_gradient(sides, k) / area - bends[k] / area**2 * of_area
            row["mean_curvature_se_per_um"] = known.deviation(of_bend)
        if np.isfinite(volume):
            of_volume = volume_gradient(sides, k)
            relative = 2 / 3 * of_volume / volume - of_area / area
            ratio = np.pi ** (1 / 3) * (6 * volume) ** (2 / 3) / area
            row["volume_se_um3"] = known.deviation(of_volume)
            row["sphericity_se"] = known.deviation(ratio * relative)
        rows.append(row)
    return rows
