"""The part of a scene that is judged: a few cells, and the piece of the image around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects

from ..fitting.voxels.voxel_ownership import surface_voxels
from ..geometry.distance_transform import distance_transform
from ..geometry.mesh import Mesh, mesh_of_faces
from ..scene import Grid
from .evidence_rules import JUDGING


@dataclass(frozen=True)
class Crop:
    """A piece of an image and what is judged in it.

    Attributes
    ----------
    grid
        Grid of the piece.
    box
        Slices that cut it out of the whole image.
    mesh, density
        Surfaces of the cells in or near it; (F,) relative density, None where uniform.
    cells
        Regions whose shape is free.
    index
        (N,) flat indices into the piece of the voxels that are evidence.
    of
        How many cells there are in the whole image.
    """

    grid: Grid
    box: tuple[slice, slice, slice]
    mesh: Mesh
    density: np.ndarray | None
    cells: np.ndarray
    index: np.ndarray
    of: int


def crop_of(
    usable: np.ndarray, grid: Grid, mesh: Mesh, density: np.ndarray | None, width: np.ndarray
) -> Crop:
    """The cells nearest to the middle of the image, and the usable voxels that belong to them.

    Parameters
    ----------
    usable
        (Z, Y, X) bool.
    grid, mesh, density
        Those of the fit.
    width
        (3,) standard deviations of the PSF, um.
    """
    every = mesh.region_ids()
    cells = _central(mesh, every, grid)
    spacing = np.asarray(grid.voxel_size) / width
    own = _distance(mesh, cells, grid, spacing)
    near = own <= JUDGING.reach
    if len(cells) < len(every):
        near &= own <= _distance(mesh, np.setdiff1d(every, cells), grid, spacing)
    found = usable & near
    if not found.any():
        found = usable
    box = find_objects(found.astype(np.int8))[0]
    first = np.array([s.start for s in box])
    z, y, x = np.asarray(grid.origin) + first * np.asarray(grid.voxel_size)
    shape = (box[0].stop - first[0], box[1].stop - first[1], box[2].stop - first[2])
    piece = Grid(shape, grid.voxel_size, (float(z), float(y), float(x)))
    seen, weight = _near_piece(mesh, density, piece, JUDGING.seen * width)
    cells = np.intersect1d(cells, seen.region_ids())
    return Crop(piece, box, seen, weight, cells, np.flatnonzero(found[box]), len(every))


def _central(mesh: Mesh, regions: np.ndarray, grid: Grid) -> np.ndarray:
    """A few neighbouring regions around the middle of the image."""
    if len(regions) <= JUDGING.most_cells:
        return regions
    v = mesh.vertices_numpy()
    own = mesh.faces_by_region()
    middles = np.array([v[np.unique(mesh.faces[own[int(r)]])].mean(0) for r in regions])
    first, last = grid.extent
    start = middles[np.argmin(((middles - (first + last) / 2) ** 2).sum(1))]
    nearest = np.argsort(((middles - start) ** 2).sum(1), kind="stable")[: JUDGING.most_cells]
    return np.sort(regions[nearest])


def _distance(mesh: Mesh, regions: np.ndarray, grid: Grid, spacing: np.ndarray) -> np.ndarray:
    """(Z, Y, X) distance to the surfaces of some regions; infinite if none lies in the image."""
    faces = np.isin(mesh.regions, regions).any(1)
    kept = Mesh(mesh.vertices_numpy(), mesh.faces[faces], mesh.regions[faces])
    surface = surface_voxels(kept, grid)
    if not surface.any():
        return np.full(grid.shape, np.inf)
    found: np.ndarray = distance_transform(~surface, spacing)
    return found


def _near_piece(
    mesh: Mesh, density: np.ndarray | None, piece: Grid, margin: np.ndarray
) -> tuple[Mesh, np.ndarray | None]:
    """The mesh of regions that reach near a piece, and its density; walls to others keep theirs."""
    first, last = piece.extent
    v, kept = mesh.vertices_numpy(), [0]
    for r, rows in mesh.faces_by_region().items():
        own = v[np.unique(mesh.faces[rows])]
        if (own.max(0) > first - margin).all() and (own.min(0) < last + margin).all():
            kept.append(r)
    if len(kept) > len(mesh.region_ids()):
        return mesh, density
    sides = np.where(np.isin(mesh.regions, kept), mesh.regions, 0)
    faces = (sides != 0).any(1)
    part, _ = mesh_of_faces(v, mesh.faces[faces], sides[faces])
    weight = np.ones(len(part.faces)) if density is None else density[faces]
    weight = weight * mesh.membranes()[faces] / part.membranes()
    return part, weight if np.ptp(weight) > 0 else None
