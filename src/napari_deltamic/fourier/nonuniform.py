"""Weighted points to a band of wavevectors and back, by the non-uniform FFT (FINUFFT).

Registered with torch as ``deltamic::points_ft``; the gradient is one batched transform of the other
type at the same points.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from functools import cache
from math import ceil, log, log2, pi, prod, sqrt

import finufft
import numpy as np
import torch
from scipy.fft import next_fast_len
from torch import Tensor

from .native import threads

_BATCH_AT_MOST = 1 << 22  # modes; beyond it the four transforms of the gradient run one by one
_WIDEST_KERNEL = 14  # of FINUFFT, with some to spare
_local = threading.local()


@cache
def _upsampling(modes: tuple[int, int, int], eps: float, points: int) -> float:
    """How much finer than the modes FINUFFT's grid is to be: what costs least.

    Coarser grids need wider kernels. The FFT is several times slower where an axis of its grid is a
    multiple of 32 (96, 160, 192, 512; not 32, 64, 128), which the default often picks.
    """
    costs = {}
    for upsampling in (1.25, 1.3, 1.35, 1.4, 1.5, 1.6, 1.75, 2.0):
        width = ceil(log(2 / eps) / (pi * sqrt(1 - 1 / upsampling)))
        if width > _WIDEST_KERNEL and upsampling < 2:
            continue
        shape = [_grid_size(max(ceil(upsampling * n), 2 * width)) for n in modes]
        slow = any(n % 32 == 0 and n not in (32, 64, 128) for n in shape)
        size = prod(shape)
        costs[upsampling] = points * width**3 + size * log2(size) * (3 if slow else 1)
    return min(costs, key=lambda u: costs[u])


def _grid_size(n: int) -> int:
    """The next even number with no prime factor above 5."""
    n += n % 2
    while next_fast_len(n, real=True) != n:
        n += 2
    return n


def _plan(
    kind: int, modes: tuple[int, int, int], count: int, eps: float, single: bool, points: int
) -> finufft.Plan:
    """A FINUFFT plan; the last few are kept, per thread, since a plan holds points."""
    plans: OrderedDict = _local.__dict__.setdefault("plans", OrderedDict())
    upsampling = _upsampling(modes, eps, 1 << round(log2(points)))
    key = (kind, modes, count, eps, single, threads(), upsampling)
    if key in plans:
        plans.move_to_end(key)
        return plans[key]
    plan = finufft.Plan(
        kind,
        modes,
        n_trans=count,
        eps=eps,
        isign=-1 if kind == 1 else 1,
        dtype="complex64" if single else "complex128",
        nthreads=threads(),
        upsampfac=upsampling,
    )
    if np.prod(modes) <= _BATCH_AT_MOST:
        plans[key] = plan
        if len(plans) > 4:
            plans.popitem(last=False)
    return plan


def _angles(points: Tensor, spacing: Sequence[float], single: bool) -> list[np.ndarray]:
    theta = points.detach().to(torch.float64).numpy() * np.asarray(spacing)
    theta -= 2 * np.pi * np.round(theta / (2 * np.pi))
    kind = np.float32 if single else np.float64
    return [np.ascontiguousarray(theta[:, i], dtype=kind) for i in range(3)]


def _shift(theta_x: np.ndarray, nx: int) -> np.ndarray:
    """FINUFFT counts modes from -nx//2 on, the band from 0 on: the factor between the two."""
    return np.exp(-1j * (nx // 2) * theta_x.astype(np.float64)).astype(
        np.complex64 if theta_x.dtype == np.float32 else np.complex128
    )


@torch.library.custom_op("deltamic::points_ft", mutates_args=(), device_types="cpu")
def points_ft(
    points: Tensor,
    weights: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    eps: float,
    single: bool,
) -> Tensor:
    """``sum_j weights_j exp(-i xi.points_j)`` on the box of a band.

    Parameters
    ----------
    points, weights
        (M, 3) um and (M,).
    half, spacing
        Largest indices and rad/um per index; see :class:`napari_deltamic.fourier.Band`.
    eps
        Relative L2 error of the result.
    single
        complex64 rather than complex128.
    """
    return torch.from_numpy(from_points(points, weights, half, spacing, eps, single))


def from_points(
    points: Tensor,
    weights: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    eps: float,
    single: bool,
) -> np.ndarray:
    """What :func:`points_ft` computes, without a gradient; (n, M) weights give n boxes."""
    modes = (2 * half[0] + 1, 2 * half[1] + 1, half[2] + 1)
    kind = np.complex64 if single else np.complex128
    if len(points) == 0:
        return np.zeros((*weights.shape[:-1], *modes), kind)
    theta = _angles(points, spacing, single)
    plan = _plan(1, modes, 1, eps, single, len(points))
    plan.setpts(*theta)
    shift = _shift(theta[2], modes[2])
    each = weights.detach().numpy().astype(kind).reshape(-1, len(points))
    boxes = [plan.execute(strengths * shift) for strengths in each]
    return boxes[0] if weights.ndim == 1 else np.stack(boxes)


def to_points(
    points: Tensor,
    box: np.ndarray,
    half: Sequence[int],
    spacing: Sequence[float],
    eps: float,
    single: bool,
) -> Tensor:
    """``Re sum over the box of conj(box) exp(-i xi.point)`` (M,): the adjoint of from_points.

    Several boxes (n, Z, Y, X) give (n, M).
    """
    modes = (2 * half[0] + 1, 2 * half[1] + 1, half[2] + 1)
    if len(points) == 0:
        return torch.zeros((*box.shape[:-3], 0), dtype=torch.float64)
    kind = np.complex64 if single else np.complex128
    theta = _angles(points, spacing, single)
    plan = _plan(2, modes, 1, eps, single, len(points))
    plan.setpts(*theta)
    back = _shift(theta[2], modes[2]).conj()
    boxes = np.ascontiguousarray(box, dtype=kind).reshape(-1, *modes)
    field = np.stack([(plan.execute(one) * back).real for one in boxes]).astype(np.float64)
    return torch.from_numpy(field if box.ndim == 4 else field[0])


@points_ft.register_fake
def _(
    points: Tensor,
    weights: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    eps: float,
    single: bool,
) -> Tensor:
    modes = (2 * half[0] + 1, 2 * half[1] + 1, half[2] + 1)
    return points.new_empty(modes, dtype=torch.complex64 if single else torch.complex128)


@torch.library.custom_op("deltamic::points_ft_backward", mutates_args=(), device_types="cpu")
def _points_ft_backward(
    grad: Tensor,
    points: Tensor,
    weights: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    eps: float,
    single: bool,
) -> tuple[Tensor, Tensor]:
    if len(points) == 0:
        return torch.zeros_like(points), torch.zeros_like(weights)
    kind = np.complex64 if single else np.complex128
    g = grad.detach().resolve_conj().numpy().astype(kind, copy=False)
    modes = tuple(g.shape)
    theta = _angles(points, spacing, single)
    back = _shift(theta[2], modes[2]).conj()
    field = np.empty((4, len(points)), np.float32 if single else np.float64)
    for some in (slice(0, 4),) if g.size <= _BATCH_AT_MOST else [slice(i, i + 1) for i in range(4)]:
        plan = _plan(2, modes, some.stop - some.start, eps, single, len(points))
        plan.setpts(*theta)
        coefficients = np.stack([_derivative(g, axis, half, spacing) for axis in range(4)[some]])
        several = some.stop - some.start > 1
        values = plan.execute(coefficients if several else coefficients[0])
        field[some] = (values * back).real
    grad_weights = torch.from_numpy(field[0].astype(np.float64))
    along = torch.from_numpy(np.ascontiguousarray(field[1:].T, dtype=np.float64))
    grad_points = along * weights.detach().to(torch.float64)[:, None]
    return grad_points.to(points.dtype), grad_weights.to(weights.dtype)


def _derivative(
    g: np.ndarray, which: int, half: Sequence[int], spacing: Sequence[float]
) -> np.ndarray:
    """The adjoint field's coefficients (0), or those of its derivative along axis ``which - 1``."""
    if which == 0:
        return g
    axis = which - 1
    k = np.arange(0 if axis == 2 else -half[axis], half[axis] + 1) * spacing[axis]
    shape = [1, 1, 1]
    shape[axis] = -1
    return g * (1j * k).astype(g.dtype).reshape(shape)


@_points_ft_backward.register_fake
def _(
    grad: Tensor,
    points: Tensor,
    weights: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    eps: float,
    single: bool,
) -> tuple[Tensor, Tensor]:
    return torch.empty_like(points), torch.empty_like(weights)


def _save(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    points, weights, ctx.half, ctx.spacing, ctx.eps, ctx.single = inputs
    ctx.save_for_backward(points, weights)


def _grad(ctx, grad):  # type: ignore[no-untyped-def]
    points, weights = ctx.saved_tensors
    gp, gw = _points_ft_backward(grad, points, weights, ctx.half, ctx.spacing, ctx.eps, ctx.single)
    return gp, gw, None, None, None, None


points_ft.register_autograd(_grad, setup_context=_save)
