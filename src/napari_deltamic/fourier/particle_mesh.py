"""Particle-mesh: transforms weighted points, by way of a grid, to a band of wavevectors and back.

Points are spread with a compact kernel, one real FFT follows, and the band is divided by the
kernel's transform. The gradient is one real FFT back and one pass over the points that reads the
field and its three derivatives together. NVIDIA GPUs have kernels of their own (:mod:`.cuda`).
Where those or the compiled extension are missing, and on other devices, the same is done in torch
operations (:mod:`.torch_mesh`).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from . import torch_mesh
from .cuda import point_transform as on_gpu
from .cuda.build import Kernels, PointBuild
from .cuda.device import point_kernels
from .native import complex_type, double, native, run
from .points import Points
from .real_fft import compiled
from .spreading import Elements, Spreading


def elements_ft(
    vertices: Tensor,
    elements: Tensor,
    density: Tensor,
    points: Points,
    spreading: Spreading,
    single: bool,
    device: torch.device | None = None,
) -> Tensor:
    """``sum over elements of density * integral of exp(-i xi.x)`` on the box of a band, by points.

    Parameters
    ----------
    vertices
        (V, 3) um.
    elements
        (E, 3) triangles, (E, 2) segments or (E, 1) points: vertices of each.
    density
        (E,) per um^2, per um, or of each point.
    points
        Rules of the elements.
    spreading
        Grid and kernels.
    single
        complex64 rather than complex128.
    device
        Where the result is to be; by default where the vertices are.

    Returns
    -------
    Complex tensor of the shape of the band's box, differentiable in vertices and density.

    Raises
    ------
    ValueError
        By the compiled loops: if a vertex is not finite, or an element names a vertex that is not
        there. Elsewhere vertices that are not finite give NaN, and elements are not looked at.
    """
    there = vertices.device if device is None else device
    return _Transform.apply(vertices, density, Elements(elements, points, spreading, single), there)


class _Transform(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, vertices: Tensor, density: Tensor, elements: Elements, device: torch.device
    ) -> Tensor:
        ctx.save_for_backward(vertices, density)
        ctx.elements = elements
        return elements.spreading.fft.to_box(spread(vertices, elements, density, device))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        vertices, density = ctx.saved_tensors
        e = ctx.elements
        return *pull(vertices, e, density, field_of(grad, e.spreading, e.single)), None, None


# --------------------------------------------------------------------- compiled loops, or torch's


def spread(
    vertices: Tensor,
    elements: Elements,
    density: Tensor,
    device: torch.device,
    vectors: Tensor | None = None,
) -> Tensor:
    """Spread the points of all elements on a (Z, Y, X) grid, whose rows may be longer than X.

    Each point has the element's density times its measure (area, length, 1) times the rule's
    weight. With ``vectors`` (E, 3), points are dipoles along them: density times weight times the
    kernel's gradient (per um) along the vector, without the measure.
    """
    if not compiled(device):
        if (kernels := _kernels(device, elements.single)) is not None:
            return on_gpu.spread(kernels, vertices, elements, density, device, vectors)
        return torch_mesh.spread(vertices, elements, density, device, vectors)
    z, y, x = elements.spreading.shape
    grid = torch.empty(z, y, x + elements.spreading.lanes, dtype=elements.real)
    along = None if vectors is None else double(vectors)
    _run("spread", vertices, elements, density, along, grid.numpy())
    return grid


def gather(vertices: Tensor, elements: Elements, field: Tensor, slopes: bool = False) -> Tensor:
    """Return sums over each element's points, (E, corners, 1), or (E, corners, 4) with slopes.

    Terms are weight times barycentric coordinate times a field (:func:`field_of`), or its
    derivatives per um.
    """
    if not compiled(field.device):
        if (kernels := _kernels(field.device, elements.single)) is not None:
            return on_gpu.gather(kernels, vertices, elements, field, slopes)
        return torch_mesh.gather(vertices, elements, field, slopes)
    sums = torch.zeros(*elements.corners.shape, 4 if slopes else 1, dtype=torch.float64)
    ones = torch.ones(len(elements.corners), dtype=torch.float64)
    _run("gather", vertices, elements, ones, field.numpy(), sums.numpy())
    return sums


def pull(
    vertices: Tensor, elements: Elements, density: Tensor, field: Tensor
) -> tuple[Tensor, Tensor]:
    """Return gradients in vertices (V, 3) and densities (E,), from a field (:func:`field_of`)."""
    if not compiled(field.device):
        if (kernels := _kernels(field.device, elements.single)) is not None:
            return on_gpu.pull(kernels, vertices, elements, density, field)
        return torch_mesh.pull(vertices, elements, density, field)
    by_vertex = torch.zeros(len(vertices), 3, dtype=torch.float64)
    by_density = torch.empty(len(elements.corners), dtype=torch.float64)
    out = by_vertex.numpy(), by_density.numpy()
    _run("pull", vertices, elements, density, field.numpy(), *out)
    return by_vertex.to(vertices.dtype), by_density.to(density.dtype)


def field_of(
    box: Tensor, spreading: Spreading, single: bool, weights: Tensor | None = None
) -> Tensor:
    """Apply the adjoint of the transform from the grid to its box; rows are as the loops need.

    weights : real numbers by which the box is multiplied first.
    """
    box = box.detach().to(complex_type(single))
    row = spreading.shape[2] + (spreading.lanes if compiled(box.device) else 0)
    return spreading.fft.to_real(box, weights, row)


def _kernels(device: torch.device, single: bool) -> Kernels[PointBuild] | None:
    """Return the kernels of an NVIDIA GPU; None on other devices, which use torch's operations."""
    return point_kernels(device, single) if device.type == "cuda" else None


def _run(name: str, vertices: Tensor, elements: Elements, density: Tensor, *arrays: Any) -> None:
    """Run a compiled loop over the points."""
    spreading = elements.spreading
    run(
        native(),
        name,
        elements.single,
        double(vertices),
        elements.corners.contiguous().numpy(),
        double(density),
        elements.points.compiled,
        list(spreading.shape),
        list(spreading.scale),
        [k.coefficients for k in spreading.kernels],
        *arrays,
    )
