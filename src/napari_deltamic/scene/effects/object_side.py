"""From a mesh to the transform of what shines, with the effects that act on the object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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
    return faces or effects.bulk is not None or effects.depth is not None


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
    side = ObjectSide(plan, vertices, surfaces, weight, effects, grid, frame)
    deep = None if effects.depth is None else side.deep()
    inside = None if effects.bulk is None else side.inside()
    return assembled(side.seen(), deep, inside)


@dataclass(frozen=True)
class ObjectSide:
    """The parts that an object's transform is made of; see :func:`object_transform`."""

    plan: Plan
    vertices: Tensor
    surfaces: Surfaces
    weight: Tensor
    effects: Effects
    grid: Grid
    frame: Grid

    @cached_property
    def _placed(self) -> Tensor:
        return self.vertices - torch.tensor(self.grid.origin, dtype=self.vertices.dtype)

    @cached_property
    def _centroids(self) -> Tensor:
        return self.vertices[self.surfaces.faces].mean(1)

    @cached_property
    def _bright(self) -> Tensor:
        """(F,) weight with what effects make of it."""
        weight = self.weight
        for effect in self.effects.present():
            if isinstance(effect, FaceEffect):
                weight = weight * effect.face_weights(self._centroids, self.frame)
        return weight

    def seen(self) -> Tensor:
        """The surface."""
        return self.plan.transform(self._placed, self.surfaces.faces, self._bright)

    def deep(self) -> Tensor:
        """The surface times its relative depth, for the PSF in the last slice."""
        assert self.effects.depth is not None
        depths = self.effects.depth.depths(self._centroids, self.frame)
        return self.plan.transform(self._placed, self.surfaces.faces, self._bright * depths)

    def inside(self) -> Tensor:
        """The solids."""
        return solid_transform(self.plan, self._placed, self.surfaces.faces, self.contrast())

    def contrast(self) -> Tensor:
        """(F,) bulk density behind each face minus that in front of it."""
        s = self.surfaces
        densities = _densities(self.effects, s, self._centroids, self.frame)
        return contrasts(s.regions, s.ids, densities)


def assembled(seen: Tensor, deep: Tensor | None, inside: Tensor | None) -> Tensor:
    """One transform of the parts; two, for the first and the last slice, where there is a deep one.

    A solid has no depth of its own: it is seen half through either PSF.
    """
    if deep is None:
        return seen if inside is None else seen + inside
    first, last = seen - deep, deep
    if inside is not None:
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
