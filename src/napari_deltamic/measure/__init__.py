"""Measurements on meshes: cells, junctions, sections, distances to a surface."""

from ..common.table import Column, Table
from .cells import measure_cells
from .junctions import Junction, junction_angles
from .known import Known
from .measurements import Measurements, measure
from .section import section
from .surface_distance import SurfaceDistance, distance_to_surface, surface_distance
from .tensions import Estimate, TensionSettings, relative_pressures, relative_tensions

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
