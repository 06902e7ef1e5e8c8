from .files import load_mesh, save_mesh
from .labels.find_cells import find_cells
from .labels.label_edits import Click, correct_labels
from .labels.label_repair import RepairedLabels, repair_labels
from .labels.meshes import mesh_from_labels
from .mesh import OUTSIDE, Mesh
from .mesh_repair import repair
from .primitives import sphere
from .remeshing import Remeshed, remesh
from .seed_points import (
    labels_from_points,
    read_napari_points,
    read_points_csv,
    seeds_from_points,
)
from .windings import fix_windings

__all__ = [
    "OUTSIDE",
    "Click",
    "Mesh",
    "Remeshed",
    "RepairedLabels",
    "correct_labels",
    "find_cells",
    "fix_windings",
    "labels_from_points",
    "load_mesh",
    "mesh_from_labels",
    "read_napari_points",
    "read_points_csv",
    "remesh",
    "repair",
    "repair_labels",
    "save_mesh",
    "seeds_from_points",
    "sphere",
]
