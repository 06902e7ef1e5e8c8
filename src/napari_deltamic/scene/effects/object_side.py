"""From a mesh to the transform of what shines, with the effects that act on the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...fourier import Plan
from ...fourier.solid import contrasts, solid_transform
from ...geometry.mesh import Mesh
from ..grid import Grid
from . import Effects
from .base import FaceEffect


@dataclass(frozen=True)
class Surfaces:
    """What an object's transform needs of a mesh besides its vertices.

    faces : (F, 3) ; regions : (F, 2) ; ids : (R,) sorted region numbers.
    """

    faces: Tensor
    regions: np.ndarray
    ids: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh) -> Surfaces:
        return cls(torch.as_tensor(mesh.faces), mesh.regions, mesh.region_ids())


def acts_on_object(effects: Effects) -> bool:
    """Whether the object's transform is another with these effects."""
    faces = any(isinstance(effect, FaceEffect) for effect in effects.present())
    return faces or effects.bulk is not None or effects.depth_psf is not None


def object_transform(
    plan: Plan,
    vertices: Tensor,
    surfaces: Surfaces,
    weight: Tensor,
    effects: Effects,
    grid: Grid,
    frame: Grid,
) -> Tensor:
    """u_hat on the box of the plan's band, differentiable in vertices and weight.

    Parameters
    ----------
    plan
        Made for this mesh, or one near it.
    vertices
        (V, 3) um.
    surfaces
        Of the mesh.
    weight
        (F,) fluorophores per um^2 of each face.
    effects
        Those that act on the object are applied.
    grid, frame
        Of the plan, and of the whole image.

    Returns
    -------
    Complex tensor of the shape ``plan.band.box_shape``; with a PSF that changes with depth two of
    them, for the PSF in the first and in the last slice.
    """
    origin = torch.tensor(grid.origin, dtype=vertices.dtype)
    centroids = vertices[surfaces.faces].mean(1)
    for effect in effects.present():
        if isinstance(effect, FaceEffect):
            weight = weight * effect.face_weights(centroids, frame)
    seen = plan.transform(vertices - origin, surfaces.faces, weight)
    inside = None
    if effects.bulk is not None:
        contrast = contrasts(
            surfaces.regions, surfaces.ids, _densities(effects, surfaces, centroids, frame)
        )
        inside = solid_transform(plan, vertices - origin, surfaces.faces, contrast)
    if effects.depth_psf is None:
        return seen if inside is None else seen + inside
    depths = effects.depth_psf.depths(centroids, frame)
    last = plan.transform(vertices - origin, surfaces.faces, weight * depths)
    first = seen - last
    if inside is not None:
        # A solid has no depth of its own: it is seen half through either.
        first, last = first + inside / 2, last + inside / 2
    return torch.stack([first, last])


def _densities(effects: Effects, surfaces: Surfaces, centroids: Tensor, frame: Grid) -> Tensor:
    """(R,) bulk density of each region; one that lies deep shines less where light is lost.

    The loss within a region is left out: what its membrane tells of it is enough.
    """
    assert effects.bulk is not None
    density = effects.bulk.densities(torch.from_numpy(surfaces.ids))
    if effects.attenuation is None:
        return density
    at = torch.stack(
        [
            centroids.detach()[torch.from_numpy((surfaces.regions == k).any(1))].mean(0)
            for k in surfaces.ids
        ]
    )
    return density * effects.attenuation.face_weights(at, frame)
