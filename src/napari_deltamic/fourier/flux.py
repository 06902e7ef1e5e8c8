"""Flux of weighted area vectors, by the non-uniform FFT: what solids are made of.

Registered with torch as ``deltamic::flux_ft``; see :mod:`napari_deltamic.fourier.solid` for the
formulas.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from .nonuniform import from_points, to_points


def within(half: Sequence[int], of: Sequence[int]) -> tuple[slice, slice, slice]:
    """Where a smaller box lies in a larger one."""
    (kz, ky, kx), (nz, ny, _) = half, of
    return slice(nz - kz, nz + kz + 1), slice(ny - ky, ny + ky + 1), slice(0, kx + 1)


def box_axes(half: Sequence[int], spacing: Sequence[float]) -> list[np.ndarray]:
    """Components of the wavevectors of a box, rad/um, shaped to broadcast over it."""
    first = (-half[0], -half[1], 0)
    axes = [np.arange(a, k + 1) * s for a, k, s in zip(first, half, spacing, strict=True)]
    return list(np.ix_(*axes))


def inverse_square(half: Sequence[int], spacing: Sequence[float]) -> np.ndarray:
    """1 / |xi|^2 on a box, 0 at zero."""
    squared = sum(a**2 for a in box_axes(half, spacing))
    return np.divide(1.0, squared, out=np.zeros(np.shape(squared)), where=squared > 0)


@torch.library.custom_op("deltamic::flux_ft", mutates_args=(), device_types="cpu")
def flux_ft(
    points: Tensor,
    areas: Tensor,
    contrast: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    low: Sequence[int],
    eps: float,
    single: bool,
) -> Tensor:
    """``(i / |xi|^2) xi . sum_j contrast_j areas_j exp(-i xi.points_j)``, 0 within the low box.

    The gradient in the points, of a closed surface, is that of the solid: at every wavevector, the
    low ones included, and with what the area vectors change. So neither the areas nor the shells
    of the low box need any.
    """
    flux = from_points(points, (contrast.detach()[:, None] * areas).T, half, spacing, eps, single)
    along = [a.astype(flux.real.dtype) for a in box_axes(half, spacing)]
    box = along[0] * flux[0] + along[1] * flux[1] + along[2] * flux[2]
    box *= 1j * inverse_square(half, spacing).astype(flux.real.dtype)
    box[within(low, half)] = 0
    return torch.from_numpy(box)


@flux_ft.register_fake
def _(
    points: Tensor,
    areas: Tensor,
    contrast: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    low: Sequence[int],
    eps: float,
    single: bool,
) -> Tensor:
    modes = (2 * half[0] + 1, 2 * half[1] + 1, half[2] + 1)
    return points.new_empty(modes, dtype=torch.complex64 if single else torch.complex128)


@torch.library.custom_op("deltamic::flux_ft_backward", mutates_args=(), device_types="cpu")
def flux_backward(
    grad: Tensor,
    points: Tensor,
    areas: Tensor,
    contrast: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    low: Sequence[int],
    eps: float,
    single: bool,
    of_points: bool,
    of_contrast: bool,
) -> tuple[Tensor, Tensor]:
    grad_points, grad_contrast = torch.zeros_like(points), torch.zeros_like(contrast)
    g = grad.detach().resolve_conj().numpy()
    if of_points:
        swept = to_points(points, g, half, spacing, eps, single)
        grad_points = (swept * contrast)[:, None] * areas
    if of_contrast:
        beyond = -1j * inverse_square(half, spacing) * g
        beyond[within(low, half)] = 0
        boxes = np.stack([beyond * a for a in box_axes(half, spacing)])
        fields = to_points(points, boxes, half, spacing, eps, single)
        grad_contrast = (fields.T * areas).sum(1)
    return grad_points, grad_contrast


@flux_backward.register_fake
def _(
    grad: Tensor,
    points: Tensor,
    areas: Tensor,
    contrast: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    low: Sequence[int],
    eps: float,
    single: bool,
    of_points: bool,
    of_contrast: bool,
) -> tuple[Tensor, Tensor]:
    return torch.empty_like(points), torch.empty_like(contrast)


def _save(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*inputs[:3])
    ctx.rest = inputs[3:]


def _grad(ctx, grad):  # type: ignore[no-untyped-def]
    asked = (ctx.needs_input_grad[0], ctx.needs_input_grad[2])
    points, contrast = flux_backward(grad, *ctx.saved_tensors, *ctx.rest, *asked)
    return points, None, contrast, None, None, None, None, None


flux_ft.register_autograd(_grad, setup_context=_save)
