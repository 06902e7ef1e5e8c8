"""The tables of walls and of junctions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..common.table import Table, Value, columns, notes, table_of
from ..geometry.mesh import OUTSIDE, Mesh
from .discrete_curvature import WallCurvature
from .junctions import Junction, junction_lengths
from .known import Known
from .standard_errors import error_columns
from .tensions import Estimate, Pair, walls_around

WALL_COLUMNS = (
    *columns(
        """
        region_a: one of its two cells: that of the larger number
        region_b: the other one; 0 is the outside
        area_um2: of the wall, once, also where it is two membranes
        share_of_a: this area over the whole area of region_a
        share_of_b: the same for region_b; empty for the outside
        centroid_z_um: centre of the area
        centroid_y_um: centre of the area
        centroid_x_um: centre of the area
        junction_length_um: length of the junctions along its rim
        mean_curvature_per_um: average of (k1 + k2) / 2 inside the wall, by cotangents; positive
            where it bulges out of region_a
        gaussian_curvature_per_um2: average of k1 k2 inside the wall: sum over its inner
            vertices of 2 pi minus their angles, over their area
        density: mean density of a membrane in it, relative to that of all membranes, by area
        tension: by Young and Dupre at its junctions; 1 is the mean of its cluster
        """
    ),
    *error_columns("walls"),
    *columns(
        """
        n_faces: triangles of the wall
        note: why cells of this row are empty, and caveats
        """
    ),
)

JUNCTION_COLUMNS = (
    *columns(
        """
        region_a: the lowest of its three regions; 0 is the outside
        region_b: the middle one
        region_c: the highest one
        length_um: along which the three meet
        measured_length_um: of the part whose angles could be measured
        angle_a_deg: opening of region_a, mean along the junction
        angle_b_deg: opening of region_b
        angle_c_deg: opening of region_c; the three make 360
        """
    ),
    *error_columns("junctions"),
    *columns(
        """
        note: why cells of this row are empty, and caveats
        """
    ),
)


def walls_table(
    mesh: Mesh, known: Known, curvature: WallCurvature, tensions: Mapping[Pair, Estimate]
) -> Table:
    """Return a table with one row for each wall, ordered by its two regions."""
    pairs, wall = mesh.interfaces()
    areas, n = mesh.areas(), len(pairs)
    total = np.bincount(wall, areas, n)
    middles = mesh.vertices_numpy()[mesh.faces].mean(1)
    centres = np.stack([np.bincount(wall, areas * c, n) for c in middles.T], 1)
    of_cell: dict[int, float] = {}
    for (a, b), area in zip(pairs.tolist(), total.tolist(), strict=True):
        of_cell[a] = of_cell.get(a, 0.0) + area
        of_cell[b] = of_cell.get(b, 0.0) + area
    rims = _rims(mesh)
    density = _densities(mesh, known)
    faces = np.bincount(wall, minlength=n)
    rows: list[dict[str, Value]] = []
    for k, (a, b) in enumerate(pairs.tolist()):
        area = float(total[k])
        tension = tensions.get((a, b), Estimate())
        centre = centres[k] / area if area > 0 else np.full(3, np.nan)
        row: dict[str, Value] = {
            "region_a": a,
            "region_b": b,
            "area_um2": area,
            "share_of_a": area / of_cell[a] if area > 0 else None,
            "share_of_b": area / of_cell[b] if area > 0 and b != OUTSIDE else None,
            "junction_length_um": rims.get((a, b), 0.0),
            "mean_curvature_per_um": float(curvature.mean[k]),
            "gaussian_curvature_per_um2": float(curvature.gaussian[k]),
            "density": None if density is None else float(density[k]),
            "tension": tension.value,
            "tension_se": tension.error,
            "n_faces": int(faces[k]),
            "note": notes(
                "" if area > 0 else "it has no area",
                "" if curvature.inside[k] else "no curvature: no vertex lies inside the wall",
                f"no tension: {tension.reason}" if tension.reason else "",
            ),
        }
        row |= {f"centroid_{x}_um": float(c) for x, c in zip("zyx", centre, strict=True)}
        rows.append(row)
    return table_of("walls", WALL_COLUMNS, rows)


def junctions_table(mesh: Mesh, known: Known, junctions: Sequence[Junction]) -> Table:
    """Return a table with one row for every three regions that meet along edges."""
    measured = {junction.regions: junction for junction in junctions}
    rows: list[dict[str, Value]] = []
    for regions, length in junction_lengths(mesh).items():
        names = [f"region_{x}" for x in "abc"]
        row: dict[str, Value] = dict(zip(names, regions, strict=True))
        row |= {"length_um": length, "measured_length_um": 0.0, "note": ""}
        junction = measured.get(regions)
        if junction is None:
            row["note"] = "no angles: its walls are too small, or at the border of the image"
        else:
            row["measured_length_um"] = junction.length
            errors = junction.errors(known.resolution)
            for name, angle, error in zip("abc", junction.angles, errors, strict=True):
                row[f"angle_{name}_deg"] = float(angle)
                row[f"angle_{name}_se_deg"] = float(error)
        rows.append(row)
    return table_of("junctions", JUNCTION_COLUMNS, rows)


def _rims(mesh: Mesh) -> dict[Pair, float]:
    """Return the length (um) of the junctions along each wall."""
    found: dict[Pair, float] = {}
    for regions, length in junction_lengths(mesh).items():
        for pair in walls_around(regions):
            found[pair] = found.get(pair, 0.0) + length
    return found


def _densities(mesh: Mesh, known: Known) -> np.ndarray | None:
    """Return (W,) densities relative to the mean of all membranes; NaN for walls without area."""
    if known.density is None:
        return None
    pairs, wall = mesh.interfaces()
    areas = mesh.areas()
    light = areas * known.density
    membranes = mesh.membranes()
    mean = float((light * membranes).sum() / (areas * membranes).sum())
    sums = np.bincount(wall, light, len(pairs))
    whole = np.bincount(wall, areas, len(pairs)) * mean
    return np.divide(sums, whole, out=np.full(len(pairs), np.nan), where=whole > 0)
