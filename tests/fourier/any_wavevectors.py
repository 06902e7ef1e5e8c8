"""Transforms at any wavevectors, of the parts that those on a band are made of."""

import numpy as np
import torch

from napari_deltamic.fourier.closed_form import as_mesh_tensors, mesh_ft
from napari_deltamic.fourier.filament import _in_chunks, _points_part, _segments_part
from napari_deltamic.fourier.solid import _empty_flux, _normals, _shells
from napari_deltamic.fourier.solid_plan import NEAR, centre_of, reach_of


def solid_ft(vertices, faces, wavevectors, contrast=None):
    """(K,) of what closed surfaces hold: by shells near zero, by the flux elsewhere."""
    v, f, jump = as_mesh_tensors(vertices, faces, contrast)
    xi = torch.as_tensor(wavevectors, dtype=torch.float64)
    x = v.to(torch.float64)
    centre = centre_of(x)
    near = (xi.abs() * reach_of(x, centre)).amax(1) <= NEAR
    u = torch.zeros(len(xi), dtype=torch.complex128)
    u = u.index_put((near.nonzero()[:, 0],), _shells(x, f, jump, xi[near], centre))
    far = (~near).nonzero()[:, 0]
    flux = torch.stack([mesh_ft(x, f, xi[far], n * jump) for n in _normals(x, f).unbind(1)], 1)
    flux = flux + _empty_flux(x, f, jump, xi[far])
    factor = 1j * xi[far] / (xi[far] ** 2).sum(1, keepdim=True)
    u = u.index_put((far,), (factor * flux).sum(1))
    return u.to(torch.complex64 if v.dtype == torch.float32 else torch.complex128)


def filament_ft(vertices, segments, wavevectors, weights=None):
    """(K,) of line segments (S, 2), of weights (S,) per um."""
    v, xi = torch.as_tensor(vertices), torch.as_tensor(wavevectors)
    s = np.asarray(segments)
    w = torch.ones(len(s), dtype=torch.float64) if weights is None else torch.as_tensor(weights)
    return _in_chunks(_segments_part, v[s[:, 0]], v[s[:, 1]], w, xi)


def point_ft(points, wavevectors, weights):
    """(K,) of points (P, 3), of weights (P,)."""
    v, xi, w = (torch.as_tensor(t) for t in (points, wavevectors, weights))
    return _in_chunks(_points_part, v, w, xi)
