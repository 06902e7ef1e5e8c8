"""Bands: which wavevectors are computed, and the transform from there to an image.

The optical transfer function (OTF) is a low-pass filter, so only wavevectors near zero matter; the
image is real, so half of them suffice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import floor, pi
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..common.kept import kept
from ..common.one_thread import product
from .real_fft import RealFFT


@dataclass(frozen=True, eq=False)
class Band:
    """Wavevectors ``(kz, ky, kx) * spacing`` with indices up to ``half``, kx from 0 on.

    Parameters
    ----------
    fft_shape
        Shape (Z, Y, X) of the periodic grid.
    voxel_size
        um, Z, Y, X.
    half
        Largest index along each axis; at most half the grid.
    radius
        Half axes, in rad/um, of the ellipsoid that holds the band; None: all of the box.
    """

    fft_shape: tuple[int, int, int]
    voxel_size: tuple[float, float, float]
    half: tuple[int, int, int]
    radius: tuple[float, float, float] | None = None

    @classmethod
    def within(
        cls,
        fft_shape: tuple[int, int, int],
        voxel_size: tuple[float, float, float],
        radius: tuple[float, float, float],
        aligned: bool = True,
    ) -> Band:
        """Make the band inside an ellipsoid of half axes ``radius`` (rad/um), cut off by the grid.

        Where the ellipsoid is tilted (not ``aligned``), ``radius`` are the half sides of the box
        around it, and all of the box is the band.
        """
        spacing = [2 * pi / (n * d) for n, d in zip(fft_shape, voxel_size, strict=True)]
        half = tuple(
            min(floor(r / s), n // 2) for r, s, n in zip(radius, spacing, fft_shape, strict=True)
        )
        return cls(fft_shape, voxel_size, half, radius if aligned else None)  # type: ignore[arg-type]

    @classmethod
    def full(cls, fft_shape: tuple[int, int, int], voxel_size: tuple[float, float, float]) -> Band:
        """Make the band of every wavevector of the grid."""
        return cls(fft_shape, voxel_size, tuple(n // 2 for n in fft_shape))  # type: ignore[arg-type]

    @property
    def spacing(self) -> tuple[float, float, float]:
        """Wavenumber (rad/um) from one index to the next, along each axis."""
        z, y, x = (2 * pi / (n * d) for n, d in zip(self.fft_shape, self.voxel_size, strict=True))
        return z, y, x

    @property
    def box_shape(self) -> tuple[int, int, int]:
        """Shape of the tensor that holds the band: (2 Kz + 1, 2 Ky + 1, Kx + 1)."""
        return 2 * self.half[0] + 1, 2 * self.half[1] + 1, self.half[2] + 1

    def axes(self, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor, Tensor]:
        """Wavevector components (rad/um) along each axis, shaped to broadcast over the box."""
        z, y, x = (
            torch.arange(first, k + 1, dtype=torch.float64) * s
            for first, k, s in zip(
                (-self.half[0], -self.half[1], 0), self.half, self.spacing, strict=True
            )
        )
        return z.to(dtype)[:, None, None], y.to(dtype)[None, :, None], x.to(dtype)[None, None, :]

    @cached_property
    def rows(self) -> Tensor:
        """(R, 3) int32: kz, ky and length of each row along kx inside the ellipsoid."""
        kz, ky = np.meshgrid(
            np.arange(-self.half[0], self.half[0] + 1),
            np.arange(-self.half[1], self.half[1] + 1),
            indexing="ij",
        )
        if self.radius is None:
            length = np.full(kz.shape, self.half[2] + 1)
        else:
            s, r = self.spacing, self.radius
            left = 1 - (kz * s[0] / r[0]) ** 2 - (ky * s[1] / r[1]) ** 2
            reach = np.floor(np.sqrt(np.maximum(left, 0)) * r[2] / s[2]) + 1
            length = np.where(left >= 0, np.minimum(reach, self.half[2] + 1), 0)
        keep = length > 0
        return torch.from_numpy(np.stack([kz[keep], ky[keep], length[keep]], 1).astype(np.int32))

    @cached_property
    def row_index(self) -> Tensor:
        """Positions of the rows' entries in the flattened box."""
        r = self.rows.to(torch.int64)
        _, ny, nx = self.box_shape
        first = ((r[:, 0] + self.half[0]) * ny + r[:, 1] + self.half[1]) * nx
        start = torch.repeat_interleave(torch.cumsum(r[:, 2], 0) - r[:, 2], r[:, 2])
        return torch.repeat_interleave(first, r[:, 2]) + torch.arange(len(start)) - start

    @property
    def count(self) -> int:
        """Number of wavevectors in the rows."""
        return int(self.rows[:, 2].sum())

    def to_box(self, values: Tensor) -> Tensor:
        """Put row entries (K,) into the box, which is zero outside the ellipsoid."""
        box = values.new_zeros(self.box_shape).reshape(-1)
        index = self._row_index_on(values.device)
        return box.index_copy(0, index, values).reshape(self.box_shape)

    @kept
    def _row_index_on(self, device: torch.device) -> Tensor:
        return self.row_index.to(device)

    def widened(self, box: Tensor, to: Band) -> Tensor:
        """Zero-pad the box to that of a wider band."""
        if self.half == to.half:
            return box
        z, y, x = (n - k for n, k in zip(to.half, self.half, strict=True))
        return torch.nn.functional.pad(box, (0, x, y, y, z, z))

    def to_image(
        self,
        box: Tensor,
        shape: tuple[int, int, int],
        otf: Tensor | None = None,
        known: Tensor | None = None,
    ) -> Tensor:
        """Inverse-transform a box and crop the result to ``shape`` voxels from the origin on.

        The box, times the OTF if one is given, is the transform of a density per um^3; the result
        is the amount in each voxel. known : the result, if only its gradients are wanted.
        """
        if otf is not None and (otf.requires_grad or otf.is_complex() or otf.shape != box.shape):
            box, otf = product(box, otf), None
        return _Image.apply(box, otf, self._inverse_to(shape), known)

    @kept
    def _inverse_to(self, shape: tuple[int, int, int]) -> RealFFT:
        # On an even axis +n/2 and -n/2 are one wavevector: their mean is taken, as images are real.
        z, y = (
            np.where(2 * np.abs(np.arange(-k, k + 1)) == n, 0.5, 1.0) / n
            for k, n in zip(self.half[:2], self.fft_shape[:2], strict=True)
        )
        n, k = self.fft_shape[2], np.arange(self.half[2] + 1)
        x = np.full(len(k), 1 / n)
        mirrored = np.where((k == 0) | (2 * k == n), x, 2 * x)
        return RealFFT(self.fft_shape, self.half, shape, (z, y, mirrored), (z, y, x))


class _Image(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, box: Tensor, otf: Tensor | None, fft: RealFFT, known: Tensor | None
    ) -> Tensor:
        ctx.fft, ctx.otf = fft, otf
        return fft.to_real(box, otf) if known is None else known

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None, None]:
        return ctx.fft.to_box(grad, ctx.otf), None, None, None
