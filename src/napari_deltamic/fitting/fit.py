"""The fit: a generator that moves vertices, densities and PSF until the rendered image agrees."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..common.accuracy_bounds import check_accuracy
from ..errors import InputError
from ..fourier.devices import choose_device
from ..geometry.mesh import Mesh
from ..geometry.topology.crossings import crosses
from ..geometry.topology.untangling import untangled
from ..geometry.windings import right_side_out
from ..optics import Optics
from ..runs.settings import WIDE_LEVELS, FitSettings
from ..scene import Grid
from ..scene.effects import Effects, as_effects
from .model.change import Change
from .model.checks import check_mesh, check_psf
from .model.default_accuracy import accuracy_for_image
from .model.hot_voxels import hot_told
from .model.problem import Problem
from .model.second_view import Pixels
from .model.state import FitState, load_checkpoint
from .paper import as_in_the_paper
from .run import Run
from .successor import resumed


def fit(
    image: np.ndarray | Tensor,
    grid: Grid,
    mesh: Mesh,
    optics: Optics,
    accuracy: float | None = None,
    *,
    settings: FitSettings | None = None,
    counted: np.ndarray | None = None,
    effects: Effects | Sequence[str] = (),
    second: np.ndarray | None = None,
    resume: str | Path | None = None,
    counted_may_change: bool = False,
    psf_guessed: bool = False,
) -> Generator[FitState, Change | None, None]:
    """Fit a mesh to an image; yields a state after every iteration and ends by itself.

    What a user changes meanwhile is sent in: ``states.send(Change(vertices=...))`` does the next
    iteration from there, also after the last state.

    Parameters
    ----------
    image
        (Z, Y, X) measured intensities; NaN, or the mask of a masked array, marks missing voxels.
    grid
        Where the voxels lie.
    mesh
        Where to start; closed surfaces near the membranes, um.
    optics
        The PSF; held, unless the settings say to fit it. A Gaussian that is fitted gives way to a
        :class:`ScalarPSF` or a :class:`ConfocalPSF` where the image shows the light cone of an
        objective.
    accuracy
        Overrides that of the settings.
    settings
        Everything else; see :class:`napari_deltamic.runs.fit_settings.FitSettings`.
    counted
        (Z, Y, X) bool: voxels that may count. Voxels of objects that no mesh describes should be
        left out, or they attract the mesh; their light is estimated, and what the PSF spreads from
        them into the others is subtracted. To leave voxels out for another reason, set them to
        NaN.
    effects
        Optional parts of image formation, or their names, which stand for their defaults. Their
        numbers are fitted together with the PSF unless they say ``fit=False``.
    second
        (Z, Y, X) second image of the same scene, where the effects hold a second view; by default
        that of its file.
    resume
        A checkpoint written by :meth:`FitState.save` to go on from.
    counted_may_change
        Whether voxels that were left out may count where, at its end, much of a surface lies in
        them and they are as near as its own (:mod:`.ground_again`).
    psf_guessed
        Whether the PSF is a guess, so that its width does not speak against insides in place of the
        membranes of small cells.

    Raises
    ------
    InputError
        If the image is not 3D, empty, flat or has no finite voxel, the mesh lies outside it, or
        the device of the settings cannot be used; within ``torch.inference_mode()``.
    """
    if torch.is_inference_mode_enabled():
        raise InputError("a fit needs gradients: leave torch.inference_mode() first")
    settings = settings or FitSettings()
    if accuracy is not None:
        settings = settings.model_copy(update={"accuracy": float(accuracy)})
    check_accuracy(settings.image_accuracy)
    choose_device(settings.device)  # one that cannot be used is told now
    effects = as_effects(effects)
    problem = Problem.of(image, grid, counted)
    mesh = right_side_out(mesh)
    check_mesh(mesh, grid)
    check_psf(optics, grid)
    settings = _completed(settings, problem.image, problem.counted)
    if settings.as_in_the_paper:
        return as_in_the_paper(problem, mesh, optics, settings, effects)
    mesh, repairs = _apart(mesh, settings)
    if effects.view is not None:
        view = Pixels(second, grid, effects.view)
        if counted is not None:
            view.restricted(counted)
        problem = replace(problem, second=view)
    problem.counted_with(effects)  # refuses what leaves too few
    if counted_may_change and problem.second is None:
        problem = replace(problem, anew=0)
    problem = replace(problem, psf_guessed=psf_guessed)
    run = Run(problem, mesh, optics, settings, effects)
    if resume is not None:
        run = resumed(run, load_checkpoint(resume))
    run.say(*repairs)
    if problem.hot:
        run.say(hot_told(problem.hot))
    return _states(run)


# Also where the caller has turned gradients off, which a fit cannot do without.
@torch.enable_grad()
def _states(run: Run) -> Generator[FitState, Change | None, None]:
    """The states of the run and of the runs that follow it.

    Where a GPU is too small for a run, the CPU takes over and says so.
    """
    following: Run | None = run
    while following is not None:
        run = following
        try:
            following = yield from run.states()
        except torch.OutOfMemoryError:
            if not run.leave_device():
                raise
            run.say("the GPU has too little memory: the fit continues on the CPU")


def _apart(mesh: Mesh, settings: FitSettings) -> tuple[Mesh, tuple[str, ...]]:
    """The mesh without surfaces that cross, where that can be repaired, and what was done."""
    if not (settings.topology and settings.collisions and crosses(mesh)):
        return mesh, ()
    try:
        done = untangled(mesh)
    except InputError:
        return mesh, ()  # the guard tells which surfaces cross
    return done.mesh, done.events


def _completed(settings: FitSettings, pixels: np.ndarray, known: np.ndarray) -> FitSettings:
    """The settings with what was left to the software filled in."""
    found: dict[str, Any] = {"levels": settings.levels or WIDE_LEVELS}
    if settings.accuracy is None:
        found["accuracy"] = accuracy_for_image(pixels, known)
    return settings.model_copy(update=found)
