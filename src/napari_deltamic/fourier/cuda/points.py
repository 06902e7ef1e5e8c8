"""The non-uniform FFT on GPUs, by cufinufft where it is installed (extra ``gpu``)."""

from __future__ import annotations

import ctypes
import importlib
import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from math import pi, prod
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..nonuniform import _BATCH_AT_MOST, _points_ft_backward, points_ft
from .build import tell_out_of_memory
from .fallback import on_cpu
from .kept import Kept, stream_of

_KEPT = 4  # plans
# Of CUDA 12, which the wheels of cufinufft are linked to; a torch of CUDA 13 brings others.
_LIBRARIES = (("cuda_runtime", "libcudart.so.12"), ("cufft", "libcufft.so.11"))


@cache
def cufinufft() -> Any:
    """The package, or None where it is not installed or its libraries are missing."""
    with suppress(ImportError):
        import nvidia

        for package, name in _LIBRARIES:
            for folder in nvidia.__path__:
                with suppress(OSError):
                    path = Path(folder) / package / "lib" / name
                    ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    try:
        return importlib.import_module("cufinufft")
    except (ImportError, OSError):
        return None


@points_ft.register_kernel("cuda")
def _points_ft_cuda(
    points: Tensor,
    weights: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    eps: float,
    single: bool,
) -> Tensor:
    modes, kind = (2 * half[0] + 1, 2 * half[1] + 1, half[2] + 1), _kind(single)
    if cufinufft() is None:
        given = points, weights, half, spacing, eps, single
        return on_cpu(points_ft, *given, back_to=points.device)
    out = torch.zeros(modes, dtype=kind, device=points.device)
    if len(points):
        theta = _angles(points, spacing, single)
        strengths = weights.detach().to(kind) * _shift(theta[2], modes[2])
        _execute(1, theta, strengths, out, modes, eps)
    return out


@_points_ft_backward.register_kernel("cuda")
def _points_ft_backward_cuda(
    grad: Tensor,
    points: Tensor,
    weights: Tensor,
    half: Sequence[int],
    spacing: Sequence[float],
    eps: float,
    single: bool,
) -> tuple[Tensor, Tensor]:
    if cufinufft() is None:
        given = grad, points, weights, half, spacing, eps, single
        return on_cpu(_points_ft_backward, *given, back_to=points.device)
    kind, count = _kind(single), len(points)
    if not count:
        return torch.zeros_like(points), torch.zeros_like(weights)
    g = grad.detach().to(kind).resolve_conj()
    modes = (int(g.shape[0]), int(g.shape[1]), int(g.shape[2]))
    theta = _angles(points, spacing, single)
    back = _shift(theta[2], modes[2]).conj()
    several = 4 if prod(modes) <= 8 * _BATCH_AT_MOST else 1
    try:
        field = _fields(g, theta, half, spacing, modes, eps, several)
    except torch.OutOfMemoryError:
        if several == 1:
            raise
        torch.cuda.empty_cache()
        tell_out_of_memory("the four transforms of the gradient run one by one")
        field = _fields(g, theta, half, spacing, modes, eps, 1)
    found = (field * back).real.to(torch.float64)
    by_point = found[1:].T * weights.detach().to(torch.float64)[:, None]
    return by_point.to(points.dtype), found[0].to(weights.dtype)


def _fields(
    g: Tensor,
    theta: list[Tensor],
    half: Sequence[int],
    spacing: Sequence[float],
    modes: tuple[int, int, int],
    eps: float,
    several: int,
) -> Tensor:
    """(4, M): the adjoint field and its derivatives along the axes, at the points."""
    out = torch.empty(4, len(theta[0]), dtype=g.dtype, device=g.device)
    for first in range(0, 4, several):
        parts = [_derivative(g, axis - 1, half, spacing) for axis in range(first, first + several)]
        coefficients = torch.stack(parts) if several > 1 else parts[0]
        target = out if several > 1 else out[first]
        _execute(2, theta, coefficients.contiguous(), target, modes, eps)
    return out


def _derivative(g: Tensor, axis: int, half: Sequence[int], spacing: Sequence[float]) -> Tensor:
    """Coefficients of the field (axis -1), or of its derivative along an axis."""
    if axis < 0:
        return g
    first = 0 if axis == 2 else -half[axis]
    k = torch.arange(first, half[axis] + 1, device=g.device, dtype=torch.float64) * spacing[axis]
    shape = [1, 1, 1]
    shape[axis] = -1
    return g * (1j * k).to(g.dtype).reshape(shape)


def _kind(single: bool) -> torch.dtype:
    return torch.complex64 if single else torch.complex128


def _angles(points: Tensor, spacing: Sequence[float], single: bool) -> list[Tensor]:
    # One axis after the other: a number goes along with a kernel, an array would be copied.
    each = [p * s for p, s in zip(points.detach().to(torch.float64).T, spacing, strict=True)]
    each = [theta - 2 * pi * torch.round(theta / (2 * pi)) for theta in each]
    return [theta.to(torch.float32 if single else torch.float64) for theta in each]


def _shift(theta_x: Tensor, nx: int) -> Tensor:
    """cufinufft counts modes from -nx//2 on, the band from 0 on: the factor between the two."""
    shift = torch.exp(-1j * (nx // 2) * theta_x.to(torch.float64))
    return shift.to(_kind(theta_x.dtype == torch.float32))


# --------------------------------------------------------------------------------------- plans

_plans: Kept[Any] = Kept(_KEPT)
_lock = threading.Lock()  # of plans: points are set first, then it is executed


def _execute(
    kind: int,
    theta: list[Tensor],
    data: Tensor,
    out: Tensor,
    modes: tuple[int, int, int],
    eps: float,
) -> None:
    """One transform of type 1 or 2, or as many as the data holds, on the current stream."""
    count = data.shape[0] if data.ndim - (1 if kind == 1 else 3) else 1
    try:
        with _lock:
            plan = _plan(kind, modes, count, eps, data)
            plan.setpts(*theta)
            plan.execute(data, out=out)
    except (RuntimeError, MemoryError) as error:  # cufinufft tells no reason
        _plans.clear()
        raise torch.OutOfMemoryError(f"cufinufft: {error}") from None


def _plan(kind: int, modes: tuple[int, int, int], count: int, eps: float, like: Tensor) -> Any:
    """The last few are kept: a plan holds the FFT's tables and grid."""
    device, stream = like.device.index or 0, stream_of(like.device)
    single = like.dtype == torch.complex64
    return _plans.get(
        (kind, modes, count, eps, single, device, stream),
        lambda: cufinufft().Plan(
            kind,
            modes,
            n_trans=count,
            eps=eps,
            isign=-1 if kind == 1 else 1,
            dtype="complex64" if single else "complex128",
            gpu_device_id=device,
            gpu_stream=stream or None,
        ),
    )
