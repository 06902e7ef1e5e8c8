"""Registers the kernels with torch, beside those for the CPU (:mod:`..closed_form`).

Autograd, ``torch.compile`` and dispatch by device then work. If the kernels are missing, the
computation runs on the CPU, which is slow and gives one warning.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from ..closed_form import _band_ft_backward, _mesh_ft, _mesh_ft_backward, band_ft
from . import transform
from .device import kernels
from .fallback import on_cpu


@_mesh_ft.register_kernel("cuda")
def _mesh_ft_cuda(
    vertices: Tensor, faces: Tensor, density: Tensor, wavevectors: Tensor, single: bool
) -> Tensor:
    k = kernels(vertices.device, single)
    if k is None:
        return on_cpu(
            _mesh_ft, vertices, faces, density, wavevectors, single, back_to=vertices.device
        )
    return transform.list_forward(k, vertices, faces, density, wavevectors)


@_mesh_ft_backward.register_kernel("cuda")
def _mesh_ft_backward_cuda(
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    wavevectors: Tensor,
    single: bool,
) -> tuple[Tensor, Tensor]:
    k = kernels(vertices.device, single)
    if k is None:
        return on_cpu(
            _mesh_ft_backward,
            grad,
            vertices,
            faces,
            density,
            wavevectors,
            single,
            back_to=vertices.device,
        )
    return transform.list_backward(k, grad, vertices, faces, density, wavevectors)


@band_ft.register_kernel("cuda")
def _band_ft_cuda(
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    rows: Tensor,
    spacing: Sequence[float],
    single: bool,
) -> Tensor:
    k = kernels(vertices.device, single)
    if k is None:
        return on_cpu(
            band_ft, vertices, faces, density, rows, spacing, single, back_to=vertices.device
        )
    return transform.band_forward(k, vertices, faces, density, rows, spacing)


@_band_ft_backward.register_kernel("cuda")
def _band_ft_backward_cuda(
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    rows: Tensor,
    spacing: Sequence[float],
    single: bool,
) -> tuple[Tensor, Tensor]:
    k = kernels(vertices.device, single)
    if k is None:
        return on_cpu(
            _band_ft_backward,
            grad,
            vertices,
            faces,
            density,
            rows,
            spacing,
            single,
            back_to=vertices.device,
        )
    return transform.band_backward(k, grad, vertices, faces, density, rows, spacing)
