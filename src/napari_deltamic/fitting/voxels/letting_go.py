"""Lets neighbours go that a cell has swallowed through a neck.

Where the ground of a start reached into an object without a seed, the surface may grow a neck and
take the object in. The neck tells, once the fit has ended: what lies beyond is cut off, and its
light counts as that of another object. Only of cells that touch no other: in a cluster, a bulge
through its hull looks the same, and all cells would be fitted anew for one (an embryo of 56 cells
took half as long again and ended 0.62 voxel from its membranes, not 0.57).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ...geometry.connected import sharing
from ...geometry.distance_transform import distance_transform
from ...geometry.mesh import OUTSIDE, FloatArray, Mesh
from ...geometry.topology.crossings import crosses
from ...geometry.topology.patches import Mask, cut_off
from ..model.fitted import Fitted
from ..model.problem import Problem
from .ground_again import RULES, with_ground
from .necks import BeyondNecks, beyond_necks, within
from .voxel_ownership import surface_voxels


def let_neighbours_go(problem: Problem, begun: Mesh, fitted: Fitted) -> tuple[Problem, Mesh] | None:
    """The problem and the mesh without what lies beyond necks that the start did not have.

    None where there is nothing of that kind that can be cut off: cells that touch another one stay
    as they are, as do those of which surfaces that cross would be left.
    """
    if problem.anew is None:
        return None
    before = problem.let_go
    if before is not None and before.max() >= RULES.times:
        return None
    mesh, grid = fitted.mesh, problem.grid
    touching = np.unique(mesh.regions[(mesh.regions != OUTSIDE).all(1)])
    if np.isin(mesh.region_ids(), touching).all():
        return None
    beyond = beyond_necks(begun, mesh, grid, fitted.optics)
    sound, cut = not crosses(mesh), mesh
    for region in beyond.middles:
        gone = _faces_beyond(cut, region, beyond)
        smaller = None if region in touching else cut_off(cut, region, gone)
        if smaller is None or (sound and crosses(smaller)):
            beyond.parts[beyond.parts == region] = 0
        else:
            cut = smaller
    if cut is mesh:
        return None
    size = np.asarray(grid.voxel_size) / np.asarray(fitted.optics.sigma_um)
    own = distance_transform(~surface_voxels(cut, beyond.grid), size)
    other = distance_transform(beyond.parts == 0, size)
    ours = (own < other) | ((beyond.cells > 0) & (beyond.parts == 0))
    # They stay foreign where the cells' own light is asked for again.
    let_go = np.zeros(grid.shape, np.uint8) if before is None else before.copy()
    let_go[~ours[within(beyond.grid, grid)]] = let_go.max() + 1
    return with_ground(replace(problem, let_go=let_go), problem.counted, problem.anew), cut


def _faces_beyond(mesh: Mesh, region: int, beyond: BeyondNecks) -> Mask:
    """(F,) bool: the faces of a cell around its part beyond a neck, and those of the neck.

    What is more than the diagonal of a voxel from the rest of the cell is thinner than voxels.
    """
    rows = np.flatnonzero((mesh.regions == region).any(1))
    middles: FloatArray = mesh.vertices_numpy()[mesh.faces[rows]].mean(1)
    size, first = np.asarray(beyond.grid.voxel_size), np.asarray(beyond.grid.origin)
    lost = beyond.parts == region
    to_rest, to_lost = (
        cKDTree(np.argwhere(part) * size + first).query(middles)[0]
        for part in ((beyond.cells == region) & ~lost, lost)
    )
    nearer = to_lost < to_rest
    away = nearer | (to_rest > np.linalg.norm(size))
    number = sharing(mesh.face_edges()[rows[away]], len(mesh.edges()))
    found = np.zeros(len(mesh.faces), bool)
    found[rows[away]] = np.isin(number, number[nearer[away]])
    return found
