"""Puts a fit together from its settings; the image tells what they leave open."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.doing import doing
from ..errors import RepairWarning
from ..fitting.job import FitInput, assemble, levelled
from ..fitting.model.hot_voxels import hot_told, without_hot
from ..geometry import Mesh
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import FloatArray
from ..runs.seeds import PointSeeds, SeedKind, Seeds
from ..runs.settings import RunSettings, SceneSettings
from ..scene import Grid
from .first_sigma import with_first_psf
from .tilted_ground import with_ground

Start = Callable[[NDArray[Any], Grid], tuple[Mesh, SeedKind, FloatArray | None]]


def put_together(
    settings: RunSettings,
    image: NDArray[Any],
    grid: Grid,
    start: Start,
    *,
    tell: Callable[[SceneSettings, str, bool], None] | None = None,
    second: NDArray[Any] | None = None,
    ground: bool = True,
) -> FitInput:
    """The inputs of a fit, ready to run. May take seconds.

    Hot voxels are reported and then missing in its image, so that nothing that follows uses them.

    Parameters
    ----------
    image : (Z, Y, X); NaN where missing.
    start : makes the mesh from the image without what effects add to it; also returns how near to
        the membranes it lies, and the points (n, 3) um that it was made for, if any.
    tell : called before that with the scene to be fitted, a sentence on its background ('' if that
        is even), and whether the image told how wide the PSF is.
    second : (Z, Y, X) second view, if it is not in a file.
    ground : whether an uneven background may be looked for.

    Raises
    ------
    InputError
        If something cannot be used.
    """
    as_read = image
    doing("looking at the image")
    image, hot = without_hot(image)
    if hot:
        warnings.warn(hot_told(hot), RepairWarning, stacklevel=2)
    scene, uneven = with_ground(settings.scene, image) if ground else (settings.scene, "")
    level = levelled(image, grid, scene.effects)
    doing("measuring the blur")
    scene, told = with_first_psf(scene, level)
    if tell is not None:
        tell(scene, uneven, told)
    doing("making meshes of the cells")
    mesh, kind, points = start(level, grid)
    whole = settings.model_copy(update={"scene": scene})
    job = assemble(whole, image, grid, mesh, kind, second)
    given = settings.scene.sigma is not None or settings.scene.optics is not None
    job = replace(job, with_hot=as_read if hot else None, psf_guessed=not given)
    if points is None:
        return job
    crowded, missing = _placed(mesh, grid, points)
    return replace(job, crowded=crowded, missing=missing)


def start_of(
    seeds: Seeds, image: NDArray[Any], grid: Grid
) -> tuple[Mesh, SeedKind, FloatArray | None]:
    """Starting surfaces, how near to the membranes they lie, and points that a user gave."""
    points = seeds.places(grid) if isinstance(seeds, PointSeeds) else None
    return seeds.make(image, grid), seeds.kind, points


def _placed(mesh: Mesh, grid: Grid, points: FloatArray) -> tuple[frozenset[int], tuple[int, ...]]:
    """Regions in which several points lie, and the numbers, from 1, of points that lie in none."""
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    index = np.floor((points - np.asarray(grid.origin)) / np.asarray(grid.voxel_size) + 0.5)
    seen = ((index >= 0) & (index < grid.shape)).all(1)
    region = np.zeros(len(points), labels.dtype)
    region[seen] = labels[tuple(index[seen].astype(int).T)]
    names, number = np.unique(region, return_counts=True)
    # A point beside a surface is still that of a cell that is named after it.
    own = np.isin(np.arange(len(points)) + 1, mesh.region_ids())
    # Beyond the image, or the part of it that is fitted, no cell was asked for.
    missing = np.flatnonzero(seen & (region == 0) & ~own) + 1
    crowded = names[(number > 1) & (names > 0)]
    return frozenset(crowded.tolist()), tuple(missing.tolist())
