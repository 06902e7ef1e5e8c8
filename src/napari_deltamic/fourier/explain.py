"""How well a rendered image explains a measured one, by the compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .native import native, threads

Told = tuple[float, float, float, float, bool]


def products(
    columns: Sequence[Tensor], weights: Tensor, less: Sequence[float] | None = None
) -> NDArray[np.float64]:
    """Return (K, K) weighted inner products of all pairs of columns, in double precision.

    The result has the same bits for every number of threads.

    Parameters
    ----------
    columns
        1 to 64 columns (N,), on the CPU.
    weights
        (N,).
    less
        A number that is first subtracted from each column; by default 0.
    """
    given = (*columns, weights)
    single = all(t.dtype == torch.float32 for t in given)
    real = torch.float32 if single else torch.float64
    *own, w = (t.detach().to(real).contiguous().numpy() for t in given)
    name = "products_f32" if single else "products_f64"
    found: NDArray[np.float64] = getattr(native(), name)(
        own, w, list(less or [0.0] * len(own)), threads()
    )
    return found


def explain(
    image: Tensor, index: Tensor, measured: Tensor, weights: Tensor, least: float
) -> tuple[Tensor, Told]:
    """Return the weighted squared residual of the best amplitude and background.

    It is differentiable in the image. Two passes over the counted voxels give it and the gradient,
    with the same bits for every number of threads.

    Parameters
    ----------
    image
        Rendered, any shape, on the CPU.
    index
        (N,) flat indices of the voxels that count, each once and in order.
    measured, weights
        (N,) float32, of these voxels.
    least
        Least amplitude, as a share of the ratio of the standard deviations of both images.

    Returns
    -------
    The squared residual as a tensor, and: its value, that value relative to the squares around the
    mean, amplitude, background, and whether the amplitude is at its bound.

    Raises
    ------
    ValueError
        If voxels are named twice, out of order, or not in the image.
    """
    told: list[Told] = []
    squares: Tensor = _Explain.apply(image, index, measured, weights, least, told)
    return squares, told[0]


class _Explain(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        image: Tensor,
        index: Tensor,
        measured: Tensor,
        weights: Tensor,
        least: float,
        told: list[Told],
    ) -> Tensor:
        name = "explain_f32" if image.dtype == torch.float32 else "explain_f64"
        some = (image.contiguous().reshape(-1), index, measured, weights)
        given = (t.detach().contiguous().numpy() for t in some)
        pull, squares, scatter, amplitude, background, bounded = getattr(native(), name)(
            *given, least, threads()
        )
        ctx.pull = torch.from_numpy(pull).reshape(image.shape)
        told.append((squares, squares / max(scatter, 1e-30), amplitude, background, bounded))
        return torch.tensor(squares, dtype=torch.float64)

    @staticmethod
    def backward(ctx: Any, by: Tensor) -> tuple[Tensor | None, ...]:
        return ctx.pull * by.to(ctx.pull.dtype), None, None, None, None, None
