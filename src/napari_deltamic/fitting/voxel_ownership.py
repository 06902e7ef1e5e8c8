"""Which voxels belong to the structures that meshes describe.

Neighbours that no mesh describes (other cells, cells cut by the border, debris) would attract a
mesh, which then grows a neck and swallows them. So the ground is shared out: a voxel counts if it
is nearer to a starting surface than to bright signal that no starting surface explains.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt, gaussian_filter, minimum_filter

from ..errors import InputError, RepairWarning
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from ..geometry.seed_points import labels_from_points
from ..images.missing import filled
from ..optics import Optics
from ..scene import Grid

Labels = NDArray[np.signedinteger]
Mask = NDArray[np.bool_]

_EXPLAINED = 3.0  # widths of the PSF around a starting surface that it explains
_BRIGHT = 0.3  # of the typical membrane above the dark level: less is haze
_OWN = 2.0  # widths around a starting surface that always count
_HAZE = 4.0  # widths: what is as bright this far around on all sides is haze, and nobody's
# A region of the image is that of a start placed by hand if its volume is that of the start, up to
# this factor: starts of 0.5 to 2 radii.
_SAME = 10.0


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
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    return _shared_out(image, grid, surface_voxels(mesh, grid), labels > 0, optics)


def counted_around(image: np.ndarray, grid: Grid, mesh: Mesh, optics: Optics) -> np.ndarray | None:
    """The same for starting surfaces that may lie far from the membranes.

    Which ground is theirs is asked of the image: the dark region that each start lies in, up to the
    crest of its membrane. None where some start has no such region: then nothing can be told.
    """
    labels = _regions_in_image(image, grid, mesh)
    if labels is None:
        return None
    surface = np.zeros(labels.shape, bool)
    for region in np.unique(labels[labels > 0]):
        own = labels == region
        surface |= own & ~binary_erosion(own, border_value=1)
    return _shared_out(image, grid, surface, labels > 0, optics)


def _shared_out(
    image: np.ndarray, grid: Grid, surface: Mask, inside: Mask, optics: Optics
) -> np.ndarray:
    known = np.isfinite(image)
    if not (surface & known).any():
        return known
    pixels = np.where(known, image, np.nanmedian(image)).astype(np.float32)
    pixels = gaussian_filter(pixels, 0.5)
    spacing = np.asarray(grid.voxel_size) / np.asarray(optics.sigma_um)
    own = distance_transform_edt(~surface, sampling=spacing)
    dark = np.percentile(pixels[known], 20)
    # The brightest voxel near each piece of surface is what a membrane looks like here.
    membrane = np.percentile(pixels[(own < 1) & known], 60)
    around = np.maximum(2 * np.ceil(_HAZE / spacing).astype(int) + 1, 3)
    haze = minimum_filter(pixels, tuple(around), mode="nearest") - dark
    bright = pixels - np.maximum(haze, 0) > dark + _BRIGHT * (membrane - dark)
    # What lies in a cell is light of this cell, whatever it is.
    foreign = bright & (own > _EXPLAINED) & ~inside & known
    if not foreign.any():
        return known
    other = distance_transform_edt(~foreign, sampling=spacing)
    return known & ((own < other) | (own < _OWN) | inside)


def _regions_in_image(image: np.ndarray, grid: Grid, mesh: Mesh) -> Labels | None:
    """(Z, Y, X) the dark region around the deepest voxel of each start; None if one has none."""
    starts = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    size, first = np.asarray(grid.voxel_size), np.asarray(grid.origin)
    places = []
    for region in mesh.region_ids():
        own = starts == region
        if not own.any():
            return None
        depth = distance_transform_edt(np.pad(own, 1), sampling=size)[1:-1, 1:-1, 1:-1]
        places.append(first + size * np.unravel_index(int(depth.argmax()), own.shape))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RepairWarning)
            found = labels_from_points(filled(image), grid.voxel_size, places, grid.origin)
    except InputError:
        return None
    for number, region in enumerate(mesh.region_ids(), 1):
        volume, start = int((found == number).sum()), int((starts == region).sum())
        if not start / _SAME < volume < start * _SAME:
            return None
    return found


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
