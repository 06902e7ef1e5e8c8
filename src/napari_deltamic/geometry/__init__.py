"""Meshes of cells: the Mesh itself, simple shapes, starting surfaces, repair, and files."""

from napari_deltamic.geometry.files import load_mesh, save_mesh
from napari_deltamic.geometry.labels.find_cells import find_cells, suggest_size
from napari_deltamic.geometry.labels.label_edits import (
    Click,
    correct_labels,
    read_clicks_csv,
    write_clicks_csv,
)
from napari_deltamic.geometry.labels.label_repair import RepairedLabels, repair_labels
from napari_deltamic.geometry.labels.meshes import mesh_from_labels
from napari_deltamic.geometry.mesh import OUTSIDE, Mesh
from napari_deltamic.geometry.mesh_repair import repair
from napari_deltamic.geometry.primitives import box, sphere, torus
from napari_deltamic.geometry.remeshing import Remeshed, remesh
from napari_deltamic.geometry.seed_points import (
    labels_from_points,
    read_points_csv,
    seeds_from_points,
)
from napari_deltamic.geometry.windings import fix_windings

__all__ = [
    "OUTSIDE",
    "Click",
    "Mesh",
    "Remeshed",
    "RepairedLabels",
    "box",
    "correct_labels",
    "find_cells",
    "fix_windings",
    "labels_from_points",
    "load_mesh",
    "mesh_from_labels",
    "read_clicks_csv",
    "read_points_csv",
    "remesh",
    "repair",
    "repair_labels",
    "save_mesh",
    "seeds_from_points",
    "sphere",
    "suggest_size",
    "torus",
    "write_clicks_csv",
]
