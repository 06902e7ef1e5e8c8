"""Three-dimensional FFTs between a real array and the low wavevectors of its spectrum.

The compiled loops skip zeros and outputs that are not needed, and give the same bits for any number
of threads; elsewhere torch computes the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from ..common.kept import kept
from .native import complex_type, native, run
from .points import placed

Triple = tuple[int, int, int]
Factors = tuple[np.ndarray, np.ndarray, np.ndarray]


def compiled(device: torch.device) -> bool:
    """Whether the compiled loops are used on a device."""
    return device.type == "cpu" and native() is not None


@dataclass(frozen=True, eq=False)
class RealFFT:
    """FFTs between real arrays and boxes (2 Kz + 1, 2 Ky + 1, Kx + 1) of wavevectors.

    Attributes
    ----------
    shape
        Z, Y, X of the periodic array.
    half
        Largest indices of the box.
    count
        Z, Y, X of the real array, which lies at the beginning of the periodic one; the rest counts
        as zero, or is left out of results.
    to_box_factors, to_real_factors
        Real numbers by which the box is multiplied after, or before: 2 K + 1, 2 K + 1 and K + 1
        along its axes.
    """

    shape: Triple
    half: Triple
    count: Triple
    to_box_factors: Factors = field(repr=False)
    to_real_factors: Factors = field(repr=False)

    @property
    def box_shape(self) -> Triple:
        """Shape of the box."""
        return 2 * self.half[0] + 1, 2 * self.half[1] + 1, self.half[2] + 1

    def to_box(self, real: Tensor, weights: Tensor | None = None) -> Tensor:
        """``factors * weights * sum over the array of real exp(-2 pi i k.j / shape)``.

        Parameters
        ----------
        real
            (Z, Y, X) as ``count`` says; rows may be longer, and what is beyond is left out.
        weights
            Real numbers of the shape of the box; None: 1.
        """
        if not compiled(real.device):
            box = self._torch_box(real[..., : self.count[2]])
            return box if weights is None else box * weights
        kind = complex_type(real.dtype == torch.float32)
        box = torch.empty(self.box_shape, dtype=kind)
        self._run("to_box", box, real.contiguous(), weights)
        return box

    def to_real(self, box: Tensor, weights: Tensor | None = None, row: int | None = None) -> Tensor:
        """``Re sum over k of factors * weights * box exp(2 pi i k.j / shape)``.

        Numbers of the box count twice unless their kx is 0 or half an even length.

        Parameters
        ----------
        box, weights
            Of the shape of the box; see :meth:`to_box`.
        row
            Length of the result's rows, if longer than ``count`` says.
        """
        row = row or self.count[2]
        if not compiled(box.device):
            found = self._torch_real(box if weights is None else box * weights)
            return torch.nn.functional.pad(found, (0, row - self.count[2]))
        real = torch.float32 if box.dtype == torch.complex64 else torch.float64
        out = torch.empty(*self.count[:2], row, dtype=real)
        self._run("to_real", box.resolve_conj().contiguous(), out, weights)
        return out

    def _run(self, name: str, box: Tensor, array: Tensor, weights: Tensor | None) -> None:
        real = array.dtype
        z, _, _ = self._placed(name, real, box.device)
        run(
            native(),
            name,
            real == torch.float32,
            torch.view_as_real(box).numpy(),
            array.numpy(),
            self.shape,
            self.half,
            self.count,
            z.numpy(),
            self._outer(name, real),
            None if weights is None else weights.to(real).contiguous().numpy(),
        )

    # ----------------------------------------------------------------------------- by torch

    def _torch_box(self, real: Tensor) -> Tensor:
        box = torch.fft.rfft(real, n=self.shape[2], dim=2).narrow(2, 0, self.half[2] + 1)
        box = torch.fft.fftn(box, s=self.shape[:2], dim=(0, 1))
        z, y = self._indices(real.device)
        # As pairs of real numbers, since not every device can index complex ones.
        box = torch.view_as_complex(torch.view_as_real(box)[z[:, None], y])
        return box * self._whole("to_box", real.dtype, real.device)

    def _torch_real(self, box: Tensor) -> Tensor:
        real = torch.float32 if box.dtype == torch.complex64 else torch.float64
        box = box * self._whole("to_real", real, box.device)
        z, y = self._indices(box.device)
        for axis in (0, 1):
            box = _wrapped(box, axis, self.half[axis], self.shape[axis])
        pairs = torch.zeros(*self.shape[:2], box.shape[2], 2, dtype=real, device=box.device)
        pairs[z[: box.shape[0], None], y[: box.shape[1]]] = torch.view_as_real(box.resolve_conj())
        spectrum = torch.fft.ifftn(torch.view_as_complex(pairs), dim=(0, 1), norm="forward")
        spectrum = spectrum[: self.count[0], : self.count[1]]
        found = torch.fft.irfft(spectrum, n=self.shape[2], dim=2, norm="forward")
        return found.narrow(2, 0, self.count[2])

    @kept
    def _indices(self, device: torch.device) -> list[Tensor]:
        """Return the indices of wavevectors -K .. K along the first two axes of an FFT."""
        return [
            (torch.arange(-k, k + 1) % n).to(device)
            for k, n in zip(self.half[:2], self.shape[:2], strict=True)
        ]

    @kept
    def _whole(self, name: str, real: torch.dtype, device: torch.device) -> Tensor:
        """Return the product of the factors of all three axes, on the box."""
        z, y, x = self._placed(name, real, device)
        return z[:, None, None] * (y[:, None] * x)

    @kept
    def _outer(self, name: str, real: torch.dtype) -> np.ndarray:
        """Return the product of the factors of the last two axes."""
        _, y, x = self._placed(name, real, torch.device("cpu"))
        return (y[:, None] * x).contiguous().numpy()

    @kept
    def _placed(self, name: str, real: torch.dtype, device: torch.device) -> list[Tensor]:
        factors = self.to_box_factors if name == "to_box" else self.to_real_factors
        return [placed(f, real, device) for f in factors]


def _wrapped(box: Tensor, axis: int, half: int, n: int) -> Tensor:
    """Return the box with -n/2 and +n/2, which are one wavevector, replaced by their sum."""
    if 2 * half != n or not half:
        return box
    last = box.narrow(axis, 0, 1) + box.narrow(axis, 2 * half, 1)
    return torch.cat([last, box.narrow(axis, 1, 2 * half - 1)], dim=axis)
