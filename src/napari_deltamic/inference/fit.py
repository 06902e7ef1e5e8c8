"""The fit: a generator that moves vertices, densities and PSF until the rendered image agrees."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from ..errors import InputError
from ..fourier.plan import check_accuracy
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid
from ..settings import EFFECTS, WIDE_LEVELS, FitSettings
from .change import Change
from .checks import check_image, check_mesh, hot_voxels
from .default_accuracy import accuracy_for_image
from .level import FEWEST_VOXELS
from .likelihood import noise_ratio, smoothing_for
from .run import Run
from .state import FitState, load_checkpoint


def fit(
    image: np.ndarray | Tensor,
    grid: Grid,
    mesh: Mesh,
    optics: Optics,
    accuracy: float | None = None,
    *,
    settings: FitSettings | None = None,
    counted: np.ndarray | None = None,
    effects: tuple[str, ...] = (),
    resume: str | Path | None = None,
) -> Generator[FitState, Change | None, None]:
    """Fit a mesh to an image; yields a state after every iteration and ends by itself.

    What a user changes meanwhile is sent in: ``states.send(Change(vertices=...))`` does the next
    iteration from there, also after the last state.

    Parameters
    ----------
    image
        (Z, Y, X) measured intensities; NaN marks missing voxels.
    grid
        Where the voxels lie.
    mesh
        Where to start; closed surfaces near the membranes, um.
    optics
        The PSF; held, unless the settings say to fit it.
    accuracy
        Overrides that of the settings.
    settings
        Everything else; see :class:`napari_deltamic.settings.FitSettings`.
    counted
        (Z, Y, X) bool: voxels that may count. Ground that belongs to what no mesh describes should
        be left out, or it pulls.
    effects
        Optional parts of image formation by name.
    resume
        A checkpoint written by :meth:`FitState.save` to go on from.

    Raises
    ------
    InputError
        If the image is not 3D, empty, flat or has no finite voxel, or the mesh lies outside it.
    """
    settings = settings or FitSettings()
    if accuracy is not None:
        settings = settings.model_copy(update={"accuracy": float(accuracy)})
    check_accuracy(settings.image_accuracy)
    for name in effects:
        if name not in EFFECTS:
            raise InputError(f"unknown effect '{name}': choose from {', '.join(EFFECTS)}")
    pixels, known = check_image(image, grid)
    if counted is not None:
        if counted.shape != grid.shape:
            raise InputError(f"counted has shape {counted.shape}, the image {grid.shape}")
        known = known & (np.asarray(counted) != 0)
    hot = hot_voxels(pixels, known)
    known = known & ~hot
    if known.sum() < FEWEST_VOXELS:
        raise InputError(f"only {known.sum()} voxels count; a fit needs {FEWEST_VOXELS}")
    check_mesh(mesh, grid)
    settings = _completed(settings, pixels, known)
    run = Run(pixels, known, grid, mesh, optics, settings, effects)
    if resume is not None:
        run.load(load_checkpoint(resume))
    if hot.any():
        run.remark = f"{hot.sum()} hot voxels, brighter than any PSF can make one, are left out"
    return run.states()


def _completed(settings: FitSettings, pixels: np.ndarray, known: np.ndarray) -> FitSettings:
    """The settings with what was left to the software filled in."""
    found: dict[str, Any] = {"levels": settings.levels or WIDE_LEVELS}
    if settings.smoothing is None:
        found["smoothing"] = smoothing_for(noise_ratio(pixels, known))
    if settings.accuracy is None:
        found["accuracy"] = accuracy_for_image(pixels, known)
    return settings.model_copy(update=found)
