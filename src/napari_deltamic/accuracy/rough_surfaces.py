"""Surfaces about as large as those that seeds would give, made at once: enough for a forecast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.ball import ball_radius
from ..errors import InputError
from ..geometry import Mesh, sphere
from ..geometry.contacts import label_contacts
from ..geometry.labels.meshes import EDGE_IN_VOXELS
from ..geometry.mesh import FloatArray
from ..runs.seeds import LabelSeeds, MeshSeeds, MixedSeeds, PointSeeds, Seeds
from ..scene import Grid


@dataclass(frozen=True, eq=False)
class RoughSurfaces:
    """Surfaces for a forecast.

    touching : whether cells touch, if labels tell; None if it is to be seen from the surfaces.
    """

    mesh: Mesh
    touching: bool | None


def rough_surfaces(seeds: Seeds, grid: Grid, known: Mesh | None = None) -> RoughSurfaces:
    """Rough surfaces for any seeds; InputError if there are none.

    known : the surfaces that the image gives for the points, if already found.
    """
    parts = seeds.parts if isinstance(seeds, MixedSeeds) else (seeds,)
    meshes, labels = [], []
    for part in parts:
        if isinstance(part, PointSeeds):
            if part.kind == "image" and known is not None:
                meshes.append(known)
            else:
                meshes.append(_balls(part.points, part.radii, grid))
        elif isinstance(part, LabelSeeds):
            labels.append(np.asarray(part.labels))
            meshes += _balls_of_labels(labels[-1], grid)
        elif isinstance(part, MeshSeeds):
            meshes.append(part.surface)
    if not meshes:
        raise InputError("there are no surfaces to start from")
    touching = any(len(label_contacts(one)[0]) for one in labels) if labels else None
    return RoughSurfaces(Mesh.merge(meshes), touching)


def points_of(seeds: Seeds) -> int:
    """How many points of the seeds have no radius, so that the image gives their surfaces."""
    parts = seeds.parts if isinstance(seeds, MixedSeeds) else (seeds,)
    points = [part for part in parts if isinstance(part, PointSeeds) and part.kind == "image"]
    return sum(len(part.points) for part in points)


def _balls(centres: FloatArray, radii: FloatArray | None, grid: Grid) -> Mesh:
    """Spheres around points, with the given radii, else as large as their distances allow."""
    edge = EDGE_IN_VOXELS * min(grid.voxel_size)
    if radii is None or not np.all(np.nan_to_num(radii) > 0):
        apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
        np.fill_diagonal(apart, np.inf)
        side = float(np.multiply(grid.shape, grid.voxel_size).min())
        apart_by = 0.45  # of the way to the next: nearly half, so that no two touch
        guess = np.clip(apart_by * apart.min(axis=1), 2 * edge, max(side / 3, 2 * edge))
        radii = guess if radii is None else np.where(np.nan_to_num(radii) > 0, radii, guess)
    return Mesh.merge(
        [sphere(c, float(r), edge_length=edge) for c, r in zip(centres, radii, strict=True)]
    )


def _balls_of_labels(labels: NDArray[Any], grid: Grid) -> list[Mesh]:
    """A sphere as large as each label; all in one place, which makes no difference to the cost."""
    numbers, volumes = np.unique(labels[labels > 0], return_counts=True)
    if not len(numbers):
        return []
    radii = ball_radius(volumes * float(np.prod(grid.voxel_size)))
    middle = (np.asarray(grid.shape) - 1) / 2 * grid.voxel_size
    return [_balls(np.tile(middle, (len(numbers), 1)), radii, grid)]
