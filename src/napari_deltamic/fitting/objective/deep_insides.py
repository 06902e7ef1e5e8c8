"""How bright an image is deep inside of cells, how evenly, and whether dark insides are shown."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from ...geometry.distance_transform import distance_transform
from ...geometry.labels.voxels import voxel_labels
from ...geometry.mesh import Mesh
from ...optics import Optics
from ...scene import Grid
from ..model.level import differences
from ..voxels.voxel_ownership import surface_voxels
from .prediction import as_floats


@dataclass(frozen=True)
class DeepRules:
    """Where light inside is read, and when an image shows that an inside is dark.

    Attributes
    ----------
    deep, far
        Widths of the PSF from a surface: what its own light hardly reaches, and up to where the
        outside is read.
    fewest
        Voxels whose mean is told to a fifth of their spread: enough for what is judged.
    darker
        Of the brightness of a surface: insides of a model that are less dark than this beside the
        medium are not asked whether the image shows that. Chosen: noise and haze differ by 0.01.
    shown
        Where the model has insides that are darker than the medium around, least share of that
        difference that the image shows. Measured: 1.00 to 1.03 in six hazes, -0.02 to 0.05 in five
        thick layers, where a dark inside stands in for the flat top of their light.
    places
        Independent places, as large as the PSF, beyond the first of each cell, from which on they
        tell how much brightness varies. By definition its variance is then known to 0.7 of itself.
    """

    deep: float = 2.5
    far: float = 6.0
    fewest: int = 30
    darker: float = 0.03
    shown: float = 0.5
    places: float = 4.0


RULES = DeepRules()


@dataclass(frozen=True, eq=False)
class Cells:
    """Where cells lie, and through which PSF they are seen."""

    mesh: Mesh
    optics: Optics
    grid: Grid

    @cached_property
    def labels(self) -> np.ndarray:
        """(Z, Y, X) the region that each voxel lies in, 0 for none."""
        return voxel_labels(self.mesh, self.grid.shape, self.grid.voxel_size, self.grid.origin)

    @cached_property
    def surface(self) -> np.ndarray:
        """(Z, Y, X) bool: the voxels on the surface."""
        return surface_voxels(self.mesh, self.grid)

    @cached_property
    def away(self) -> np.ndarray:
        """(Z, Y, X) distance from the surface, in widths of the PSF."""
        widths = np.asarray(self.grid.voxel_size) / np.asarray(self.optics.sigma_um)
        found: np.ndarray = distance_transform(~self.surface, widths)
        return found


def cells_in_their_box(
    mesh: Mesh, optics: Optics, grid: Grid
) -> tuple[Cells, tuple[slice, slice, slice]]:
    """Cells on that part of a grid which holds them, and where it lies."""
    size, first = np.asarray(grid.voxel_size), np.asarray(grid.origin)
    low, high = (mesh.bounds() - first) / size
    last = np.asarray(grid.shape) - 1
    start = np.clip(np.floor(low), 0, last).astype(int)
    stop = np.clip(np.ceil(high), start, last).astype(int) + 1
    z, y, x = (slice(a, b) for a, b in zip(start.tolist(), stop.tolist(), strict=True))
    nz, ny, nx = (stop - start).tolist()
    oz, oy, ox = (first + start * size).tolist()
    return Cells(mesh, optics, Grid((nz, ny, nx), grid.voxel_size, (oz, oy, ox))), (z, y, x)


def deep_brightness(
    cells: Cells, image: np.ndarray, counted: np.ndarray, far: float = RULES.far
) -> dict[int, float]:
    """Brightness deep inside of each region less that outside, over that of the surface.

    Regions without a deep inside are left out; so are all without a deep outside.

    Parameters
    ----------
    image
        (Z, Y, X); NaN where it is missing.
    counted
        (Z, Y, X) bool: the voxels that may be read.
    far
        Widths of the PSF from the surface, up to where the outside is read.
    """
    known = np.isfinite(image) & counted
    surface = cells.surface & known
    if not surface.any():
        return {}
    deep = known & (cells.away > RULES.deep)
    outer = deep & (cells.labels == 0) & (cells.away < far)
    if outer.sum() < RULES.fewest:
        return {}
    dark, bright = float(image[outer].mean()), float(np.median(image[surface]))
    names = np.append(0, cells.mesh.region_ids())
    which = np.searchsorted(names, cells.labels[deep])  # names may be large numbers
    number = np.bincount(which, minlength=len(names))
    total = np.bincount(which, image[deep].astype(float), len(names))
    found = {}
    for region, voxels, light in zip(names[1:].tolist(), number[1:], total[1:], strict=True):
        if voxels >= RULES.fewest:
            level = float(light / voxels)
            found[region] = (level - dark) / max(bright - min(level, dark), 1e-30)
    return found


def dark_insides_shown(
    cells: Cells, seen: np.ndarray, rendered: np.ndarray, counted: np.ndarray
) -> dict[int, float]:
    """Share that an image shows of how much darker a model's insides are than the medium around.

    Up to the border of the image: where the light of a thick layer ends is far from its inner side,
    where such a model explains it. None of regions that the model does not have darker.

    Parameters
    ----------
    seen, rendered
        (Z, Y, X) measured, and of the model.
    counted
        (Z, Y, X) bool: the voxels that may be read.
    """
    measured, modelled = (
        deep_brightness(cells, image, counted, np.inf) for image in (seen, rendered)
    )
    return {
        region: measured[region] / level
        for region, level in modelled.items()
        if level < -RULES.darker and region in measured
    }


UNKNOWN = 0.0, np.inf  # what is said of a variation of which an image tells nothing


def variation(
    cells: Cells, image: np.ndarray, background: float, counted: np.ndarray
) -> tuple[float, float]:
    """Relative variation of brightness deep inside cells: the least and the most it can be.

    Of means over places as large as the PSF, around the mean of each cell. What noise makes of it
    is taken off, and two standard errors are taken off or added. Of cells that are too small, or no
    brighter than the background: ``UNKNOWN``.

    Parameters
    ----------
    image
        (Z, Y, X) measured; any number where it does not count.
    background
        Of the image: there nothing shines.
    counted
        (Z, Y, X) bool: the voxels that may be read.
    """
    deep = counted & (cells.away > RULES.deep) & (cells.labels > 0)
    widths = np.asarray(cells.optics.sigma_um) / np.asarray(cells.grid.voxel_size)
    # Of the mean under a Gaussian filter: one voxel's variance over this.
    independent = max(float(np.prod(2 * np.sqrt(np.pi) * widths)), 1.0)
    names = np.asarray(cells.mesh.region_ids())
    cell = np.searchsorted(names, cells.labels[deep])
    places = np.bincount(cell, minlength=len(names)) / independent
    places[places <= 1] = 0  # nothing is left without their mean
    free = float((places[places > 0] - 1).sum())
    if free < RULES.places:
        return UNKNOWN
    deep[deep] = (places > 0)[cell]
    cell = cell[(places > 0)[cell]]
    number = np.maximum(np.bincount(cell, minlength=len(names)), 1)
    # Cells are further apart than the filter reaches, so that it mixes none.
    light = gaussian_filter(np.where(deep, image, 0.0).astype(float), widths, mode="constant")
    share = gaussian_filter(deep.astype(float), widths, mode="constant")[deep]
    found = light[deep] / share - background
    away = found - (np.bincount(cell, found, len(names)) / number)[cell]
    squares = np.bincount(cell, away**2, len(names)) / number
    level, varied = float(found.mean()), float((squares * places).sum()) / free
    if level <= 0:
        return UNKNOWN
    noise, told = _noise(image, counted)
    told = told[deep]
    by_noise = float(np.mean((noise[deep] ** 2 / share)[told])) / independent if told.any() else 0.0
    unsure = 2 * np.sqrt(2 / free)  # of a variance of so many independent numbers
    left, error = max(varied - by_noise, 0.0), unsure * max(varied, by_noise)
    least, most = np.sqrt([max(left - error, 0.0), left + error]) / level
    return float(least), float(most)


def _noise(image: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(Z, Y, X) as large as the noise of each voxel in the mean, and where that is told."""
    told = known.copy()
    told[..., 1:] &= known[..., :-1]
    told[..., :-1] &= known[..., 1:]
    return as_floats(differences(torch.from_numpy(np.ascontiguousarray(image, float)))), told
