"""What is refused before a fit starts, in one line each."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from ...errors import InputError
from ...geometry.mesh import FloatArray, Mesh
from ...images.missing import unmasked
from ...optics import Optics
from ...scene import Grid

# Squares of what lies outside are lost in single precision: a fit then changes with the unit.
_SMALLEST, _LARGEST = 1e-9, 1e17
FEWEST_VOXELS = 64  # that a fit needs
_WIDEST = 3.0  # PSF, in sides of the image: a stack of few planes may be thinner than its PSF


def check_image(
    image: np.ndarray | Tensor, grid: Grid, counted: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Float32 image without NaN, and where it is known and counted; masked voxels are not.

    Raises
    ------
    InputError
        If it is not 3D, empty, infinite, has no known voxel, is flat, does not fit the grid, or
        its range is too small or too large for single precision.
    """
    pixels = np.asarray(image.detach().cpu() if isinstance(image, Tensor) else unmasked(image))
    if pixels.ndim != 3:
        raise InputError(f"a 3D image (Z, Y, X) is needed, not one of {pixels.ndim} dimensions")
    if pixels.size == 0:
        raise InputError("the image is empty")
    if not np.issubdtype(pixels.dtype, np.number) or np.iscomplexobj(pixels):
        raise InputError(f"an image of real numbers is needed, not of {pixels.dtype}")
    if pixels.shape != grid.shape:
        raise InputError(f"the image has shape {pixels.shape}, the grid {grid.shape}")
    infinite = int(np.isinf(pixels).sum())
    if infinite:
        raise InputError(
            f"the image holds {infinite} infinite voxels; set them to NaN to leave them out"
        )
    known = ~np.isnan(pixels)
    if not known.any():
        raise InputError("every voxel of the image is missing (NaN)")
    low, high = float(pixels[known].min()), float(pixels[known].max())
    if low == high:
        raise InputError(f"the image is flat: every voxel is {low:g}")
    if max(-low, high) > _LARGEST or high - low < _SMALLEST:
        raise InputError(
            f"the image lies between {low:g} and {high:g}: multiply it by a number that brings it "
            "to an ordinary range, 0 to 1000 for example"
        )
    pixels = np.where(known, pixels, 0).astype(np.float32)
    return pixels, known if counted is None else known & checked_mask(counted, grid)


def checked_mask(counted: np.ndarray, grid: Grid) -> np.ndarray:
    """(Z, Y, X) bool: the voxels that may count; InputError if the mask does not fit the grid."""
    if counted.shape != grid.shape:
        raise InputError(f"counted has shape {counted.shape}, the image {grid.shape}")
    found: np.ndarray = np.asarray(unmasked(counted, 0)) != 0
    return found


def check_mesh(mesh: Mesh, grid: Grid) -> None:
    """InputError where a mesh lies wholly outside the image."""
    if not mesh.areas().sum() > 0:
        raise InputError("the mesh has no area")
    low, high = mesh.bounds()
    check_inside("the mesh", low, high, grid)


def check_inside(what: str, low: FloatArray, high: FloatArray, grid: Grid) -> None:
    """InputError where what reaches from ``low`` to ``high`` um lies wholly outside the image."""
    first, last = grid.extent
    if (np.asarray(high) < first).any() or (np.asarray(low) > last).any():
        ranges = " ".join(f"{a:.3g}..{b:.3g}" for a, b in zip(low, high, strict=True))
        image = " ".join(f"{a:.3g}..{b:.3g}" for a, b in zip(first, last, strict=True))
        raise InputError(f"{what} ({ranges} um, Z Y X) lies outside the image ({image} um)")


def check_psf(optics: Optics, grid: Grid) -> None:
    """InputError where a PSF is so wide that its numbers must be of another unit."""
    sides = zip("ZYX", optics.sigma_um, grid.voxel_size, grid.shape, strict=True)
    for axis, sigma, size, n in sides:
        if sigma > _WIDEST * n * size:
            raise InputError(
                f"the PSF has a standard deviation of {sigma:.3g} um along {axis}, where the image "
                f"is only {n * size:.3g} um wide: its numbers are in um"
            )
