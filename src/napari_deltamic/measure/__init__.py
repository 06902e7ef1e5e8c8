"""Measurements on meshes: cells, junctions, sections, distances to a surface or the image."""

from napari_deltamic.measure.cells import measure_cells, write_csv
from napari_deltamic.measure.image_similarity import ImageSimilarity, image_similarity
from napari_deltamic.measure.junctions import Junction, junction_angles
from napari_deltamic.measure.ridge import RidgeDistance, ridge_distance
from napari_deltamic.measure.section import section
from napari_deltamic.measure.surface_distance import (
    SurfaceDistance,
    distance_to_surface,
    surface_distance,
)

__all__ = [
    "ImageSimilarity",
    "Junction",
    "RidgeDistance",
    "SurfaceDistance",
    "distance_to_surface",
    "image_similarity",
    "junction_angles",
    "measure_cells",
    "ridge_distance",
    "section",
    "surface_distance",
    "write_csv",
]
