"""The paper's own way of fitting, to compare with: one scale, AdamUniform, plain least squares.

*Inverse 3D Microscopy Rendering for Cell Shape Inference with Active Mesh* (ICCV 2025):
vertices by AdamUniform with the gradient smoothed by ``(I + 50 L)^-2``, and the PSF by Adam. No
voxel is left out, nothing is remeshed, and there is no prior.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np
import torch

from ..errors import InputError
from ..geometry.connected import pieces
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..runs.settings import FitSettings
from ..scene import Renderer, Scene
from ..scene.effects import Effects
from .model.change import Change
from .model.likelihood import Match, match
from .model.problem import Problem
from .model.state import FitState
from .paper_optimiser import AdamUniform
from .solvers.preconditioner import Preconditioner

LAMBDA = 50.0  # the paper's
# The paper gives no sizes of steps; these find the sphere of tests/fitting/test_paper.py.
_STEP, _PSF_STEP = 0.3, 0.01  # widths of the PSF; unbounded numbers of the PSF
_PLAN_EVERY = 20  # iterations


@torch.enable_grad()  # the caller may have turned gradients off
def as_in_the_paper(
    problem: Problem, mesh: Mesh, optics: Optics, settings: FitSettings, effects: Effects
) -> Generator[FitState, Change | None, None]:
    """States of a descent that ends after ``settings.max_iterations``; takes no changes.

    Raises
    ------
    InputError
        If effects are to be fitted, or a change is sent in.
    """
    if effects.present():
        raise InputError("a fit as in the paper has no effects")
    smoother = Preconditioner(mesh, LAMBDA)
    adam = AdamUniform(pieces(mesh), 3)
    measured = torch.from_numpy(problem.image[problem.counted]).double()
    index = torch.from_numpy(np.flatnonzero(problem.counted))
    ones = torch.ones_like(measured)
    numbers = optics.detach().parameters().clone().requires_grad_(settings.fit_psf)
    psf = torch.optim.Adam([numbers], lr=_PSF_STEP)
    vertices = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    width = min(optics.sigma_um)
    renderer: Renderer | None = None
    for iteration in range(1, settings.max_iterations + 1):
        if renderer is None or iteration % _PLAN_EVERY == 0:
            now = mesh.with_vertices(vertices.detach().numpy().copy())
            renderer = Renderer(
                Scene.of(now, optics), problem.grid, settings.image_accuracy, margin=2 * width
            )
        optics = optics.with_parameters(numbers) if settings.fit_psf else optics
        image = renderer.image(renderer.transform(vertices), renderer.otf(optics))
        squares, found = match(image.reshape(-1)[index], measured, ones)
        squares.backward()
        shown = mesh.with_vertices(vertices.detach().numpy().copy())
        optics = optics.detach()
        change = yield _state(iteration, shown, optics, problem, settings, found)
        if change is not None:
            raise InputError("a fit as in the paper takes no changes while it runs")
        assert vertices.grad is not None
        with torch.no_grad():
            step = smoother.solve(adam.step(smoother.solve(vertices.grad)))
            vertices -= _STEP * width * step
            vertices.grad = None
        if settings.fit_psf:
            psf.step()
            psf.zero_grad()


def _state(
    iteration: int,
    mesh: Mesh,
    optics: Optics,
    problem: Problem,
    settings: FitSettings,
    found: Match,
) -> FitState:
    ends = iteration == settings.max_iterations
    return FitState(
        iteration=iteration,
        level=1,
        levels=1,
        mesh=mesh,
        optics=optics,
        density=np.ones(len(mesh.faces)),
        loss=found.loss,
        amplitude=found.amplitude,
        background=found.background,
        blur=1.0,
        message=f"stopped after {iteration} iterations, as in the paper" if ends else "",
        evaluations=iteration,
        grid=problem.grid,
        accuracy=settings.image_accuracy,
    )
