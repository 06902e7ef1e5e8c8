"""Numbers for each cell of a mesh, and the table that holds them."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from math import nan, pi

import numpy as np

from napari_deltamic.common.writing import write_atomically
from napari_deltamic.geometry.mesh import OUTSIDE, Mesh

COLUMNS = (
    "region",
    "volume_um3",
    "area_um2",
    "sphericity",
    "centroid_z_um",
    "centroid_y_um",
    "centroid_x_um",
    "n_contacts",
)

CellRow = dict[str, int | float]


def measure_cells(mesh: Mesh) -> list[CellRow]:
    """Measure each region of a mesh.

    Returns
    -------
    list of dict, sorted by region
        region : its number
        volume_um3 : of the region
        area_um2 : of all its faces, walls included
        sphericity : area of the sphere of the same volume over area; 1 for a sphere, else less
        centroid_z_um, centroid_y_um, centroid_x_um : centre of the volume
        n_contacts : number of other regions with which it shares a wall

        What needs a volume is NaN where the region's surface is not closed or is inside out.
    """
    vertices = mesh.vertices_numpy()
    reference = vertices.mean(axis=0)
    areas, per_face = mesh.areas(), mesh.signed_volumes()
    # A face and the reference point span a tetrahedron; this is its centre, from that point.
    centers = (vertices[mesh.faces] - reference).sum(axis=1) / 4
    pairs, _ = mesh.interfaces()
    rows: list[CellRow] = []
    for region in mesh.region_ids().tolist():
        inner, outer = (mesh.regions == region).T
        area = float(areas[inner | outer].sum())
        weights = per_face * (inner.astype(np.float64) - outer)
        volume = float(weights.sum())
        centroid = np.full(3, nan)
        if mesh.is_closed(region) and volume > 0:
            centroid = reference + weights @ centers / volume
        else:
            volume = nan
        touching = pairs[(pairs == region).any(axis=1)]
        rows.append(
            {
                "region": region,
                "volume_um3": volume,
                "area_um2": area,
                "sphericity": pi ** (1 / 3) * (6 * volume) ** (2 / 3) / area if area else nan,
                "centroid_z_um": float(centroid[0]),
                "centroid_y_um": float(centroid[1]),
                "centroid_x_um": float(centroid[2]),
                "n_contacts": int((touching != OUTSIDE).all(axis=1).sum()),
            }
        )
    return rows


def write_csv(rows: Sequence[Mapping[str, int | float]], path: str | os.PathLike[str]) -> None:
    """Write rows (as from ``measure_cells``) as a CSV table, with a header.

    The columns are those of the first row, or of ``measure_cells`` if there is no row.
    The file appears whole or not at all. Raises InputError if it cannot be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else list(COLUMNS), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())
