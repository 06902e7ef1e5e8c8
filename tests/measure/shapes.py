"""Shapes whose every number is known."""

from itertools import permutations, product

import numpy as np
from scipy.spatial import ConvexHull

from napari_deltamic.geometry import Mesh


def kelvin_cell(edge=1.0):
    """A truncated octahedron: the corners are the permutations of (0, +-1, +-2)."""
    corners = {
        tuple(np.array(p) * s) for p in permutations((0, 1, 2)) for s in product((-1, 1), repeat=3)
    }
    points = np.array(sorted(corners)) * edge / np.sqrt(2)
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    out = np.einsum("fi,fi->f", Mesh(points, faces).normals(), hull.equations[:, :3]) > 0
    faces[~out] = faces[~out][:, ::-1]
    return Mesh(points, faces)
