"""Whether an image can be what it is said to be: a check of about a second before a fit.

A wrong voxel size, slices that lean, saturated or logarithmic brightness, an image without
structure, of one slice or of something other than the seeds, labels instead of an image, and time
taken for depth all lead to meaningless fits. None of them can be proved from one image, but each
leaves traces that sound images hardly show.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from ..common.doing import doing
from ..errors import DoubtWarning
from ..fitting.job import FitInput, levelled
from ..fitting.model.likelihood import voxel_noise
from ..fitting.model.saturation import cut_at
from ..fitting.voxels.voxel_ownership import surface_voxels
from ..geometry.distance_transform import distance_transform
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from ..images.missing import filled
from ..scene import Grid
from .compressed_brightness import compressed
from .first_sigma import first_sigma
from .slices import drift

Pixels = NDArray[np.float32]


@dataclass(frozen=True)
class SanityRules:
    """When a doubt is raised; chosen on the scenes of ``benchmarks.defaults.sanity``.

    Attributes
    ----------
    voxel_sides
        Least and largest side of a voxel in the plane of a light microscope, um. Chosen, not
        measured: from super-resolution to light sheets of whole animals.
    oblong
        Largest ratio of the sides of a voxel in the plane. Chosen: cameras and scanners have square
        pixels, so in another one the step along Z is most likely in the wrong place.
    psf_ratios
        Width of the PSF along Z over that in the plane. Light microscopes reach from 1 (a thin
        sheet) to about 6 (widefield, low aperture); a wrong step of Z multiplies it. Measured: 0.76
        to 4.8 in images in order, 0.20 to 0.23 where the step is a quarter of what it was.
    elongations
        Length of structures along Z over that in the plane, from the directions of their surfaces.
        Measured: 0.73 to 2.4 in order, 0.39 to 0.6 and 1.9 to 4.1 where the step is wrong. Spread
        cells are flat, red blood cells 0.33 to 0.59, so the lower bound is below all of these: a
        step that is too small shows in the PSF, too.
    doubtful_ratios, doubtful_elongations
        The same where both point the same way: both at once would be a coincidence otherwise.
        Measured: 2.4 in order where structures are long (widefield), 3.3 to 4.5 where the step is
        wrong; 0.7 in a real stack of red blood cells.
    lean
        Shift in the plane, um per um along Z: a stage that moves at 30 to 60 degrees to the plane
        would give 0.6 to 1.7.
    structure
        Standard deviation of the smoothed image over that of noise alone. Measured: 7 or more in
        order, 1.0 where there is only noise.
    lasting
        Correlation of the detail of slices half a stack or more apart: of depth about 0, of time
        near 1. Measured: 0.42 at most in 34 stacks (light cones, backgrounds that rise along X),
        0.87 or more in 14 films.
    followed
        Share of the image's variance around the seeds that distance to them explains: 0.08 or more
        in scenes whose seeds were half a radius off or had six bright neighbours, 0.09 at most with
        seeds of another image.
    flat
        Among the voxels without the most frequent value, the share with a neighbour of equal value
        along each axis. Measured: 0.98 in label images, 0.07 at most in ten stacks, even with 16
        grey levels; a smooth image has more than 0.6 only with fewer than ten levels.
    """

    voxel_sides: tuple[float, float] = (0.015, 5.0)
    oblong: float = 1.05
    psf_ratios: tuple[float, float] = (0.5, 9.0)
    elongations: tuple[float, float] = (0.2, 3.2)
    doubtful_ratios: tuple[float, float] = (0.6, 2.8)
    doubtful_elongations: tuple[float, float] = (0.6, 1.6)
    lean: float = 0.45
    structure: float = 1.5
    lasting: float = 0.6
    followed: float = 0.08
    flat: float = 0.8


@dataclass(frozen=True)
class Doubt:
    """Something that speaks against an image: a word for it, and a sentence for the user."""

    kind: str
    sentence: str


RULES = SanityRules()
SINGLE = (
    "only one slice holds an image, which does not tell how high cells are: their heights, shapes "
    "and volumes are guesses; use a stack of several slices"
)
_OF_SCALE = "voxel size", "lean", "time"  # kinds of doubts
_AROUND = 2.0  # radii of the seeds: the surroundings in which the image should follow them
_VOXELS = 4_000_000  # of the middle of the image: more would take longer than a second
_DETAIL = 2.0, 6.0  # voxels; chosen: finer is noise, coarser is light out of focus
_SMOOTHED = 1.5  # voxels: about as wide as a PSF, so that it stands out best


def doubts(
    image: np.ndarray,
    voxel_size: tuple[float, float, float],
    seeds: Mesh | None = None,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    close: bool = False,
) -> tuple[Doubt, ...]:
    """Doubts about an image, its voxel size and its seeds; usually none.

    Parameters
    ----------
    image
        (Z, Y, X); NaN where missing.
    voxel_size
        um, Z Y X.
    seeds
        Starting surfaces, um.
    origin
        um; centre of the first voxel.
    close
        Whether the seeds were found in this image, or are labels of it, so that their shapes are
        those in the image.
    """
    pixels = np.asarray(image)
    if single_slice(pixels):
        return (Doubt("slices", SINGLE),)
    if pixels.ndim != 3 or min(pixels.shape) < 4 or not np.isfinite(pixels).any():
        return ()
    doing("checking the image")
    cut = _middle(pixels.shape)
    known = np.isfinite(pixels[cut])
    if not known.any():
        return ()
    middle = np.asarray(filled(np.where(known, pixels[cut], np.nan), voxel_size), np.float32)
    if not np.ptp(middle) > 0:
        return ()
    if not structured(middle) > RULES.structure:
        sentence = (
            "the image shows nothing but noise: is it the right stack, and the right channel?"
        )
        return (Doubt("empty", sentence),)
    if flat(middle):
        sentence = (
            "each object in the image has one value, as in labels or a mask: use it as seeds, and "
            "the stack that it was drawn on as the image"
        )
        return (Doubt("labels", sentence),)
    doing()
    found = [_time(middle), _sides(voxel_size), _cut(pixels)]
    doing()
    found.append(_compressed(middle))
    doing()
    if found[0] is None:
        leaning = _lean(middle, voxel_size)
        found.append(leaning)
        if leaning is None and found[1] is None:
            found.append(_step(middle, voxel_size, seeds if close else None))
    doing()
    if seeds is not None and len(seeds.faces):
        grid = Grid(pixels.shape, voxel_size, origin)
        found.append(_seeds(pixels, grid, seeds))
    return tuple(d for d in found if d is not None)


def tell_doubts(job: FitInput) -> tuple[Doubt, ...]:
    """The doubts about the inputs of a fit, each also raised as a DoubtWarning."""
    found = _doubts_of(job)
    for doubt in found:
        warnings.warn(doubt.sentence, DoubtWarning, stacklevel=2)
    return found


def doubted_scale(job: FitInput) -> tuple[str, ...]:
    """What speaks against the voxel size or the axes, in sentences.

    No fit can answer that: voxels of another size make other shapes, which fit as well.
    """
    return tuple(doubt.sentence for doubt in _doubts_of(job) if doubt.kind in _OF_SCALE)


def _doubts_of(job: FitInput) -> tuple[Doubt, ...]:
    return doubts(
        levelled(np.asarray(job.image), job.grid, job.settings.scene.effects),
        job.grid.voxel_size,
        job.mesh,
        job.grid.origin,
        close=job.kind != "rough",
    )


def _middle(shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Slices of the middle of the plane, with all of Z, since slices are compared."""
    share = min(1.0, (_VOXELS / np.prod(shape, dtype=float)) ** 0.5)
    kept = [max(1, int(n * share)) for n in shape[1:]]
    plane = (slice((n - k) // 2, (n - k) // 2 + k) for n, k in zip(shape[1:], kept, strict=True))
    return (slice(None), *plane)


# What is measured ------------------------------------------------------------------------------


def structured(pixels: Pixels) -> float:
    """Standard deviation of the smoothed image over that of its smoothed noise."""
    noise = voxel_noise(pixels, np.ones(pixels.shape, bool))
    smooth = gaussian_filter(pixels, _SMOOTHED)
    # By definition a Gaussian leaves 1 / (2 sqrt(pi) width) of the variance along each axis.
    left = noise / (2 * np.sqrt(np.pi) * _SMOOTHED) ** 1.5
    return float(smooth.std() / left) if left > 0 else float("inf")


def lasting(pixels: Pixels) -> float:
    """Mean correlation of slices that are half a stack or more apart, times (1 at most) the
    contrast of slices at the end of the stack that has less of it, over the median contrast.

    For fine detail only: what is smooth in the plane persists through depth in widefield, too.
    """
    smooth = gaussian_filter(pixels, (0, _DETAIL[0], _DETAIL[0]))
    smooth -= gaussian_filter(smooth, (0, _DETAIL[1], _DETAIL[1]))
    smooth = smooth[:, ::2, ::2].reshape(len(pixels), -1)
    flat = smooth - smooth.mean(1, keepdims=True)
    size = np.linalg.norm(flat, axis=1)
    related = (flat @ flat.T) / np.maximum(np.outer(size, size), 1e-30)
    apart = np.abs(np.subtract.outer(np.arange(len(flat)), np.arange(len(flat))))
    far = related[apart >= len(flat) / 2]
    ends = max(1, len(size) // 8)
    steady = min(size[:ends].mean(), size[-ends:].mean()) / max(float(np.median(size)), 1e-30)
    return float(far.mean() * min(1.0, steady))


def flat(pixels: Pixels) -> bool:
    """Whether the image consists of pieces with one value each, as labels and masks do."""
    values, counts = np.unique(pixels, return_counts=True)
    other = pixels != values[counts.argmax()]
    alike = other.copy()
    for axis in range(3):
        same = np.pad(
            np.diff(pixels, axis=axis) == 0, [(1, 1) if a == axis else (0, 0) for a in range(3)]
        )
        ends = np.moveaxis(same, axis, 0)
        alike &= np.moveaxis(ends[1:] | ends[:-1], 0, axis)
    return bool(alike.sum() > RULES.flat * other.sum())


def elongation(pixels: Pixels, voxel_size: tuple[float, float, float], seeds: Mesh | None) -> float:
    """Length of structures along Z over that in the plane, from the directions of surfaces.

    The mean square of the Z component of an ellipsoid's normals tells the ratio of its axes.
    """
    facing = _facing_of(pixels, voxel_size) if seeds is None else _facing_of_mesh(seeds)
    return float(np.exp(np.interp(-facing, -_FACING, _LOG_RATIOS)))


def _facing_of_mesh(mesh: Mesh) -> float:
    areas, normals = mesh.areas(), mesh.normals()
    return float((areas * normals[:, 0] ** 2).sum() / areas.sum())


def _facing_of(pixels: Pixels, voxel_size: tuple[float, float, float]) -> float:
    """Mean square of the Z component of surface normals in the image, from isotropic gradients."""
    size = np.asarray(voxel_size)
    width = _SMOOTHED * float(size.max())
    blurred = pixels
    for axis in range(3):
        blurred = gaussian_filter1d(blurred, max(width / size[axis], 0.5), axis, mode="nearest")
    edge = tuple(slice(1, -1) if n > 4 else slice(None) for n in pixels.shape)
    parts = [np.gradient(blurred, size[axis], axis=axis)[edge] for axis in range(3)]
    squared = [p.astype(np.float64) ** 2 for p in parts]
    whole = squared[0] + squared[1] + squared[2]
    strong = whole > np.percentile(whole, 70)
    return float((squared[0][strong] / whole[strong]).mean())


def _facing_table() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean square of the Z component of a spheroid's normals, and the log of its axis ratio."""
    logs = np.linspace(-2.5, 2.5, 41)  # ratios up to 12, more than any that could be doubted
    t = (np.arange(4000) + 0.5) / 4000 * np.pi / 2  # from the pole
    found = []
    for ratio in np.exp(logs):
        # A spheroid of radius 1 in the plane: the element of area, and its normal.
        stretch = np.sqrt((ratio * np.sin(t)) ** 2 + np.cos(t) ** 2)
        area, z = np.sin(t) * stretch, np.cos(t) / stretch
        found.append((area * z**2).sum() / area.sum())
    return np.asarray(found), logs


_FACING, _LOG_RATIOS = _facing_table()


def followed(pixels: np.ndarray, grid: Grid, seeds: Mesh) -> float:
    """Share of the image's variance around the seeds that the distance to their surface explains.

    Distances, negative inside, are grouped into classes of an eighth of a radius; the means of the
    classes explain as much as any light of membranes, insides or haze around them could.
    """
    labels = voxel_labels(seeds, grid.shape, grid.voxel_size, grid.origin)
    surface = surface_voxels(seeds, grid)
    if not surface.any():
        return 0.0
    away = distance_transform(~surface, np.asarray(grid.voxel_size))
    away = np.where((labels > 0) & ~surface, -away, away)
    known = np.isfinite(pixels)
    whole = np.where(known, pixels, float(np.median(pixels[known]))).astype(np.float32)
    cells = max(len(seeds.region_ids()), 1)
    radius = float(np.sqrt(seeds.areas().sum() / cells / (4 * np.pi)))
    near = known & (away < _AROUND * radius)
    if not near.any():
        return 0.0
    values = gaussian_filter(whole, 1.0)[near].astype(np.float64)
    classes = ((away[near] / radius + 2) * 8).clip(0).astype(int)
    count = np.bincount(classes)
    mean = np.bincount(classes, values) / np.maximum(count, 1)
    total = float(values.var())
    between = float((count * (mean - values.mean()) ** 2).sum()) / max(len(values), 1)
    return between / total if total > 0 else 0.0


def _oblong(voxel_size: tuple[float, float, float]) -> tuple[float, float] | None:
    """The sides of a voxel along Y and X, um, where they differ; None where it is square."""
    y, x = voxel_size[1:]
    return (y, x) if max(y, x) > RULES.oblong * min(y, x) else None


def single_slice(image: NDArray[Any]) -> bool:
    """Whether only one slice of a stack (Z, Y, X) holds more than one value; NaN is none."""
    if image.ndim != 3 or not image.size:
        return False
    known = np.isfinite(image)
    high, low = (
        f(np.where(known, image, end), axis=(1, 2))
        for f, end in ((np.max, -np.inf), (np.min, np.inf))
    )
    return int(np.count_nonzero(high > low)) == 1


# What is said ----------------------------------------------------------------------------------


def _oblong_told(sides: tuple[float, float]) -> str:
    """The sentence for users on voxels that are not square in the plane; sides along Y, X in um."""
    return (
        f"voxels are {sides[0]:g} um along Y but {sides[1]:g} um along X, which is unusual for a "
        "microscope: is the voxel size in the order Z Y X?"
    )


def _time(pixels: Pixels) -> Doubt | None:
    if len(pixels) < 6 or lasting(pixels) < RULES.lasting:
        return None
    return Doubt(
        "time",
        "all slices show nearly the same scene: is this a time series, with time taken for depth? "
        "Open one time point, or correct the axes",
    )


def _sides(voxel_size: tuple[float, float, float]) -> Doubt | None:
    low, high = RULES.voxel_sides
    plane = voxel_size[1:]
    if min(plane) >= low and max(plane) <= high and voxel_size[0] <= 10 * high:
        sides = _oblong(voxel_size)
        return None if sides is None else Doubt("voxel size", _oblong_told(sides))
    shown = " ".join(f"{v:g}" for v in voxel_size)
    return Doubt(
        "voxel size",
        f"voxels of {shown} um (Z Y X) are unusual for a light microscope: is the voxel size in "
        "um, and in the order Z Y X?",
    )


def _cut(pixels: np.ndarray) -> Doubt | None:
    cut = cut_at(pixels[np.isfinite(pixels)])
    if cut is None:
        return None
    share = float((pixels >= cut).mean())
    return Doubt(
        "saturation",
        f"{share:.1%} of the voxels are saturated at {cut:g}: they count as at least that "
        "bright; a shorter exposure would show more",
    )


def _compressed(pixels: Pixels) -> Doubt | None:
    if not compressed(pixels):
        return None
    return Doubt(
        "brightness",
        "the noise is smaller where the image is brighter: its intensities look log-scaled, which "
        "shifts every surface; use the image as the camera took it",
    )


def _lean(pixels: Pixels, voxel_size: tuple[float, float, float]) -> Doubt | None:
    lean, _ = drift(pixels, voxel_size)
    if lean.value is None or lean.value - 3 * lean.error < RULES.lean:
        return None
    return Doubt(
        "lean",
        f"the slices shift sideways by {lean.value:.2g} um per um of depth: this looks like the "
        "raw stack of a tilted light sheet or of a drifting stage; deskew or register it first",
    )


def _step(
    pixels: Pixels,
    voxel_size: tuple[float, float, float],
    seeds: Mesh | None,
) -> Doubt | None:
    width = first_sigma(pixels, voxel_size, insides=False)  # as the bounds were measured
    ratio = None
    if width.z.value is not None and width.yx.value is not None:
        ratio = width.z.value / width.yx.value
    longer = elongation(pixels, voxel_size, seeds)
    large = longer > RULES.elongations[1]
    small = longer < RULES.elongations[0]
    if ratio is not None:
        large |= ratio > RULES.psf_ratios[1]
        small |= ratio < RULES.psf_ratios[0]
        large |= ratio > RULES.doubtful_ratios[1] and longer > RULES.doubtful_elongations[1]
        small |= ratio < RULES.doubtful_ratios[0] and longer < RULES.doubtful_elongations[0]
    if large == small:
        return None
    word = "long" if large else "flat"
    blur = "" if ratio is None else f" and blur {ratio:.2g} times as wide along Z as across"
    asked = f"is the step along Z too {'large' if large else 'small'}"
    if small and voxel_size[0] < min(voxel_size[1:]):
        asked += ", or is the order of the sizes not Z, Y, X"
    return Doubt(
        "voxel size",
        f"with voxels of {voxel_size[0]:g} um along Z everything is {word} ({longer:.2g} times as "
        f"long along Z as across){blur}: {asked}?",
    )


def _seeds(pixels: np.ndarray, grid: Grid, seeds: Mesh) -> Doubt | None:
    share = followed(pixels, grid, seeds)
    if share >= RULES.followed:
        return None
    return Doubt(
        "seeds",
        f"the image does not match the seeds (they explain {share:.1%} of it around them): do "
        "both belong to the same channel, time and voxel size?",
    )
