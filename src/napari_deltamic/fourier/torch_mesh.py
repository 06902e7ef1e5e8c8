"""Spreading and gathering with torch operations only: on any device, without compiled loops.

Single-precision plans run in single precision throughout: a position is split into a node of the
grid and the rest, so that it keeps its digits where they matter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from .spreading import Elements
from .triangle import cross

_NODES_AT_ONCE = 1 << 22  # of all points spread or gathered at a time: bounds the memory


def spread(
    vertices: Tensor,
    elements: Elements,
    density: Tensor,
    device: torch.device,
    vectors: Tensor | None = None,
) -> Tensor:
    """Spread as :func:`napari_deltamic.fourier.particle_mesh.spread` does."""
    real, spreading = elements.real, elements.spreading
    if vectors is None:
        strengths = (density * measure(vertices[elements.corners])[0])[:, None].to(real).to(device)
    else:
        strengths = (density[:, None] * vectors).to(real).to(device)
    z, y, x = spreading.shape
    grid = strengths.new_zeros(z * y * x)
    scale = spreading.scale_on(real, device)
    for some in _pieces(vertices, elements, device, vectors is not None):
        own = (strengths[some.of][:, None] * some.weights[:, None]).flatten(0, 1)
        if vectors is None:
            values = _outer(own[:, 0, None] * some.values[0], *some.values[1:])
        else:
            (kz, ky, kx), (sz, sy, sx) = some.values, some.slopes
            # Slopes are per node, by the point's position; seen from the grid they are opposite.
            az, ay, ax = (-own * scale).unsqueeze(-1).unbind(1)
            values = _outer(az * sz, ky, kx) + _outer(ay * kz, sy, kx) + _outer(ax * kz, ky, sx)
        grid.index_add_(0, some.nodes(spreading.shape).reshape(-1), values.reshape(-1))
    return grid.reshape(z, y, x)


def _outer(z: Tensor, y: Tensor, x: Tensor) -> Tensor:
    """Return (points, Wz, Wy, Wx) products of rows (points, W)."""
    return (z[:, :, None] * y[:, None, :])[..., None] * x[:, None, None, :]


def gather(vertices: Tensor, elements: Elements, field: Tensor, slopes: bool = False) -> Tensor:
    """Return sums over each element's points, (E, corners, 1), or (E, corners, 4) with slopes.

    Terms are weight times barycentric coordinate times the field, or its derivatives per um.
    """
    parts, spreading = 4 if slopes else 1, elements.spreading
    sums = field.new_zeros(*elements.corners.shape, parts)
    flat = field.reshape(-1)
    scale = spreading.scale_on(field.dtype, field.device)
    for some in _pieces(vertices, elements, field.device, slopes):
        node = flat[some.nodes(spreading.shape)]
        kz, ky, kx = some.values
        by_x = torch.einsum("pzyx,px->pzy", node, kx)
        by_y = torch.einsum("pzy,py->pz", by_x, ky)
        found = [torch.einsum("pz,pz->p", by_y, kz)]
        if slopes:
            sz, sy, sx = some.slopes
            across = torch.einsum("pzyx,px->pzy", node, sx)
            found += [
                torch.einsum("pz,pz->p", by_y, sz),
                torch.einsum("pzy,py,pz->p", by_x, sy, kz),
                torch.einsum("pzy,py,pz->p", across, ky, kz),
            ]
        each = torch.stack(found, -1).reshape(len(some.of), len(some.weights), parts)
        if slopes:
            each[..., 1:] *= scale
        shares = some.weights[:, None] * some.barycentric
        sums[some.of] = torch.einsum("epk,pc->eck", each, shares)
    return sums


def pull(
    vertices: Tensor, elements: Elements, density: Tensor, field: Tensor
) -> tuple[Tensor, Tensor]:
    """Return gradients (V, 3) and (E,) of :func:`spread`'s result, from the field on its grid."""
    sums = gather(vertices, elements, field, slopes=True)
    sums = sums.to(vertices.device).to(vertices.dtype)
    corners = elements.corners
    size, by_corner = measure(vertices[corners])
    all_ = sums[..., 0].sum(1)
    each = size[:, None, None] * sums[..., 1:] + all_[:, None, None] * by_corner
    each = density[:, None, None].to(each.dtype) * each
    by_vertex = torch.zeros_like(vertices).index_add_(0, corners.reshape(-1), each.reshape(-1, 3))
    return by_vertex, (size * all_).to(density.dtype)


def measure(corners: Tensor) -> tuple[Tensor, Tensor]:
    """Return (E,) area, length or 1, and its gradients (E, corners, 3), 0 if there is none."""
    gradient = torch.zeros_like(corners)
    if corners.shape[1] == 1:
        return torch.ones_like(corners[:, 0, 0]), gradient
    if corners.shape[1] == 2:
        along = corners[:, 1] - corners[:, 0]
        size = torch.linalg.vector_norm(along, dim=1)
        unit = along / torch.where(size > 0, size, 1.0)[:, None]
        return size, torch.stack([-unit, unit], 1)
    edges = corners.roll(1, 1) - corners.roll(-1, 1)  # opposite each corner
    normal = cross(edges[:, 2], edges[:, 0])
    doubled = torch.linalg.vector_norm(normal, dim=1)
    unit = normal / torch.where(doubled > 0, doubled, 1.0)[:, None]
    return doubled / 2, cross(unit[:, None].expand_as(edges), edges) / 2


# ------------------------------------------------------------------------------------------ pieces


@dataclass
class _Piece:
    """Some elements with one rule: values and slopes of their points, (points, width) by axis."""

    of: Tensor
    barycentric: Tensor
    weights: Tensor
    first: list[Tensor]
    values: list[Tensor]
    slopes: list[Tensor]

    def nodes(self, shape: tuple[int, int, int]) -> Tensor:
        """Return (points, Wz, Wy, Wx) the nodes of each point, in the flattened grid."""
        z, y, x = (
            (first[:, None] + torch.arange(v.shape[1], device=first.device)) % n
            for first, v, n in zip(self.first, self.values, shape, strict=True)
        )
        rows = (z * shape[1])[:, :, None] + y[:, None, :]
        return (rows * shape[2])[..., None] + x[:, None, None, :]


def _pieces(
    vertices: Tensor, elements: Elements, device: torch.device, slopes: bool
) -> Iterator[_Piece]:
    real, spreading = elements.real, elements.spreading
    scale = spreading.scale_on(vertices.dtype, vertices.device)
    corners = (vertices.detach() * scale)[elements.corners]
    node = torch.round(corners[:, :1])
    local = (corners - node).to(real).to(device)
    node = node[:, 0].to(torch.int64).to(device)
    kernels = spreading.coefficients(real, device)
    each = 1
    for k in spreading.kernels:
        each *= k.width
    for barycentric, weights, of in elements.points.groups(real, device):
        step = max(1, _NODES_AT_ONCE // (each * len(weights)))
        for some in of.split(step):
            at = torch.einsum("pc,eck->epk", barycentric, local[some])
            first, found, tilted = [], [], []
            for axis in range(3):
                edge = at[..., axis] - spreading.kernels[axis].width / 2
                up = torch.ceil(edge)
                first.append((node[some, None, axis] + up.to(torch.int64)).reshape(-1))
                value, slope = _evaluated(kernels[axis], (up - edge).reshape(-1), slopes)
                found.append(value)
                tilted.append(slope)
            yield _Piece(some, barycentric, weights, first, found, tilted)


def _evaluated(coefficients: Tensor, f: Tensor, slopes: bool) -> tuple[Tensor, Tensor]:
    """Evaluate the polynomials, (points, width), and their slopes per node, by Horner's rule."""
    t = (2 * f - 1)[:, None]
    value = coefficients[0].expand(len(f), -1)
    slope = torch.zeros_like(value)
    for c in coefficients[1:]:
        if slopes:
            slope = slope * t + value
        value = value * t + c
    return value, -2 * slope  # t falls by 2 when a point moves on by one node
