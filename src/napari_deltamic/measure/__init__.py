"""Measurements on meshes: cells, junctions, sections, distances to a surface."""

from napari_deltamic.common.table import Column, Table
from napari_deltamic.measure.cells import measure_cells
from napari_deltamic.measure.junctions import Junction, junction_angles
from napari_deltamic.measure.known import Known
from napari_deltamic.measure.measurements import Measurements, measure
from napari_deltamic.measure.section import section
from napari_deltamic.measure.surface_distance import (
    SurfaceDistance,
    distance_to_surface,
    surface_distance,
)
from napari_deltamic.measure.tensions import (
    Estimate,
    TensionSettings,
    relative_pressures,
    relative_tensions,
)

__all__ = [
    "Column",
    "Estimate",
    "Junction",
    "Known",
    "Measurements",
    "SurfaceDistance",
    "Table",
    "TensionSettings",
    "distance_to_surface",
    "junction_angles",
    "measure",
    "measure_cells",
    "relative_pressures",
    "relative_tensions",
    "section",
    "surface_distance",
]
