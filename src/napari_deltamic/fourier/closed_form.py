"""Closed-form Fourier transform of a triangle mesh, registered with torch as custom operators.

``deltamic::mesh_ft`` takes any wavevectors, ``deltamic::band_ft`` the rows of a regular band. Each
has its backward as an operator of its own, so that a kernel for another device registers four
functions and autograd, ``torch.compile`` and device dispatch follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from .native import complex_type, double, native, run
from .triangle import cross, triangle_transform

_PAIRS_AT_ONCE = 1 << 20  # of a face and a wavevector, on torch's path: bounds its memory


def mesh_ft(
    vertices: Tensor | np.ndarray,
    faces: Tensor | np.ndarray,
    wavevectors: Tensor | np.ndarray,
    density: Tensor | np.ndarray | None = None,
) -> Tensor:
    """Fourier transform of a surface density on a triangle mesh, at any wavevectors.

    ``u_hat(xi) = sum over faces of density * integral over the face of exp(-i x.xi) dS``, exact but
    for rounding: every pair of a face and a wavevector keeps the precision of the type, at
    coincident phases, slivers and zeros too.

    Parameters
    ----------
    vertices
        (V, 3) um, float32 or float64; the result is complex64 or complex128 accordingly. Geometry
        and phases are in double precision either way.
    faces
        (F, 3) integers.
    wavevectors
        (K, 3) rad/um, in the order of the vertices' components.
    density
        (F,) fluorophores per um^2; 1 where not given.

    Returns
    -------
    (K,) complex tensor, differentiable in vertices and density.

    Raises
    ------
    InputError
        If a shape is wrong or a face names a vertex that is not there.
    """
    v, f, rho = as_mesh_tensors(vertices, faces, density)
    xi = torch.as_tensor(wavevectors, device=v.device)
    if xi.ndim != 2 or xi.shape[1] != 3:
        raise InputError(f"wavevectors must have shape (K, 3), not {tuple(xi.shape)}")
    return _mesh_ft(v, f, rho, xi.to(torch.float64), v.dtype == torch.float32)


def as_mesh_tensors(
    vertices: Tensor | np.ndarray, faces: Tensor | np.ndarray, density: Tensor | np.ndarray | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Return checked tensors: vertices, int64 faces, densities. InputError if they do not fit."""
    v = torch.as_tensor(vertices)
    if not v.is_floating_point():
        v = v.to(torch.float64)
    f = torch.as_tensor(faces, device=v.device).to(torch.int64)
    if v.ndim != 2 or v.shape[1] != 3 or f.ndim != 2 or f.shape[1] != 3:
        raise InputError(
            f"vertices (V, 3) and faces (F, 3) are needed, "
            f"not {tuple(v.shape)} and {tuple(f.shape)}"
        )
    if f.numel() and (int(f.min()) < 0 or int(f.max()) >= len(v)):
        raise InputError("a face names a vertex that is not there")
    if density is None:
        rho = torch.ones(len(f), dtype=torch.float64, device=v.device)
    else:
        rho = torch.as_tensor(density, device=v.device)
        if rho.shape != (len(f),):
            raise InputError(f"density must have shape ({len(f)},), not {tuple(rho.shape)}")
    return v, f, rho


# ----------------------------------------------------------------------------- any wavevectors


@torch.library.custom_op("deltamic::mesh_ft", mutates_args=(), device_types="cpu")
def _mesh_ft(
    vertices: Tensor, faces: Tensor, density: Tensor, wavevectors: Tensor, single: bool
) -> Tensor:
    out = torch.zeros(len(wavevectors), dtype=complex_type(single))
    module = native()
    if module is None:
        for part in _chunks(wavevectors, len(faces)):
            out[part] = _torch_forward(vertices, faces, density, wavevectors[part], single)
        return out
    mesh = _arrays(vertices, faces, density)
    run(module, "list_forward", single, *mesh, double(wavevectors), _out(out))
    return out


_mesh_ft.register_fake(
    lambda v, f, rho, xi, single: xi.new_empty(len(xi), dtype=complex_type(single))
)


@torch.library.custom_op("deltamic::mesh_ft_backward", mutates_args=(), device_types="cpu")
def _mesh_ft_backward(
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    wavevectors: Tensor,
    single: bool,
) -> tuple[Tensor, Tensor]:
    gv, gd = _no_gradients(vertices, faces)
    module = native()
    if module is None:
        for part in _chunks(wavevectors, len(faces)):
            v, d = _torch_backward(grad[part], vertices, faces, density, wavevectors[part], single)
            gv, gd = gv + v, gd + d
    else:
        mesh = _arrays(vertices, faces, density)
        arrays = double(wavevectors), _incoming(grad, single), gv.numpy(), gd.numpy()
        run(module, "list_backward", single, *mesh, *arrays)
    return gv.to(vertices.dtype), gd.to(density.dtype)


# ---------------------------------------------------------------------------------- a regular band


@torch.library.custom_op("deltamic::band_ft", mutates_args=(), device_types="cpu")
def band_ft(
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    rows: Tensor,
    spacing: Sequence[float],
    single: bool,
) -> Tensor:
    """Compute the closed form on the rows of a band; see :class:`napari_deltamic.fourier.Band`.

    ``rows`` is (R, 3) int32 of kz, ky and length; row r holds the wavevectors
    ``(kz, ky, kx) * spacing``, kx = 0 ... length-1. Returns the rows one after the other.
    """
    module = native()
    if module is None:
        return _mesh_ft(vertices, faces, density, row_wavevectors(rows, spacing), single)
    out = torch.zeros(int(rows[:, 2].sum()), dtype=complex_type(single))
    mesh = _arrays(vertices, faces, density)
    run(module, "band_forward", single, *mesh, *_rows(rows), list(spacing), _out(out))
    return out


@band_ft.register_fake
def _(vertices: Tensor, *rest: Any) -> Tensor:
    count = torch.library.get_ctx().new_dynamic_size()
    return vertices.new_empty(count, dtype=complex_type(rest[-1]))


@torch.library.custom_op("deltamic::band_ft_backward", mutates_args=(), device_types="cpu")
def _band_ft_backward(
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    rows: Tensor,
    spacing: Sequence[float],
    single: bool,
) -> tuple[Tensor, Tensor]:
    module = native()
    if module is None:
        xi = row_wavevectors(rows, spacing)
        return _mesh_ft_backward(grad, vertices, faces, density, xi, single)
    gv, gd = _no_gradients(vertices, faces)
    mesh = _arrays(vertices, faces, density)
    arrays = _incoming(grad, single), gv.numpy(), gd.numpy()
    run(module, "band_backward", single, *mesh, *_rows(rows), list(spacing), *arrays)
    return gv.to(vertices.dtype), gd.to(density.dtype)


# ------------------------------------------------------------------------------------ gradients


def _differentiable(forward: Any, backward: Any) -> None:
    """Register the backward of an operator, and a version of it that computes only shapes."""

    def save(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        ctx.save_for_backward(*inputs[:4])
        ctx.rest = inputs[4:]

    def gradients(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        by_vertices, by_density = backward(grad, *ctx.saved_tensors, *ctx.rest)
        return by_vertices, None, by_density, None, *(None for _ in ctx.rest)

    def shapes(
        grad: Tensor, vertices: Tensor, faces: Tensor, density: Tensor, *rest: Any
    ) -> tuple[Tensor, Tensor]:
        return torch.empty_like(vertices), torch.empty_like(density)

    forward.register_autograd(gradients, setup_context=save)
    backward.register_fake(shapes)


_differentiable(_mesh_ft, _mesh_ft_backward)
_differentiable(band_ft, _band_ft_backward)


# ------------------------------------------------------------------------------ to and from numpy


def _arrays(
    vertices: Tensor, faces: Tensor, density: Tensor
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return double(vertices), faces.contiguous().numpy(), double(density)


def _out(t: Tensor) -> np.ndarray:
    return torch.view_as_real(t.detach()).numpy()


def _incoming(grad: Tensor, single: bool) -> np.ndarray:
    return _out(grad.to(complex_type(single)).resolve_conj().contiguous())


def _no_gradients(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Return zeros (V, 3) and (F,), to which gradients are added."""
    zeros = torch.zeros(len(vertices), 3, dtype=torch.float64)
    return zeros, torch.zeros(len(faces), dtype=torch.float64)


def _rows(rows: Tensor) -> tuple[np.ndarray, np.ndarray]:
    r = rows.contiguous().numpy()
    offset = np.zeros(len(r), np.int64)
    np.cumsum(r[:-1, 2], out=offset[1:])
    return r, offset


def row_wavevectors(rows: Tensor, spacing: Sequence[float]) -> Tensor:
    r = rows.to(torch.int64)
    start = torch.repeat_interleave(torch.cumsum(r[:, 2], 0) - r[:, 2], r[:, 2])
    kx = torch.arange(len(start)) - start
    kz, ky = (torch.repeat_interleave(r[:, i], r[:, 2]) for i in (0, 1))
    return torch.stack([kz, ky, kx], 1).to(torch.float64) * torch.tensor(
        spacing, dtype=torch.float64
    )


# ------------------------------------------------------------------------------- the torch path


def _chunks(wavevectors: Tensor, faces: int) -> list[slice]:
    step = max(1, _PAIRS_AT_ONCE // max(faces, 1))
    return [slice(i, i + step) for i in range(0, len(wavevectors), step)]


def _torch_parts(
    vertices: Tensor, faces: Tensor, wavevectors: Tensor, single: bool
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return edges (F, 3, 3), doubled areas (F, 3), exp(-iC) and S (F, K), gradients (3, F, K)."""
    corners = vertices.to(torch.float64)[faces]
    edges = torch.stack([corners[:, (p + 2) % 3] - corners[:, (p + 1) % 3] for p in range(3)], 1)
    normal = cross(edges[:, 2], edges[:, 0])
    d = torch.einsum("fpi,ki->pfk", edges, wavevectors).to(
        torch.float32 if single else torch.float64
    )
    s, g = triangle_transform(d)
    e = torch.exp(-1j * (corners.mean(1) @ wavevectors.T))
    return edges, normal, e, s.to(torch.complex128), g.to(torch.complex128)


def _torch_forward(
    vertices: Tensor, faces: Tensor, density: Tensor, wavevectors: Tensor, single: bool
) -> Tensor:
    _, normal, e, s, _ = _torch_parts(vertices, faces, wavevectors, single)
    weight = torch.linalg.vector_norm(normal, dim=1) * density
    return (weight.to(torch.complex128) @ (e * s)).to(complex_type(single))


def _torch_backward(
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    density: Tensor,
    wavevectors: Tensor,
    single: bool,
) -> tuple[Tensor, Tensor]:
    edges, normal, e, s, g = _torch_parts(vertices, faces, wavevectors, single)
    doubled = torch.linalg.vector_norm(normal, dim=1)
    unit = normal / torch.where(doubled > 0, doubled, 1.0)[:, None]
    t = e * grad.to(torch.complex128).conj()
    value = (t * s).real.sum(1)
    phase = torch.einsum("pfk,ki->fpi", (t * g).real, wavevectors)
    w = cross(edges, unit[:, None].expand_as(edges))
    corner = density.to(torch.float64)[:, None, None] * (
        doubled[:, None, None] * phase - value[:, None, None] * w
    )
    gv, _ = _no_gradients(vertices, faces)
    return gv.index_add_(0, faces.reshape(-1), corner.reshape(-1, 3)), doubled * value
