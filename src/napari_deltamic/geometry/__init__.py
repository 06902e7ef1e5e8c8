"""Meshes of cells: the Mesh itself, simple shapes, starting surfaces, repair, and files."""

from napari_deltamic.geometry.files import load_mesh, save_mesh
from napari_deltamic.geometry.mesh import OUTSIDE, Mesh
from napari_deltamic.geometry.primitives import box, sphere, torus
from napari_deltamic.geometry.repair import repair
from napari_deltamic.geometry.seeds import (
    labels_from_points,
    mesh_from_labels,
    read_points_csv,
    seeds_from_points,
)
from napari_deltamic.geometry.windings import fix_windings

__all__ = [
    "OUTSIDE",
    "Mesh",
    "box",
    "fix_windings",
    "labels_from_points",
    "load_mesh",
    "mesh_from_labels",
    "read_points_csv",
    "repair",
    "save_mesh",
    "seeds_from_points",
    "sphere",
    "torus",
]
