"""The tables of another channel: amounts on walls and in cells."""

from __future__ import annotations

import numpy as np

from ..common.table import Table, Value, columns, table_of
from ..geometry.mesh import OUTSIDE, Mesh
from .cells import moments
from .channel import ChannelAmounts
from .sides import Sides

CHANNEL_WALL_COLUMNS = columns(
    """
    region_a: one of its two cells: that of the larger number
    region_b: the other one; 0 is the outside
    area_um2: of the wall, once, also where it is two membranes
    light_per_um2: light of the wall, in the image's unit, over its area
    light_se_per_um2: its standard error
    light: of the whole wall: what its voxels would add up to with no other light
    light_se: its standard error
    note: why cells of this row are empty
    """
)

CHANNEL_CELL_COLUMNS = columns(
    """
    region: number of the cell in mesh and labels
    volume_um3: enclosed volume
    light_per_um3: light inside it, in the image's unit, over its volume
    light_se_per_um3: its standard error
    light: inside the whole cell
    light_se: its standard error
    membrane_light: of its walls: all of those to the outside, half of the others
    note: why cells of this row are empty
    """
)

_UNSEEN = "nothing of it is seen in the image"


def channel_tables(mesh: Mesh, found: ChannelAmounts) -> tuple[Table, Table]:
    """Return a table of walls and one of cells; entries that were not asked for are empty."""
    pairs, wall = mesh.interfaces()
    areas = np.bincount(wall, mesh.areas(), len(pairs))
    of_walls: list[dict[str, Value]] = []
    membrane = dict.fromkeys(mesh.region_ids().tolist(), 0.0)
    for k, ((a, b), area) in enumerate(zip(pairs.tolist(), areas.tolist(), strict=True)):
        row: dict[str, Value] = {"region_a": a, "region_b": b, "area_um2": area, "note": ""}
        row |= _light(found.walls, found.walls_se, k, area, "um2")
        light = row["light"]
        if isinstance(light, float):
            for region in {a, b} - {OUTSIDE}:
                membrane[region] += light if b == OUTSIDE else light / 2
        of_walls.append(row)
    sides = Sides.of(mesh)
    volumes = moments(sides)[0]
    of_cells: list[dict[str, Value]] = []
    for k, (region, volume) in enumerate(zip(sides.cells.tolist(), volumes.tolist(), strict=True)):
        row = {"region": region, "volume_um3": volume, "note": ""}
        row |= _light(found.insides, found.insides_se, k, volume, "um3")
        row["membrane_light"] = membrane[region] if len(found.walls) else None
        of_cells.append(row)
    return (
        table_of("channel_walls", CHANNEL_WALL_COLUMNS, of_walls),
        table_of("channel_cells", CHANNEL_CELL_COLUMNS, of_cells),
    )


def _light(
    density: np.ndarray, error: np.ndarray, k: int, size: float, unit: str
) -> dict[str, Value]:
    """Return density and amount of a part, or a note if it was asked for but nothing is seen."""
    if not len(density):
        return {"light": None}
    if not np.isfinite(density[k]):
        return {"light": None, "note": _UNSEEN}
    return {
        f"light_per_{unit}": float(density[k]),
        f"light_se_per_{unit}": float(error[k]),
        "light": float(density[k] * size),
        "light_se": float(error[k] * size),
    }
