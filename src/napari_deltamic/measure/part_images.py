"""The images of each wall and of the inside of each cell, as sparse columns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
import torch

from ..geometry.mesh import FloatArray, Mesh, mesh_of_faces
from ..optics import Optics
from ..scene import Grid, Scene, Solid, Surface, render_scene

_DIM = 1e-4  # of a column's brightest voxel: what is darker is less than the images' error


def part_images(
    mesh: Mesh, grid: Grid, optics: Optics, walls: bool, insides: bool, accuracy: float
) -> sp.csc_matrix:
    """Render light of density 1 per um^2 on each wall, then 1 per um^3 inside each cell.

    Parameters
    ----------
    mesh
        um.
    grid, optics
        Grid and PSF of the image in which the light is seen.
    walls, insides
        Which of them have columns: walls in the order of ``mesh.interfaces()``, insides in that of
        ``mesh.region_ids()``; open cells have an empty one.
    accuracy
        Relative error of each image.

    Returns
    -------
    (voxels, columns) sparse; a column is empty where nothing of its part is seen.
    """
    parts = [*(_walls(mesh) if walls else ()), *(_insides(mesh) if insides else ())]
    reach = np.asarray(optics.reach(accuracy))
    columns = [_column(part, grid, optics, reach, accuracy) for part in parts]
    size = int(np.prod(grid.shape))
    indices = [index for index, _ in columns]
    starts = np.concatenate([[0], np.cumsum([len(index) for index in indices])])
    flat = np.concatenate([*indices, np.zeros(0, np.int64)])
    values = np.concatenate([*(v for _, v in columns), np.zeros(0)])
    return sp.csc_matrix((values, flat, starts), shape=(size, len(parts)))


def _walls(mesh: Mesh) -> Iterator[Surface | None]:
    pairs, wall = mesh.interfaces()
    order = np.argsort(wall, kind="stable")
    ends = np.searchsorted(wall[order], np.arange(len(pairs) + 1))
    v = mesh.vertices_numpy()
    for k in range(len(pairs)):
        # As a surface of its own: one membrane, whatever lies on either side.
        yield Surface(mesh_of_faces(v, mesh.faces[order[ends[k] : ends[k + 1]]])[0])


def _insides(mesh: Mesh) -> Iterator[Solid | None]:
    for region in mesh.region_ids().tolist():
        closed = mesh.is_closed(region)
        yield Solid(mesh.region_surface(region)) if closed else None


def _column(
    part: Surface | Solid | None, grid: Grid, optics: Optics, reach: FloatArray, accuracy: float
) -> tuple[np.ndarray, FloatArray]:
    """Return sorted flat indices of the voxels where a part is seen, and its brightness there."""
    nothing = np.zeros(0, np.int64), np.zeros(0)
    if part is None:
        return nothing
    size, origin = np.asarray(grid.voxel_size), np.asarray(grid.origin)
    bounds = part.mesh.bounds()
    low = np.floor((bounds[0] - reach - origin) / size).astype(int).clip(0, None)
    high = np.ceil((bounds[1] + reach - origin) / size).astype(int) + 1
    high = np.minimum(high, grid.shape)
    if (low >= high).any():
        return nothing
    z, y, x = (int(n) for n in high - low)
    corner = origin + low * size
    box = Grid((z, y, x), grid.voxel_size, (corner[0], corner[1], corner[2]))
    with torch.no_grad():
        image = render_scene(Scene((part,), optics), box, accuracy).double().numpy()
    bright = image > _DIM * image.max()
    place = np.argwhere(bright) + low
    return np.ravel_multi_index(tuple(place.T), grid.shape), image[bright]
