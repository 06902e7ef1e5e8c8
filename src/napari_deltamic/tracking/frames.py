"""Decides which frames of a series can be used: those that went wrong are left out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..errors import InputError
from ..images.missing import unmasked
from ..images.padding import without_padding
from ..optics import Optics
from ..scene import Grid
from .track_rules import RULES

_RULES = RULES.frames


def numbered(images: Any, first: int = 0) -> Iterator[tuple[int, NDArray[Any] | str]]:
    """Yield frame numbers from ``first`` on, each with its image, or why it cannot be read."""
    if hasattr(images, "__getitem__") and hasattr(images, "__len__"):
        for frame in range(first, len(images)):
            try:
                yield frame, np.asarray(unmasked(images[frame]))
            except InputError as error:
                yield frame, str(error)
        return
    for frame, image in enumerate(images):
        if frame >= first:
            yield frame, np.asarray(unmasked(image))


def check_series(images: Any) -> None:
    """Raise InputError unless images are a series of 3D images, as far as known before reading."""
    shape = getattr(images, "shape", None)
    if shape is not None and len(shape) != 4:
        kind = "a single 3D image: fit it instead" if len(shape) == 3 else f"shape {tuple(shape)}"
        raise InputError(f"tracking needs a series of 3D images (T, Z, Y, X), not {kind}")
    if isinstance(images, (Sequence, np.ndarray)) or hasattr(images, "__len__"):
        n = len(images)
        if n < 2:
            raise InputError(f"tracking needs two frames or more, not {n}")
    elif not isinstance(images, Iterable):
        raise InputError("tracking needs a series of 3D images (T, Z, Y, X)")


@dataclass(frozen=True, eq=False)
class Frame:
    """An image of a series.

    image : (Z, Y, X) float32, 0 where it is not known.
    known : (Z, Y, X) where it is known.
    """

    number: int
    image: NDArray[np.float32]
    known: NDArray[np.bool_]

    @staticmethod
    def of(number: int, image: NDArray[Any], grid: Grid) -> Frame:
        """Make a frame from an array. InputError if the array is not an image of the grid."""
        if image.ndim != 3:
            raise InputError(f"frame {number} is not a 3D image: its shape is {image.shape}")
        if image.shape != grid.shape:
            raise InputError(
                f"frame {number} has shape {image.shape}, the others {grid.shape}: "
                "all frames must be of one size"
            )
        if not np.issubdtype(image.dtype, np.number) or np.iscomplexobj(image):
            raise InputError(f"an image of real numbers is needed, not of {image.dtype}")
        values = without_padding(image)[0].astype(np.float32)
        known = np.isfinite(values)
        return Frame(number, np.where(known, values, 0).astype(np.float32), known)

    @cached_property
    def pixels(self) -> NDArray[np.float32]:
        """The image with NaN where it is not known, as a fit takes it."""
        return np.where(self.known, self.image, np.float32(np.nan))


@dataclass(frozen=True)
class _Look:
    """How an image looks: contrast (in its units), sharpness and saturation (shares)."""

    contrast: float
    sharpness: float
    saturation: float


class Quality:
    """Judges frames by comparing them with those before."""

    def __init__(self, grid: Grid, optics: Optics) -> None:
        self._width = np.asarray(optics.sigma_um) / np.asarray(grid.voxel_size)
        self._looks: list[_Look] = []
        self._losses: list[float] = []

    def flaw(self, image: NDArray[Any]) -> str:
        """Say why an image cannot be used, before it is fitted; "" if it can."""
        known = np.isfinite(image)
        if not known.any():
            return "every voxel is missing (NaN)"
        if known.mean() < _RULES.known:
            return f"only {known.mean():.0%} of its voxels are known"
        low, high = float(image[known].min()), float(image[known].max())
        if low == high:
            return f"it is flat: every voxel is {low:g}"
        look = self._look(image, known)
        if not self._looks:
            return ""
        usual = _Look(*(float(np.median(v)) for v in zip(*map(astuple, self._looks), strict=True)))
        if look.contrast < _RULES.dim * usual.contrast:
            return f"it is dark: its contrast is {look.contrast / usual.contrast:.0%} of the usual"
        if look.saturation > max(_RULES.saturated, _RULES.many_times * usual.saturation):
            return f"it is saturated: {look.saturation:.0%} of its voxels have the largest value"
        if look.sharpness < _RULES.blurred * usual.sharpness:
            share = look.sharpness / usual.sharpness
            return f"it is out of focus: its fine structure is {share:.0%} of the usual"
        return ""

    def misfit(self, loss: float) -> str:
        """Say why a fit with this loss cannot be trusted; "" if it can."""
        if not self._losses:
            return ""
        usual = float(np.median(self._losses))
        if loss > _RULES.worse * usual and loss > usual + _RULES.much:
            explained = f"{1 - min(loss, 1):.0%} instead of {1 - min(usual, 1):.0%}"
            return f"the meshes explain {explained} of it"
        return ""

    def odd(self, loss: float) -> bool:
        """Whether the loss is so unusual that another fit may explain the frame better."""
        return bool(self._losses) and loss > _RULES.odd * float(np.median(self._losses))

    def accept(self, image: NDArray[Any], loss: float) -> None:
        """Remember a good frame, with which the next ones are compared."""
        self._looks = [*self._looks, self._look(image, np.isfinite(image))][-_RULES.remembered :]
        self._losses = [*self._losses, loss][-_RULES.remembered :]

    def _look(self, image: NDArray[Any], known: NDArray[np.bool_]) -> _Look:
        filled = np.where(known, image, np.median(image[known])).astype(np.float32)
        fine = gaussian_filter(filled, self._width)
        dark, bright = np.percentile(fine[known], (_RULES.background, _RULES.brightest))
        contrast = float(bright - dark)
        detail = (fine - gaussian_filter(fine, _RULES.detail * self._width))[known]
        high = float(image[known].max())
        return _Look(
            contrast,
            float(detail.std()) / max(contrast, 1e-30),
            float((image[known] >= high).mean()),
        )
