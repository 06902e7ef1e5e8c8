"""Everything that is measured on a mesh: tables of cells, walls and junctions."""

from __future__ import annotations

from dataclasses import dataclass

from ..common.table import Table
from ..geometry.border import beyond
from ..geometry.mesh import Mesh
from .all_cells import cells_table
from .all_walls import junctions_table, walls_table
from .discrete_curvature import wall_curvature
from .junctions import angle_reach, junction_angles
from .known import Known
from .sides import Sides
from .standard_errors import with_errors
from .tensions import TensionSettings, relative_pressures, relative_tensions


@dataclass(frozen=True)
class Measurements:
    """Three tables; each entry is a number, a word, or empty with a note that says why."""

    cells: Table
    walls: Table
    junctions: Table

    @property
    def tables(self) -> tuple[Table, Table, Table]:
        """The three tables: cells, walls, junctions."""
        return self.cells, self.walls, self.junctions


def measure(
    mesh: Mesh, known: Known | None = None, settings: TensionSettings | None = None
) -> Measurements:
    """Measure cells, walls and junctions of a mesh.

    Parameters
    ----------
    mesh
        um; open surfaces, cut cells and tiny walls are measured as far as they can be.
    known
        The image's grid, densities, resolution and errors, where there are any.
    settings
        Of the tensions.

    Raises
    ------
    InputError
        If the densities are not one finite number for each face.
    """
    known = (known or Known()).checked(mesh)
    reach = angle_reach(mesh)
    found = _measured(mesh, known, settings, reach)
    if known.replicas is None:
        return found
    # For other meshes of the same walls nothing else is known.
    bare = Known(grid=known.grid, resolution=known.resolution)

    def measured(other: Mesh, part: float) -> tuple[Table, Table, Table]:
        return _measured(other, bare, settings, part * reach).tables

    return Measurements(*with_errors(found.tables, known.replicas, measured))


def _measured(
    mesh: Mesh, known: Known, settings: TensionSettings | None, reach: float
) -> Measurements:
    sides, curvature = Sides.of(mesh), wall_curvature(mesh)
    pairs = [(a, b) for a, b in mesh.interfaces()[0].tolist()]
    cut = None if known.grid is None else mesh.vertices_numpy()[beyond(mesh, known.grid)]
    junctions = junction_angles(mesh, reach, cut)
    tensions = relative_tensions(junctions, pairs, known.resolution, settings)
    walls = walls_table(mesh, known, curvature, tensions)
    # Curvatures of walls without area would be meaningless.
    bends = dict(zip(pairs, curvature.mean.tolist(), strict=True))
    areas = {
        pair: area
        for pair, area in zip(pairs, walls.values("area_um2"), strict=True)
        if isinstance(area, float)
    }
    pressures = relative_pressures(tensions, bends, areas, sides.cells.tolist())
    return Measurements(
        cells_table(sides, known, pressures), walls, junctions_table(mesh, known, junctions)
    )
