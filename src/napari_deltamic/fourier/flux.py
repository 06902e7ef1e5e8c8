"""Flux of weighted area vectors by the particle-mesh, from which solids are computed.

See :mod:`napari_deltamic.fourier.solid` for the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .particle_mesh import field_of, gather, spread
from .spreading import Elements, Spreading


def within(half: Sequence[int], of: Sequence[int]) -> tuple[slice, slice, slice]:
    """Return the slices of a smaller box of wavevectors in a larger one."""
    (kz, ky, kx), (nz, ny, _) = half, of
    return slice(nz - kz, nz + kz + 1), slice(ny - ky, ny + ky + 1), slice(0, kx + 1)


def inverse_square(half: Sequence[int], spacing: Sequence[float]) -> np.ndarray:
    """Return 1 / |xi|^2 on a box, 0 at zero."""
    first = (-half[0], -half[1], 0)
    axes = [np.arange(a, k + 1) * s for a, k, s in zip(first, half, spacing, strict=True)]
    squared = sum(a**2 for a in np.ix_(*axes))
    return np.divide(1.0, squared, out=np.zeros(np.shape(squared)), where=squared > 0)


@lru_cache(maxsize=4)
def _weights(
    half: tuple[int, int, int],
    spacing: tuple[float, float, float],
    low: tuple[int, int, int],
    real: torch.dtype,
    device: torch.device,
) -> Tensor:
    """Return ``1 / |xi|^2`` on the box of a band, 0 within the low box."""
    inverse = inverse_square(half, spacing)
    inverse[within(low, half)] = 0
    return torch.from_numpy(inverse).to(device, real)


def flux_ft(
    vertices: Tensor,
    faces: Elements,
    areas: Tensor,
    contrast: Tensor,
    low: tuple[int, int, int],
) -> Tensor:
    """Return ``(i / |xi|^2) xi . sum over faces of contrast areas exp(-i xi.x)``, 0 in the low box.

    For a closed surface, its gradient in the vertices is that of the whole solid: at all
    wavevectors, also in the low box, and including the change of area vectors. So neither the
    areas nor the shells of the low box need gradients of their own.

    Parameters
    ----------
    vertices, faces
        (V, 3) um, the faces and how they are spread.
    areas, contrast
        (F, 3) area vectors, um^2; (F,) see :func:`napari_deltamic.fourier.solid.contrasts`.
    low
        Half the low box.
    """
    return _Flux.apply(vertices, contrast, faces, areas, low)


class _Flux(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, vertices: Tensor, contrast: Tensor, *rest: Any) -> Tensor:
        faces, areas, low = ctx.rest = rest
        ctx.save_for_backward(vertices, contrast)
        # Dipoles along the area vectors give the divergence of the flux: i xi . its transform.
        grid = spread(vertices, faces, contrast, vertices.device, vectors=areas)
        return faces.spreading.fft.to_box(grid, _weights_of(faces.spreading, low, grid))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        vertices, contrast = ctx.saved_tensors
        faces, areas, low = ctx.rest
        by_vertex = by_contrast = None

        if ctx.needs_input_grad[0]:
            found = gather(vertices, faces, field_of(grad, faces.spreading, faces.single))
            swept = found.to(torch.float64) * (contrast[:, None] * areas)[:, None]
            by_vertex = torch.zeros_like(vertices, dtype=torch.float64)
            by_vertex.index_add_(0, faces.corners.reshape(-1), swept.reshape(-1, 3))
            by_vertex = by_vertex.to(vertices.dtype)
        if ctx.needs_input_grad[1]:
            weights = _weights_of(faces.spreading, low, grad.real)
            field = field_of(grad, faces.spreading, faces.single, weights)
            slopes = gather(vertices, faces, field, slopes=True)
            by_contrast = -(slopes[..., 1:].sum(1) * areas).sum(1).to(contrast.dtype)
        return by_vertex, by_contrast, None, None, None


def _weights_of(spreading: Spreading, low: tuple[int, int, int], for_: Tensor) -> Tensor:
    return _weights(spreading.half, spreading.spacing, low, for_.dtype, for_.device)
