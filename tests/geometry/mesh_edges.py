"""What tests ask of the edges of a mesh."""

import numpy as np


def edge_valences(mesh):
    """(E,) number of faces at each edge: 2 within a surface, 3 or more at junctions."""
    return np.bincount(mesh.face_edges().ravel())
