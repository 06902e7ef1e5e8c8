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

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from .closed_form import band_ft, mesh_ft, row_wavevectors
from .flux import flux_ft, inverse_square, within
from .plan import Plan
from .solid_plan import EXACT, SolidPlan, area_vectors, centre_of, nodes
from .spreading import Elements
from .triangle import triangle_transform


def contrasts(regions: Tensor | np.ndarray, ids: np.ndarray, weights: Tensor) -> Tensor:
    """Return (F,) the weight behind each face minus that in front of it; 0 for the outside.

    Parameters
    ----------
    regions
        (F, 2) region numbers of each face, as in a mesh.
    ids
        (R,) sorted region numbers, as :meth:`napari_deltamic.Mesh.region_ids` gives them.
    weights
        (R,) signal per um^3 of each region, in that order; the result is differentiable in them.

    Raises
    ------
    InputError
        If the number of weights is not that of the regions.
    """
    if weights.shape != (len(ids),):
        raise InputError(
            f"weights must have shape ({len(ids)},), one number per region, "
            f"not {tuple(weights.shape)}"
        )
    return jumps(sides_of(regions, ids).to(weights.device), weights)


def sides_of(regions: Tensor | np.ndarray, ids: np.ndarray) -> Tensor:
    """Return (2, F) ranks of the regions behind each face and in front of it; 0 is the outside."""
    # A region number may be anything.
    sides = np.searchsorted(np.append(0, ids), np.asarray(regions))
    return torch.from_numpy(np.ascontiguousarray(sides.T))


def jumps(sides: Tensor, weights: Tensor) -> Tensor:
    """Compute :func:`contrasts` (F,) from ranks (2, F) and weights (R,), on one device."""
    of = torch.cat([weights.new_zeros(1), weights])
    # Not by indexing, whose gradient sorts on a GPU.
    behind, front = (of.index_select(0, side) for side in sides)
    return behind - front


def solid_transform(
    plan: Plan | SolidPlan, vertices: Tensor, faces: Tensor, contrast: Tensor
) -> Tensor:
    """Compute u_hat of solids on the box of a plan's band.

    Parameters
    ----------
    plan
        Made for this mesh, or one near it. A surface's plan works too, but the rest is then planned
        anew at every call.
    vertices
        (V, 3) um relative to the centre of the grid's first voxel, as in :meth:`Plan.transform`.
    faces
        (F, 3) int64.
    contrast
        (F,) see :func:`contrasts`.

    Returns
    -------
    Complex tensor of the shape ``plan.band.box_shape``, differentiable in vertices and contrast.
    A solid's spectrum falls faster than that of its surface, so its image is more accurate than
    the plan expects for the surface.
    """
    x = vertices.to(torch.float64)
    if isinstance(plan, Plan):
        v, f, jump = (t.detach().cpu().numpy() for t in (x, faces, contrast))
        plan = SolidPlan.of(plan, v, f, jump)
    if plan.flux is None:
        return _closed_form(plan, x, faces, contrast)
    _, spreading, single = plan.flux
    points, near_points = plan.points_of(contrast)
    corners = x.detach()[faces]
    areas = area_vectors(corners)
    spread = Elements(faces, points, spreading, single)
    far = flux_ft(x, spread, areas, contrast, plan.low.half)
    near = plan.low_shells(near_points, centre_of(x), corners, areas, contrast)
    return far.to(near.dtype) + plan.low.widened(near, plan.plan.band)


# ------------------------------------------------------------------------------------ geometry


def _normals(vertices: Tensor, faces: Tensor) -> Tensor:
    area = area_vectors(vertices[faces])
    size = torch.linalg.vector_norm(area, dim=1, keepdim=True)
    return area / torch.where(size > 0, size, 1.0)


# -------------------------------------------------------------------------------- near zero


def _shells(
    vertices: Tensor, faces: Tensor, contrast: Tensor, wavevectors: Tensor, centre: Tensor
) -> Tensor:
    """Compute u_hat (K,) by closed-form shells, at wavevectors near zero."""
    arms = vertices - centre
    distance = (arms[faces[:, 0]] * _normals(vertices, faces)).sum(1) * contrast
    total = torch.zeros(len(wavevectors), dtype=torch.complex128, device=vertices.device)
    for t, weight in zip(*nodes(EXACT), strict=True):
        # The area of the smaller face brings t^2, which the weight of the rule has already.
        part = mesh_ft(t * arms, faces, wavevectors, distance)
        empty = _empty_flux(arms, faces, contrast, t * wavevectors, arms)
        total = total + weight / t**2 * part + weight * empty[:, 0]
    return total * torch.exp(-1j * (wavevectors @ centre))


# ------------------------------------------------------------------------------------- the flux


def _empty_flux(
    vertices: Tensor,
    faces: Tensor,
    contrast: Tensor,
    wavevectors: Tensor,
    along: Tensor | None = None,
) -> Tensor:
    """Compute the flux (K, 3) through faces without area: it is zero, but its gradient is not.

    The kernel of surfaces needs length and direction of a normal, and here there is none. With
    ``along`` (V, 3), only the component (K, 1) along it, which all corners of a face share.
    """
    is_empty = (area_vectors(vertices.detach()[faces]) == 0).all(1)
    if not bool(is_empty.any()):
        columns = 3 if along is None else 1
        return torch.zeros(1, columns, dtype=torch.complex128, device=vertices.device)
    empty = faces[is_empty]
    corners = vertices[empty]
    vectors = area_vectors(corners) * contrast[is_empty][:, None]
    if along is not None:
        vectors = (along[empty][:, 0] * vectors).sum(1, keepdim=True)
    c = corners.detach()
    edges = torch.stack([c[:, (p + 2) % 3] - c[:, (p + 1) % 3] for p in range(3)])
    share, _ = triangle_transform(edges @ wavevectors.T)
    share = 2 * share * torch.exp(-1j * (c.mean(1) @ wavevectors.T))
    return share.T @ vectors.to(torch.complex128)


def _closed_form(plan: SolidPlan, vertices: Tensor, faces: Tensor, contrast: Tensor) -> Tensor:
    band, low, there = plan.plan.band, plan.low, vertices.device
    u = torch.zeros(band.box_shape, dtype=torch.complex128, device=there)
    xi = row_wavevectors(band.rows, band.spacing).to(there)
    empty = _empty_flux(vertices, faces, contrast, xi)
    normals = _normals(vertices, faces)
    for axis, along in enumerate(band.axes()):
        # Always in double precision, since the parts cancel.
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
    near = _shells(vertices, faces, contrast, xi.to(there), centre_of(vertices))
    u = u.index_put(where.to(there).unbind(1), near)
    return u.to(torch.complex64) if plan.plan.single else u
