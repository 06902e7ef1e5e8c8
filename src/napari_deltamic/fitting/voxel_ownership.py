"""Which voxels belong to the structures that meshes describe.

Neighbours that no mesh describes (other cells, cells cut by the border, debris) would attract a
mesh, which then grows a neck and swallows them. So the ground is shared out: a voxel counts if it
is nearer to a starting surface than to bright signal that no starting surface explains.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid

_EXPLAINED = 3.0  # widths of the PSF around a starting surface that it explains
_BRIGHT = 0.3  # of the typical membrane above the dark level: less is haze
_OWN = 2.0  # widths around a starting surface that always count


def counted_voxels(image: np.ndarray, grid: Grid, mesh: Mesh, optics: Optics) -> np.ndarray:
    """The voxels that may count in a fit that starts close to the membranes.

    Parameters
    ----------
    image
        (Z, Y, X); NaN marks missing voxels.
    grid
        Where the voxels lie.
    mesh
        Starting surfaces, within about one PSF width of the membranes.
    optics
        The PSF; distances are measured in its widths, axis by axis.

    Returns
    -------
    (Z, Y, X) bool.
    """
    known = np.isfinite(image)
    if not known.any():
        return known
    pixels = np.where(known, image, np.nanmedian(image)).astype(np.float32)
    pixels = gaussian_filter(pixels, 0.5)
    spacing = np.asarray(grid.voxel_size) / np.asarray(optics.sigma_um)
    surface = surface_voxels(mesh, grid)
    if not (surface & known).any():
        return known
    own = distance_transform_edt(~surface, sampling=spacing)
    dark = np.percentile(pixels[known], 20)
    # The brightest voxel near each piece of surface is what a membrane looks like here.
    membrane = np.percentile(pixels[(own < 1) & known], 60)
    foreign = (pixels > dark + _BRIGHT * (membrane - dark)) & (own > _EXPLAINED) & known
    if not foreign.any():
        return known
    other = distance_transform_edt(~foreign, sampling=spacing)
    return known & ((own < other) | (own < _OWN))


def surface_voxels(mesh: Mesh, grid: Grid) -> np.ndarray:
    """(Z, Y, X) bool: the voxels that hold a part of the surface."""
    corners = mesh.vertices_numpy()[mesh.faces]
    size = np.asarray(grid.voxel_size)
    longest = np.abs((corners - np.roll(corners, 1, axis=1)) / size).max() if len(corners) else 0
    n = max(1, int(np.ceil(1.5 * min(longest, 2 * max(grid.shape)))))
    i, j = (k.ravel() for k in np.mgrid[0 : n + 1, 0 : n + 1])
    inside = i + j <= n
    weights = np.stack([i, j, n - i - j], 1)[inside] / n
    out = np.zeros(grid.shape, bool)
    for part in np.array_split(corners, max(1, len(corners) * len(weights) // 4_000_000)):
        points = (weights @ part).reshape(-1, 3)
        index = np.rint((points - np.asarray(grid.origin)) / size).astype(np.int64)
        index = index[((index >= 0) & (index < np.asarray(grid.shape))).all(1)]
        out[tuple(index.T)] = True
    return out
