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
    return job if points is None else replace(job, crowded=_crowded(mesh, grid, points))


def start_of(
    seeds: Seeds, image: NDArray[Any], grid: Grid
) -> tuple[Mesh, SeedKind, FloatArray | None]:
    """Starting surfaces, how near to the membranes they lie, and points that a user gave."""
    points = seeds.places(grid) if isinstance(seeds, PointSeeds) else None
    return seeds.make(image, grid), seeds.kind, points


def _crowded(mesh: Mesh, grid: Grid, points: FloatArray) -> frozenset[int]:
    """Regions in which several points lie."""
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    index = np.floor((points - np.asarray(grid.origin)) / np.asarray(grid.voxel_size) + 0.5)
    index = index[((index >= 0) & (index < grid.shape)).all(1)].astype(int)
    regions, number = np.unique(labels[tuple(index.T)], return_counts=True)
    return frozenset(regions[(number > 1) & (regions > 0)].tolist())
