"""Where a fitted scene does not explain the image: map, spots, and the share for each cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log, pi, sqrt

import numpy as np
from scipy.ndimage import center_of_mass, gaussian_filter, label, maximum_position, sum_labels
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from ..common.triple import triple
from ..errors import InputError
from ..fitting.model.checks import check_image
from ..fitting.model.hot_voxels import hot_voxels
from ..fitting.model.saturation import filled_in
from ..fitting.model.state import FitState
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid
from .evidence_rules import RESIDUAL
from .voxel_variance import Variance, voxel_variance


@dataclass(frozen=True)
class Spot:
    """A place where the image is brighter or darker than the model.

    Attributes
    ----------
    position
        Where it is clearest, um, Z Y X.
    volume
        Volume above three standard deviations, um^3.
    z
        Deviation at its position in standard deviations; below 0 if the image is darker.
    light
        Measured minus expected, summed over the spot, in the unit of the image.
    region
        Region of the nearest surface.
    middle
        Centre of mass, um, Z Y X; of a membrane that is bright all around, it lies inside.
    """

    position: tuple[float, float, float]
    volume: float
    z: float
    light: float
    region: int
    middle: tuple[float, float, float]


@dataclass(frozen=True)
class CellFit:
    """How well one cell's surroundings are explained.

    Attributes
    ----------
    region
        The cell.
    explained
        Explained share of the variation there beyond noise; None where nothing varies.
    z
        Standard deviations by which the residual is larger than noise.
    shown
        Standard deviations of noise by which the image shows what the model expects there, apart
        from an even ground.
    """

    region: int
    explained: float | None
    z: float
    shown: float


@dataclass(frozen=True)
class Residual:
    """What a fit leaves unexplained.

    Attributes
    ----------
    map
        (Z, Y, X) float32: measured minus expected, smoothed by the width of the PSF, in standard
        deviations of the noise; NaN where missing.
    spots
        The clearest places, largest deviation first.
    threshold
        Standard deviations above which a place is a spot.
    explained
        Explained share of the variation beyond noise near the surfaces; None where nothing varies.
    cells
        The same for each cell.
    """

    map: np.ndarray
    spots: tuple[Spot, ...]
    threshold: float
    explained: float | None
    cells: tuple[CellFit, ...]

    def shown(self) -> dict[int, float]:
        """How clearly the image shows each region, standard deviations."""
        return {c.region: c.shown for c in self.cells}

    def shares(self) -> dict[int, float]:
        """The share explained around each region; regions for which it is unknown are left out."""
        return {c.region: c.explained for c in self.cells if c.explained is not None}


def analyse_residual(
    image: np.ndarray,
    grid: Grid,
    fitted: FitState,
    *,
    counted: np.ndarray | None = None,
    variance: Variance | None = None,
) -> Residual:
    """Compare an image with what a fit expects, at the scale of the PSF.

    Parameters
    ----------
    image
        (Z, Y, X) measured; NaN where missing.
    grid
        Grid of the image.
    fitted
        Last state of a fit.
    counted
        (Z, Y, X) bool: voxels that counted in it.
    variance
        Variance of voxels as a function of expected values; by default from the image's noise.

    Raises
    ------
    InputError
        As :func:`napari_deltamic.fit` does for images, or if the fit is of another image.
    """
    pixels, known = _seen(image, grid)
    if counted is not None:
        known = known & (np.asarray(counted) != 0)
    expected = fitted.rendered()
    if expected.shape != pixels.shape:
        raise InputError(f"the fit is of an image of shape {expected.shape}, not {pixels.shape}")
    spread = np.sqrt((variance or voxel_variance(image, pixels, known))(expected))
    pixels = filled_in(pixels, expected)
    deviation, sigma = _deviation(pixels, known, expected, spread), _voxels(fitted.optics, grid)
    smooth = smoothed(deviation, known, sigma)
    threshold = highest_by_chance(int(known.sum()), sigma)
    near, region = _surroundings(fitted.mesh, grid, fitted.optics)
    difference = np.where(known, pixels - expected, 0)
    found = [
        *_spots(smooth, difference, grid, fitted.mesh, threshold, 1),
        *_spots(smooth, difference, grid, fitted.mesh, threshold, -1),
    ]
    found.sort(key=lambda s: -abs(s.z))
    usable = known.reshape(-1)[near]
    near, region = near[usable], region[usable]
    values, left = (pixels / spread).reshape(-1)[near], deviation.reshape(-1)[near]
    weights = (1 / spread).reshape(-1)[near]
    cells = tuple(
        CellFit(int(r), *_explained(*own), _shown(*own))
        for r in fitted.mesh.region_ids()
        if (region == r).sum() > 1
        for own in [tuple(array[region == r] for array in (values, left, weights))]
    )
    whole = _explained(values, left, weights)[0] if len(near) > 1 else None
    return Residual(
        _with_gaps(smooth, known),
        tuple(found[: RESIDUAL.most_spots]),
        threshold,
        whole,
        cells,
    )


def residual_map(image: np.ndarray, grid: Grid, expected: np.ndarray, optics: Optics) -> np.ndarray:
    """The map of :func:`analyse_residual`, from an image and the expected one.

    Raises
    ------
    InputError
        As :func:`napari_deltamic.fit` does for images.
    """
    pixels, known = _seen(image, grid)
    spread = np.sqrt(voxel_variance(image, pixels, known)(expected))
    deviation = _deviation(filled_in(pixels, expected), known, expected, spread)
    return _with_gaps(smoothed(deviation, known, _voxels(optics, grid)), known)


def _seen(image: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """The image, and where it is known; hot voxels are left out, as in a fit."""
    pixels, known = check_image(image, grid)
    return pixels, known & ~hot_voxels(pixels, known)


def _deviation(
    pixels: np.ndarray, known: np.ndarray, expected: np.ndarray, spread: np.ndarray
) -> np.ndarray:
    """Measured minus expected in standard deviations; 0 where missing."""
    return np.where(known, (pixels - expected) / spread, 0).astype(np.float32)


def _voxels(optics: Optics, grid: Grid) -> np.ndarray:
    """Widths of the PSF in voxels."""
    return np.asarray(optics.sigma_um) / np.asarray(grid.voxel_size)


def _with_gaps(smooth: np.ndarray, known: np.ndarray) -> np.ndarray:
    return np.where(known, smooth, np.nan).astype(np.float32)


def highest_by_chance(voxels: int, sigma: np.ndarray) -> float:
    """Standard deviations that smoothed noise exceeds, up or down, in one image in 20.

    By the expected Euler characteristic of a Gaussian field (K. Worsley et al., J. Cereb. Blood
    Flow Metab. 12, 1992): ``R (4 ln 2)^(3/2) (2 pi)^-2 (z^2 - 1) exp(-z^2 / 2)`` with R the volume
    in units of the filter's full width at half maximum.
    """
    cells = voxels / float(np.prod(2 * sqrt(2 * log(2)) * np.maximum(sigma, 0.5)))
    # The formula is that of the paper; both signs count.
    factor = 2 * max(cells, 1.0) * (4 * log(2)) ** 1.5 / (2 * pi) ** 2

    def beyond(z: float) -> float:
        return factor * (z**2 - 1) * exp(-(z**2) / 2) - RESIDUAL.false_spots

    return float(brentq(beyond, 2.0, 12.0)) if beyond(2.0) > 0 else 3.0


def smoothed(deviation: np.ndarray, known: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Deviations (Z, Y, X) after a Gaussian filter, divided by what it leaves of white noise.

    This is the filter that best shows light spread by the PSF. Missing voxels are 0.
    """
    total = gaussian_filter(deviation, sigma, mode="constant", truncate=4)
    # The noise that is left: the sum of the squared weights of known voxels, which are those of a
    # Gaussian narrower by sqrt(2).
    share = gaussian_filter(known.astype(np.float32), sigma / sqrt(2), mode="constant", truncate=4)
    left = share * _self_overlap(sigma)
    out: np.ndarray = total / np.sqrt(np.maximum(left, 1e-6))  # only where nothing is known
    return np.where(known, out, 0)


def _self_overlap(sigma: np.ndarray) -> float:
    """Sum of the squared weights of the discrete Gaussian."""
    product = 1.0
    for s in sigma:
        k = np.arange(-int(4 * s + 0.5), int(4 * s + 0.5) + 1)
        w = np.exp(-0.5 * (k / max(s, 1e-6)) ** 2)  # only so that no blur can be asked for
        product *= float(((w / w.sum()) ** 2).sum())
    return product


def _surroundings(mesh: Mesh, grid: Grid, optics: Optics) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices of the voxels near the surface, and the region of the nearest face.

    A wall between two cells counts for the one on its first side.
    """
    width = np.asarray(optics.sigma_um)
    size, origin = np.asarray(grid.voxel_size), np.asarray(grid.origin)
    vertices = mesh.vertices_numpy()
    low = np.floor((vertices.min(0) - RESIDUAL.near * width - origin) / size).astype(int)
    high = np.ceil((vertices.max(0) + RESIDUAL.near * width - origin) / size).astype(int) + 1
    low, high = np.clip(low, 0, grid.shape), np.clip(high, 0, grid.shape)
    block = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    index = np.stack(np.meshgrid(*block, indexing="ij"), -1).reshape(-1, 3)
    flat = np.ravel_multi_index(tuple(index.T), grid.shape) if len(index) else np.zeros(0, int)
    tree = cKDTree(vertices[mesh.faces].mean(1) / width)
    distance, face = tree.query(
        (origin + index * size) / width, distance_upper_bound=RESIDUAL.near + 1
    )
    near = distance <= RESIDUAL.near
    sides = mesh.regions[face[near]]
    return flat[near], np.where(sides[:, 0] != 0, sides[:, 0], sides[:, 1])


def _explained(
    values: np.ndarray, deviation: np.ndarray, weights: np.ndarray
) -> tuple[float | None, float]:
    """Share of the variation beyond noise that is explained, and excess of the residual over noise.

    ``values`` and ``deviation`` are in standard deviations of the noise, ``weights`` their inverse;
    the excess is in standard deviations.
    """
    n = len(values)
    mean = float((values * weights).sum() / (weights**2).sum())
    varied = float(((values - mean * weights) ** 2).sum()) - n
    left = float((deviation.astype(np.float64) ** 2).sum()) - n
    z = left / sqrt(2 * n)
    return (min(1.0, 1 - max(left, 0.0) / varied) if varied > 3 * sqrt(2 * n) else None), z


def _shown(values: np.ndarray, deviation: np.ndarray, weights: np.ndarray) -> float:
    """Standard deviations of noise by which values vary as expected; arrays as for _explained."""
    ground = weights.astype(np.float64) / np.linalg.norm(weights)
    expected = (values - deviation).astype(np.float64)
    expected -= ground * (expected @ ground)
    size = float(np.linalg.norm(expected))
    return float(values @ expected) / size if size else 0.0


def _spots(
    smooth: np.ndarray,
    difference: np.ndarray,
    grid: Grid,
    mesh: Mesh,
    threshold: float,
    sign: int,
) -> Sequence[Spot]:
    """Connected places above three standard deviations, whose peaks are above the threshold."""
    labels, count = label(sign * smooth > RESIDUAL.spot)
    if not count:
        return []
    numbers = np.arange(1, count + 1)
    peaks = np.array(maximum_position(sign * smooth, labels, numbers))
    height = smooth[tuple(peaks.T)]
    high = np.abs(height) > threshold
    if not high.any():
        return []
    sizes = np.bincount(labels.reshape(-1), minlength=count + 1)[numbers]
    light = sum_labels(difference, labels, numbers)
    tree = cKDTree(mesh.vertices_numpy()[mesh.faces].mean(1))
    kept = np.flatnonzero(high)
    size, origin = np.asarray(grid.voxel_size), np.asarray(grid.origin)
    at = origin + peaks * size
    middles = origin + np.array(center_of_mass(labels > 0, labels, numbers[kept])) * size
    sides = mesh.regions[tree.query(at)[1]]
    nearest = np.where(sides[:, 0] != 0, sides[:, 0], sides[:, 1])
    voxel = float(np.prod(grid.voxel_size))
    return [
        Spot(
            (float(at[k, 0]), float(at[k, 1]), float(at[k, 2])),
            float(sizes[k] * voxel),
            float(height[k]),
            float(light[k]),
            int(nearest[k]),
            triple(middle),
        )
        for k, middle in zip(kept, middles, strict=True)
    ]
