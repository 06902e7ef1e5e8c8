"""Bessel functions with gradients.

Those of torch have no gradients and do not say so. Values are SciPy's, as torch's are wrong in the
seventh digit between 5 and 20.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.special
import torch
from torch import Tensor

Function = Callable[[Tensor], Tensor]
_SMALL = 0.5  # below it a series is used, as the recurrence would cancel


def _differentiable(value: Function, slope: Function) -> Function:
    """A function of a tensor whose slope is known."""

    class Known(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Any, x: Tensor) -> Tensor:
            ctx.save_for_backward(x)
            return value(x)

        @staticmethod
        def backward(ctx: Any, *grad: Any) -> Tensor:
            (x,) = ctx.saved_tensors
            return grad[0] * slope(x)

    return Known.apply


def _values(function: Any, x: Tensor) -> Tensor:
    return torch.from_numpy(np.asarray(function(x.detach().numpy())))


def _over(value: Tensor, x: Tensor, at_zero: float) -> Tensor:
    zero = x == 0
    ratio = value / torch.where(zero, torch.ones_like(x), x)
    return torch.where(zero, torch.full_like(x, at_zero), ratio)


def _order_two(x: Tensor) -> Tensor:
    near = x.abs() < _SMALL
    safe = torch.where(near, torch.ones_like(x), x)
    far = 2 * _values(scipy.special.j1, safe) / safe - _values(scipy.special.j0, safe)
    q = x * x / 4
    # J2(x) = (x/2)^2 sum_k (-q)^k / (k! (k+2)!)
    series = 1 - q / 3 * (1 - q / 8 * (1 - q / 15 * (1 - q / 24 * (1 - q / 35))))
    return torch.where(near, q / 2 * series, far)


# Bessel functions of the first kind and orders 0 to 2, the last one differentiable once.
j0: Function = _differentiable(partial(_values, scipy.special.j0), lambda x: -j1(x))
j1: Function = _differentiable(partial(_values, scipy.special.j1), lambda x: (j0(x) - j2(x)) / 2)
j2: Function = _differentiable(_order_two, lambda x: j1(x) - 2 * _over(_order_two(x), x, 0.0))
# 2 J1(x) / x, the transform of a disc of unit mass and radius 1; differentiable once.
jinc: Function = _differentiable(
    lambda x: 2 * _over(_values(scipy.special.j1, x), x, 0.5),
    lambda x: -2 * _over(_order_two(x), x, 0.0),
)
