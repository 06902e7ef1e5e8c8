"""The surfaces that points would give, on a coarser image: shown before a fit is started."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.triple import Triple, triple
from ..errors import InputError
from ..geometry import Mesh
from ..geometry.labels.meshes import EDGE_IN_VOXELS
from ..geometry.mesh import FloatArray
from ..geometry.seed_points import surfaces_of_points
from ..images.missing import filled
from ..scene import Grid

Problem = tuple[str, tuple[int, ...]]  # a sentence, and the points that it names, counted from 1
SMALL = 250_000  # voxels whose preview takes about a second
COARSEST = 2  # most voxels joined along an axis to get there


@dataclass(frozen=True)
class Found:
    """Starting surfaces, None if no point gave one; and what is wrong with those that gave none."""

    mesh: Mesh | None
    problems: tuple[Problem, ...]


def find(points: FloatArray, image: NDArray[Any], grid: Grid) -> Found:
    """Starting surfaces of points (um), on a coarser image where that saves much time.

    Points without a surface are named and left out; those outside the image are only left out.
    """
    inside = np.floor(points / np.asarray(grid.voxel_size) + 0.5)
    left = np.flatnonzero(((inside >= 0) & (inside < np.asarray(grid.shape))).all(axis=1))
    if not len(left):
        return Found(None, ())
    whole, coarse = coarser(filled(image), grid)
    edge = EDGE_IN_VOXELS * min(grid.voxel_size)  # as in the fit
    try:
        parts, refused = surfaces_of_points(
            whole, coarse.voxel_size, points[left], None, coarse.origin, edge
        )
    except InputError as error:
        return Found(None, ((str(error), ()),))
    problems = tuple((one.text, tuple(int(left[n - 1]) + 1 for n in one.points)) for one in refused)
    return Found(Mesh.merge(parts) if parts else None, problems)


def usable(
    choices: Sequence[Sequence[Triple]], before: FloatArray, image: NDArray[Any], grid: Grid
) -> list[Triple]:
    """The first place (um) of each choice that gives a surface; choices without one are left out.

    A place does not count if its surface is that of a point in ``before``, or of another choice.
    """
    places = [place for choice in choices for place in choice]
    if not places:
        return []
    found = find(np.array([*before.tolist(), *places]), image, grid)
    if found.mesh is None:
        return []
    refused = {points[-1] for _, points in found.problems if points}
    free, number = [], len(before)
    for choice in choices:
        numbers = range(number + 1, number + 1 + len(choice))
        number += len(choice)
        free += [p for n, p in zip(numbers, choice, strict=True) if n not in refused][:1]
    return free


def coarsening(shape: tuple[int, ...], size: tuple[float, ...]) -> tuple[int, ...]:
    """How many voxels to join along each axis: 1 in small images, else 2, shortest sides first."""
    factors = [1] * len(shape)
    for axis in np.argsort(size, kind="stable").tolist():
        voxels = np.prod(np.ceil(np.divide(shape, factors)))
        same = [k for k in range(len(shape)) if np.isclose(size[k], size[axis])]
        if voxels > SMALL:
            for k in same:
                factors[k] = COARSEST
    return tuple(factors)


def coarser(image: NDArray[Any], grid: Grid) -> tuple[NDArray[Any], Grid]:
    """The image with voxels joined by ``coarsening``, and its grid."""
    factors = coarsening(grid.shape, grid.voxel_size)
    if max(factors) == 1:
        return image, grid
    short = [(0, -n % f) for n, f in zip(image.shape, factors, strict=True)]
    blocks = np.pad(np.asarray(image, np.float32), short, mode="edge")
    for axis, factor in enumerate(factors):
        shape = (*blocks.shape[:axis], -1, factor, *blocks.shape[axis + 1 :])
        blocks = blocks.reshape(shape).mean(axis=axis + 1)
    size = np.multiply(grid.voxel_size, factors)
    # The first voxel is now centred between several.
    origin = np.add(grid.origin, np.multiply(grid.voxel_size, np.subtract(factors, 1)) / 2)
    return blocks, Grid(blocks.shape, triple(size), triple(origin))
