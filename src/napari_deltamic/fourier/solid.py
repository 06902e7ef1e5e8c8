"""Fourier transform of solids: the signal inside closed surfaces, from their faces alone.

With ``u(xi) = integral over the solid of exp(-i x.xi) dV`` and n the outward normal,

- *by the flux* (divergence theorem): ``u = (i / |xi|^2) xi . sum over faces n u_face(xi)``, three
  transforms of the surface. Its terms grow as 1/|xi| and cancel, so near zero it loses digits;
- *by shells*: ``u = integral for t in 0..1 of sum over faces h u_(c + t (face - c))(xi)``, with
  h the distance of the face's plane from a centre c. Nothing cancels and xi = 0 gives the volume,
  but the integral over t takes more nodes the larger |xi|.

Within ``|xi| R`` of about 1, R being how far the solid reaches from its centre, shells are taken,
and few of them suffice; elsewhere the flux, whose terms are then no larger than those of the
volume. A moving surface sweeps volume, so the gradient is simpler than the value and holds at
every wavevector:
``du/dv = sum over faces n * integral of lambda_v exp(-i x.xi) dS``, lambda_v being 1 at the vertex.

Several regions are one sum: ``contrast`` is the signal per um^3 behind a face minus that in front.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import floor, sqrt

import numpy as np
import torch
from scipy.special import roots_jacobi
from torch import Tensor

from ..errors import InputError
from .band import Band
from .closed_form import as_mesh_tensors, band_ft, mesh_ft, row_wavevectors
from .flux import flux_ft, inverse_square, within
from .particle_mesh import elements_ft
from .plan import RULE_SHARE, Plan
from .points import Points
from .quadrature import Rule, choose_rules
from .spreading import Spreading, choose_spreading, flat
from .triangle import cross, triangle_transform

# Shells are taken where each component of xi is at most this over R.
_NEAR = 1.0
_LARGEST_PHASE = sqrt(3) * _NEAR  # of a point relative to the centre, there
_EXACT = 1e-15
_POINT = Rule(0, 1, np.ones((1, 1)), np.ones(1))
# Flux that cancels up to this factor leaves the plan's errors below what was asked: measured on ten
# solids and four PSFs (test_plan.py), which keep to it up to 3.6 and not always from 4 on.
_THICK = 3.0


def solid_ft(
    vertices: Tensor | np.ndarray,
    faces: Tensor | np.ndarray,
    wavevectors: Tensor | np.ndarray,
    contrast: Tensor | np.ndarray | None = None,
) -> Tensor:
    """Fourier transform of what closed surfaces hold, at any wavevectors.

    ``u_hat(xi) = sum over regions of weight * integral over the region of exp(-i x.xi) dV``, exact
    but for rounding, at xi = 0 (the volume) and near it too. It costs three closed-form transforms
    of the surface.

    Parameters
    ----------
    vertices
        (V, 3) um, Z, Y, X, float32 or float64; the result is complex64 or complex128. The parts
        cancel, so all is in double precision inside.
    faces
        (F, 3) integers, wound as those of a :class:`napari_deltamic.Mesh`.
    wavevectors
        (K, 3) rad/um.
    contrast
        (F,) signal per um^3 behind each face minus that in front of it; see :func:`contrasts`.
        1 where not given: one closed region.

    Returns
    -------
    (K,) complex tensor, differentiable in vertices and contrast.

    Raises
    ------
    InputError
        If a shape is wrong or a face names a vertex that is not there. Whether the surface is
        closed is not checked; the result means nothing where it is not.
    """
    v, f, jump = as_mesh_tensors(vertices, faces, contrast)
    xi = torch.as_tensor(wavevectors, device=v.device).to(torch.float64)
    if xi.ndim != 2 or xi.shape[1] != 3:
        raise InputError(f"wavevectors must have shape (K, 3), not {tuple(xi.shape)}")
    x = v.to(torch.float64)
    centre, reach = _frame(x)
    near = (xi.abs() * reach).amax(1) <= _NEAR
    u = torch.zeros(len(xi), dtype=torch.complex128, device=x.device)
    u = u.index_put((near.nonzero()[:, 0],), _shells(x, f, jump, xi[near], centre))
    far = (~near).nonzero()[:, 0]
    flux = torch.stack(
        [mesh_ft(x, f, xi[far], normal * jump) for normal in _normals(x, f).unbind(1)], 1
    )
    flux = flux + _empty_flux(x, f, jump, xi[far])
    u = u.index_put((far,), (_flux_factor(xi[far]) * flux).sum(1))
    return u.to(torch.complex64 if v.dtype == torch.float32 else torch.complex128)


def contrasts(regions: Tensor | np.ndarray, ids: np.ndarray, weights: Tensor) -> Tensor:
    """(F,) weight behind each face minus that in front of it; the outside has none.

    Parameters
    ----------
    regions
        (F, 2) region numbers of each face, as in a mesh.
    ids
        (R,) sorted region numbers, as :meth:`napari_deltamic.Mesh.region_ids` gives them.
    weights
        (R,) signal per um^3 of each, in that order; the result is differentiable in them.

    Raises
    ------
    InputError
        If there is not one weight for each region.
    """
    if weights.shape != (len(ids),):
        raise InputError(
            f"weights must have shape ({len(ids)},), one number per region, "
            f"not {tuple(weights.shape)}"
        )
    of = torch.cat([weights.new_zeros(1), weights])
    # By rank: a region number may be anything.
    sides = np.searchsorted(np.append(0, ids), np.asarray(regions))
    behind, front = torch.from_numpy(sides).to(weights.device).unbind(1)
    return of[behind] - of[front]


def solid_transform(plan: Plan, vertices: Tensor, faces: Tensor, contrast: Tensor) -> Tensor:
    """u_hat of solids on the box of a plan's band; the plan may be that of their surface.

    Parameters
    ----------
    plan
        Its band, method and rules are used; made for this mesh, or one near it.
    vertices
        (V, 3) um relative to the centre of the grid's first voxel, as in :meth:`Plan.transform`.
    faces
        (F, 3) int64.
    contrast
        (F,) see :func:`contrasts`.

    Returns
    -------
    Complex tensor of the shape ``plan.band.box_shape``, differentiable in vertices and contrast.
    A solid's spectrum falls faster than that of its surface, so that its image is more accurate
    than the plan says of the surface's.
    """
    x = vertices.to(torch.float64)
    centre, reach = _frame(x)
    low = _low_band(plan.band, reach)
    if plan.method == "closed form":
        return _closed_form(plan, low, x, faces, contrast, centre)
    corners = x[faces]
    points, spreading, single = _means(plan, corners, contrast)
    points = points.of(_seen(contrast))
    areas = _area_vectors(corners.detach())
    far = flux_ft(x, faces, areas, contrast, points, spreading, low.half, single)
    near = _low_shells(plan, low, corners.detach(), contrast, centre, reach)
    return far.to(near.dtype) + _embedded(near, low.half, plan.band.half)


# ------------------------------------------------------------------------------------ geometry


def _frame(vertices: Tensor) -> tuple[Tensor, float]:
    """Centre (3,) and how far the vertices reach from it, um."""
    v = vertices.detach()
    if not len(v):
        return v.new_zeros(3), 0.0
    centre = (v.amin(0) + v.amax(0)) / 2
    return centre, float((v - centre).norm(dim=1).max())


def _area_vectors(corners: Tensor) -> Tensor:
    """(F, 3) normal times area; Z, Y, X components are left-handed, hence the sign."""
    return -cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def _normals(vertices: Tensor, faces: Tensor) -> Tensor:
    area = _area_vectors(vertices[faces])
    size = torch.linalg.vector_norm(area, dim=1, keepdim=True)
    return area / torch.where(size > 0, size, 1.0)


def _seen(contrast: Tensor) -> np.ndarray:
    """(F,) bool: walls between regions that shine alike show nothing."""
    if contrast.requires_grad:
        return np.ones(len(contrast), dtype=bool)
    return contrast.cpu().numpy() != 0


def _means(plan: Plan, corners: Tensor, contrast: Tensor) -> tuple[Points, Spreading, bool]:
    """Points, grid and precision of the flux: those of the plan unless the solid is thin.

    The flux through opposite faces cancels but for their distance: errors relative to the surface
    are as many times larger relative to what lies inside.
    """
    assert plan.spreading is not None
    with torch.no_grad():
        vectors = _area_vectors(corners)
        middle = corners.reshape(-1, 3).mean(0) if len(corners) else corners.new_zeros(3)
        volume = float(((corners[:, 0] - middle) * vectors).sum(1).mul(contrast).sum().abs()) / 3
        area = float((vectors.norm(dim=1) * contrast.abs()).sum())
    reach = [k * s for k, s in zip(plan.band.half, plan.band.spacing, strict=True)]
    # At a third of the radius of the band; beyond the cap nothing is inside.
    cancelled = min(area / max(volume * sum(reach) / 9, 1e-300), 1e8)
    if cancelled < _THICK or not area:
        return plan.quadrature_of(len(corners)), plan.spreading, plan.single
    tolerance = max(plan.tolerance / cancelled, 1e-13)
    single = plan.single and tolerance > 5e-6
    edges = (corners - corners.roll(1, 1)).detach().abs() * corners.new_tensor(reach)
    phases = edges.norm(dim=2).amax(1).cpu().numpy()
    # As if the OTF were flat over the band: finer rules and wider kernels than need be.
    rules = choose_rules(phases, 1.0, max(RULE_SHARE * plan.accuracy / cancelled, 1e-12))
    points = Points(rules, len(corners))
    spreading = choose_spreading(
        plan.band.half, plan.band.spacing, flat, tolerance, points.count, single, dipoles=True
    )
    return points, spreading, single


# -------------------------------------------------------------------------------- near zero


@cache
def _nodes(error: float) -> tuple[np.ndarray, np.ndarray]:
    """Shells t and their weights: the fewest whose integral of t^2 exp(-ist) is this accurate."""
    s = np.linspace(0, _LARGEST_PHASE, 50)[:, None]
    t, w = _gauss(16)
    exact = np.exp(-1j * s * t) @ w
    for n in range(1, 10):
        t, w = _gauss(n)
        if np.abs(np.exp(-1j * s * t) @ w - exact).max() < max(error, _EXACT) / 3:
            break
    return t, w


def _gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Jacobi rule of the weight t^2 on 0..1."""
    x, w = roots_jacobi(n, 0, 2)
    return (x + 1) / 2, w / 8


def _low_band(band: Band, reach: float) -> Band:
    """The part of the band where shells are taken; zero always is."""
    half = tuple(
        min(k, floor(_NEAR / max(reach * s, 1e-300)))
        for k, s in zip(band.half, band.spacing, strict=True)
    )
    return Band(band.fft_shape, band.voxel_size, half)  # type: ignore[arg-type]


def _low_shells(
    plan: Plan, low: Band, corners: Tensor, contrast: Tensor, centre: Tensor, reach: float
) -> Tensor:
    """u_hat on the low box by shells of points; differentiable in the contrast alone."""
    kind = torch.complex64 if plan.single else torch.complex128
    points, volumes = [], []
    vectors = _area_vectors(corners)
    seen = _seen(contrast)
    for r, where in _low_rules(corners, reach, plan.accuracy):
        of, mix, size = (
            torch.from_numpy(a).to(corners.device)
            for a in (where[seen[where]], r.barycentric, r.weights)
        )
        arms = mix @ (corners[of] - centre)
        share = (arms * vectors[of][:, None]).sum(2) * size
        points.append(arms.reshape(-1, 3))
        volumes.append((share * contrast[of].to(torch.float64)[:, None]).reshape(-1))
    if not points:
        return torch.zeros(low.box_shape, dtype=kind, device=corners.device)
    t, weight = (torch.from_numpy(a).to(corners.device) for a in _nodes(plan.tolerance))
    strengths = (weight[:, None] * torch.cat(volumes)).reshape(-1)
    if low.half == (0, 0, 0):
        return strengths.sum().reshape(1, 1, 1).to(kind)
    shells = (centre + t[:, None, None] * torch.cat(points)).reshape(-1, 3)
    each = torch.arange(len(shells), device=shells.device)[:, None]
    one = Points([(_POINT, np.arange(len(shells)))], len(shells))
    spreading = choose_spreading(
        low.half, low.spacing, flat, plan.tolerance, len(shells), plan.single
    )
    return elements_ft(shells, each, strengths, one, spreading, plan.single)


def _low_rules(corners: Tensor, reach: float, accuracy: float) -> list[tuple[Rule, np.ndarray]]:
    edges = (corners - corners.roll(1, 1)).detach().norm(dim=2).amax(1).cpu().numpy()
    phases = _LARGEST_PHASE * edges / max(reach, 1e-300)
    return choose_rules(phases, 1.0, RULE_SHARE * accuracy)


def _shells(
    vertices: Tensor, faces: Tensor, contrast: Tensor, wavevectors: Tensor, centre: Tensor
) -> Tensor:
    """u_hat (K,) by closed-form shells, at wavevectors near zero."""
    arms = vertices - centre
    distance = (arms[faces[:, 0]] * _normals(vertices, faces)).sum(1) * contrast
    total = torch.zeros(len(wavevectors), dtype=torch.complex128, device=vertices.device)
    for t, weight in zip(*_nodes(_EXACT), strict=True):
        # The area of the smaller face brings t^2, which the weight of the rule has already.
        part = mesh_ft(t * arms, faces, wavevectors, distance)
        empty = _empty_flux(arms, faces, contrast, t * wavevectors, arms)
        total = total + weight / t**2 * part + weight * empty[:, 0]
    return total * torch.exp(-1j * (wavevectors @ centre))


def _embedded(box: Tensor, half: Sequence[int], into: Sequence[int]) -> Tensor:
    """A box of wavevectors, zero-padded to a larger one."""
    z, y, x = (n - k for n, k in zip(into, half, strict=True))
    return torch.nn.functional.pad(box, (0, x, y, y, z, z))


# ------------------------------------------------------------------------------------- the flux


def _empty_flux(
    vertices: Tensor,
    faces: Tensor,
    contrast: Tensor,
    wavevectors: Tensor,
    along: Tensor | None = None,
) -> Tensor:
    """Flux (K, 3) through faces of no area: zero, but their gradient is not.

    A surface's kernel sees length of a normal and its direction apart, and there is none. With
    ``along`` (V, 3), the component (K, 1) along it, which is the same at all corners of a face.
    """
    is_empty = (_area_vectors(vertices.detach()[faces]) == 0).all(1)
    if not bool(is_empty.any()):
        columns = 3 if along is None else 1
        return torch.zeros(1, columns, dtype=torch.complex128, device=vertices.device)
    empty = faces[is_empty]
    corners = vertices[empty]
    vectors = _area_vectors(corners) * contrast[is_empty][:, None]
    if along is not None:
        vectors = (along[empty][:, 0] * vectors).sum(1, keepdim=True)
    c = corners.detach()
    edges = torch.stack([c[:, (p + 2) % 3] - c[:, (p + 1) % 3] for p in range(3)])
    share, _ = triangle_transform(edges @ wavevectors.T)
    share = 2 * share * torch.exp(-1j * (c.mean(1) @ wavevectors.T))
    return share.T @ vectors.to(torch.complex128)


def _flux_factor(wavevectors: Tensor) -> Tensor:
    """i xi / |xi|^2 along the last axis, 0 at zero."""
    squared = (wavevectors**2).sum(-1, keepdim=True)
    return 1j * wavevectors / torch.where(squared > 0, squared, 1.0)


def _closed_form(
    plan: Plan, low: Band, vertices: Tensor, faces: Tensor, contrast: Tensor, centre: Tensor
) -> Tensor:
    band, there = plan.band, vertices.device
    u = torch.zeros(band.box_shape, dtype=torch.complex128, device=there)
    xi = row_wavevectors(band.rows, band.spacing).to(there)
    empty = _empty_flux(vertices, faces, contrast, xi)
    normals = _normals(vertices, faces)
    for axis, along in enumerate(band.axes()):
        # Always in double precision: the parts cancel.
        density = normals[:, axis] * contrast
        rows = band_ft(vertices, faces, density, band.rows, band.spacing, False)
        u = u + along.to(there) * band.to_box(rows + empty[:, axis])
    u = u * (1j * torch.from_numpy(inverse_square(band.half, band.spacing)).to(there))
    kept = torch.zeros(band.box_shape, dtype=torch.bool).reshape(-1)
    kept[band.row_index] = True
    inside = torch.zeros(band.box_shape, dtype=torch.bool)
    inside[within(low.half, band.half)] = True
    where = (inside & kept.reshape(band.box_shape)).nonzero()
    first = torch.tensor([-band.half[0], -band.half[1], 0])
    xi = (where + first).to(torch.float64) * torch.tensor(band.spacing, dtype=torch.float64)
    near = _shells(vertices, faces, contrast, xi.to(there), centre)
    u = u.index_put(where.to(there).unbind(1), near)
    return u.to(torch.complex64) if plan.single else u
