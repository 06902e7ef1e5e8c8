"""An image with its gradient by FINUFFT, as lean as it can be: no autograd, plans and points made.

Imported by :mod:`.child` in a process of its own.
"""

from __future__ import annotations

import math
from typing import Any

import finufft
import numpy as np
import torch
from torch import Tensor

UPSAMPLINGS = (1.25, 1.5, 2.0)


class Evaluation:
    """Weighted points to an image; a cotangent of the image to one of points and weights.

    Parameters
    ----------
    points, weights : (M, 3) voxels from the first one's centre, (M,).
    fft_shape, shape : of the periodic grid, and of the image in its first corner.
    half : largest index of the band along each axis; half of it suffices, since images are real.
    sigma : voxels, of the Gaussian PSF.
    """

    def __init__(
        self,
        points: np.ndarray,
        weights: np.ndarray,
        fft_shape: tuple[int, ...],
        shape: tuple[int, ...],
        half: tuple[int, ...],
        sigma: tuple[float, ...],
        eps: float,
        upsampling: float,
        threads: int,
    ) -> None:
        self._fft_shape, self._shape, self._half = fft_shape, shape, half
        angle = points * (2 * np.pi / np.array(fft_shape))
        angle -= 2 * np.pi * np.round(angle / (2 * np.pi))
        self._angle = [np.ascontiguousarray(angle[:, k], np.float32) for k in range(3)]
        self._weights = weights.astype(np.complex64)
        modes = (2 * half[0] + 1, 2 * half[1] + 1, half[2] + 1)
        # FINUFFT counts modes from -n//2 on, half a band from 0 on.
        self._shift = np.exp(-1j * (modes[2] // 2) * self._angle[2]).astype(np.complex64)
        given: dict[str, Any] = {"eps": eps, "dtype": "complex64", "nthreads": threads}
        given["upsampfac"] = upsampling
        self._there = finufft.Plan(1, modes, isign=-1, **given)
        self._back = finufft.Plan(2, modes, n_trans=4, isign=1, **given)
        first = (-half[0], -half[1], 0)
        xi = [
            torch.arange(f, k + 1) * (2 * math.pi / n)
            for f, k, n in zip(first, half, fft_shape, strict=True)
        ]
        z, y, x = xi[0][:, None, None], xi[1][None, :, None], xi[2][None, None]
        squares = sum((s * k) ** 2 for s, k in zip(sigma, (z, y, x), strict=True))
        self._otf = torch.exp(-0.5 * squares).to(torch.complex64)
        self._slopes = [1j * k.to(torch.complex64) for k in (z, y, x)]

    def __call__(self, cotangent: Tensor) -> tuple[Tensor, np.ndarray]:
        """The image, and the derivative in weights (0) and places (1 to 3), (4, M)."""
        self._there.setpts(*self._angle)
        box = torch.from_numpy(self._there.execute(self._weights * self._shift))
        image = torch.fft.irfftn(self._spread(box * self._otf), s=self._fft_shape)
        image = image[tuple(slice(0, n) for n in self._shape)]
        padded = torch.zeros(self._fft_shape)
        padded[tuple(slice(0, n) for n in self._shape)] = cotangent
        back = self._cut(torch.fft.rfftn(padded)) * self._otf
        back[..., 1:] *= 2  # both halves
        every = torch.stack([back, *(back * slope for slope in self._slopes)]).numpy()
        self._back.setpts(*self._angle)
        field = (self._back.execute(every) * self._shift.conj()).real
        field[1:] *= self._weights.real
        return image, field / math.prod(self._fft_shape)

    def _spread(self, box: Tensor) -> Tensor:
        nz, ny, nx = self._fft_shape
        full = torch.zeros((nz, ny, nx // 2 + 1), dtype=torch.complex64)
        for theirs, ours in self._corners():
            full[theirs] = box[ours]
        return full

    def _cut(self, full: Tensor) -> Tensor:
        hz, hy, hx = self._half
        box = torch.zeros((2 * hz + 1, 2 * hy + 1, hx + 1), dtype=torch.complex64)
        for theirs, ours in self._corners():
            box[ours] = full[theirs]
        return box

    def _corners(self) -> list[tuple[Any, Any]]:
        """Slices of the spectrum as the FFT has it, and of the box, of its four parts."""
        (hz, hy, hx), (nz, ny, _) = self._half, self._fft_shape
        ends = []
        for h, n in ((hz, nz), (hy, ny)):
            ends.append([(slice(0, h + 1), slice(h, 2 * h + 1)), (slice(n - h, n), slice(0, h))])
        along = slice(0, hx + 1)
        return [((z[0], y[0], along), (z[1], y[1], slice(None))) for z in ends[0] for y in ends[1]]


def measured(
    job: dict[str, Any], points: np.ndarray, weights: np.ndarray, exact: np.ndarray, timed: Any
) -> dict[str, Any]:
    """Seconds with the coarsest tolerance whose image is as good as asked, the best upsampling.

    Where none is, that of the best image.
    """
    voxel = np.array(job["voxel_size"])
    shape = tuple(exact.shape)
    cotangent = torch.randn(shape, generator=torch.Generator().manual_seed(1))
    best = math.inf, 0.0
    for eps in (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6):
        both = [
            Evaluation(
                points / voxel,
                weights,
                tuple(job["fft_shape"]),
                shape,
                tuple(job["half"]),
                tuple(np.array(job["sigma"]) / voxel),
                eps,
                upsampling,
                torch.get_num_threads(),
            )
            for upsampling in UPSAMPLINGS
        ]
        errors = [_error(run(cotangent)[0].numpy(), exact) for run in both]
        best = min(best, (min(errors), eps))
        if min(errors) <= job["error"]:
            break
    fit = [run for run, e in zip(both, errors, strict=True) if e <= max(job["error"], best[0])]
    seconds = [timed(lambda run=run: run(cotangent), job["repeats"]) for run in fit or both]
    return {"seconds": min(seconds, key=np.median), "error": best[0], "eps": best[1]}


def _error(image: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(image - exact) / np.linalg.norm(exact))
