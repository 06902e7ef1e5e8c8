"""The grid: where the voxels of an image lie."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from math import isfinite

import numpy as np

from ..errors import InputError
from ..geometry.arrays import FARTHEST

_SMALLEST = 1e-9  # um, of a voxel


@dataclass(frozen=True)
class Grid:
    """Image shape, voxel size and origin, all in Z, Y, X; lengths in um.

    Voxel (k, j, i) is centred at ``origin + (k, j, i) * voxel_size``.

    Raises
    ------
    InputError
        If the shape is not three positive numbers, the voxel size is not positive or that of no
        microscope, or the origin is not finite.
    """

    shape: tuple[int, int, int]
    voxel_size: tuple[float, float, float]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        try:
            shape = tuple(operator.index(n) for n in self.shape)
        except TypeError:
            shape = ()
        if len(shape) != 3 or any(n < 1 for n in shape):
            raise InputError(f"an image has a shape of three positive numbers, not {self.shape}")
        try:
            size = tuple(float(d) for d in self.voxel_size)
            origin = tuple(float(o) for o in self.origin)
        except (TypeError, ValueError):
            raise InputError("voxel size and origin take three numbers (Z, Y, X) in um") from None
        if len(size) != 3 or not all(isfinite(d) and d > 0 for d in size):
            raise InputError(
                f"voxel size must be three positive numbers (um), not {self.voxel_size}"
            )
        if not all(_SMALLEST <= d <= 1 / _SMALLEST for d in size):
            raise InputError(f"voxels of {self.voxel_size} um cannot be computed with")
        if len(origin) != 3 or not all(abs(o) < FARTHEST for o in origin):
            raise InputError(
                f"origin must be three finite numbers (um), below {FARTHEST:g}, not {self.origin}"
            )
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "voxel_size", size)
        object.__setattr__(self, "origin", origin)

    @property
    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """The centres of the first and the last voxel, (3,) um each."""
        first = np.asarray(self.origin)
        return first, first + (np.asarray(self.shape) - 1) * np.asarray(self.voxel_size)

    def as_plain(self) -> dict[str, list[float]]:
        """Return the grid as plain values, for JSON."""
        return {
            "shape": list(self.shape),
            "voxel_size_um": list(self.voxel_size),
            "origin_um": list(self.origin),
        }

    def strided(self, step: tuple[int, int, int]) -> Grid:
        """Return the grid of every ``step``-th voxel, from the first on."""
        return Grid(
            tuple((n - 1) // s + 1 for n, s in zip(self.shape, step, strict=True)),  # type: ignore[arg-type]
            tuple(d * s for d, s in zip(self.voxel_size, step, strict=True)),  # type: ignore[arg-type]
            self.origin,
        )
