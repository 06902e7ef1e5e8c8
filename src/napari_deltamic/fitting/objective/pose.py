"""Pose the objective anew: which voxels count, how they are weighted, and how much they say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...common.choices import Structure
from ...common.triple import geometric_mean
from ...geometry.bending import BendingEnergy
from ...geometry.cell_bending import CellBending
from ...geometry.junction_bending import JunctionBending
from ...scene.light import MEMBRANES, Light
from ..model.amplitudes import inside_over_membrane
from ..model.density import Density
from ..model.imaging import Imaging
from ..model.level import Level, Voxels
from ..model.shape import Shape
from ..model.unequal_insides import RULES as UNEQUAL
from ..model.unequal_insides import Insides
from ..model.variables import Variables
from ..solvers.preconditioner import Preconditioner
from .look import Look
from .posed import Posed, squares_left
from .posterior import Posterior
from .prediction import View
from .prior import Prior

# Share of its voxels by which a surface may have left those that are held: with more, the image
# would no longer be judged where the surface is.
_LEFT = 0.05
# Steps to the brightness of insides at the start, before the shape follows what they differ by: of
# cells side by side, each is off by less than a hundredth then.
_ROUNDS = 5
# Of the peak of a membrane's blurred image: insides that are darker are not computed at a blurred
# level until the objective is posed anew. Measured in cells without light inside: 0.1 and 0.2 at
# the second level, less than 0.02 from the third on, which then took half of their time.
_HARDLY = 0.05


def pose(
    levels: tuple[Level, Level | None],
    shape: Shape,
    density: Density,
    imaging: Imaging,
    density_fitted: bool,
    tempered: bool,
    held: Sequence[View] = (),
    structure: Structure = "membrane",
    shone: Light = MEMBRANES,
    dimmed: NDArray[np.float32] | None = None,
) -> Posed:
    """The objective at a level, from where the surface is now.

    Parameters
    ----------
    levels
        That of the first image, and that of the second.
    shape, density, imaging
        As they are now.
    density_fitted
        Whether densities are unknowns. A smooth one of which nothing is known begins with the
        brightness of the image where the surface lies.
    tempered
        Whether residuals are taken to be as correlated as they are; while the shape is still far
        off they are correlated because of that.
    held
        Views of the objective before, where voxels, weights and variances stay what they are: as
        long as the surface has not left them.
    structure
        What may shine.
    shone
        What shone before: insides are as bright as they were. Where it says nothing of them, they
        begin with what the image says.
    dimmed
        (Z, Y, X) by dark nuclei, see :class:`~.fitted.Fitted`.
    """
    level, second = levels
    known = shape.log_density
    log = np.zeros(len(density)) if known is None else density.centred(known)
    insides = Insides.of(shape.mesh, density.model, structure, level.factor > 1)
    volumes = np.array(list(shape.mesh.volumes().values()))
    cells = insides.numbers(shone, volumes)
    at = Variables(shape.mesh.vertices_numpy(), log, cells, *imaging.numbers())
    renderer = level.renderer(
        shape.mesh, imaging.optics, imaging.effects, insides=structure != "membrane"
    )
    look = Look(level, renderer, density, insides, imaging, structure, shape.mesh, dimmed)
    voxels, light = look.voxels(at)
    widths = level.factor * np.asarray(imaging.optics.sigma_um)
    shining = inside_over_membrane(light, widths)
    if level.factor > 1 and shining < _HARDLY:
        structure, light = "membrane", MEMBRANES
    if insides.held and not shone.cells and shining < UNEQUAL.at_blurred:
        insides, at = insides.alike(), replace(at, insides=np.zeros(0))
        look = replace(look, insides=insides)
    if held and _left_out(voxels, held[0].voxels, level.grid.shape) > _LEFT:
        held = ()
    voxels = held[0].voxels if held else voxels
    rendered = look.rendered(at, light)
    begins = density_fitted and shape.log_density is None and density.model == "smooth"
    if begins and light.membrane:
        smoother = Preconditioner(shape.mesh, level.smoothing)
        at = look.with_density(voxels, at, light, rendered, smoother)
        rendered = look.rendered(at, light)
    stiffness = level.settings.bending
    width = geometric_mean(imaging.optics.sigma_um)
    walls = CellBending(shape.mesh) if structure == "interior" else BendingEnergy(shape.mesh, width)
    junctions = JunctionBending(shape.mesh, width)

    def posterior_of(insides: Insides, views: Sequence[View]) -> Posterior:
        prior = Prior(walls, junctions, stiffness, density, insides, imaging)
        return Posterior(level, renderer, views, prior, density_fitted, structure)

    views, whole = list(held), voxels
    if held:
        found = look.found(voxels, rendered)
    else:
        whole = look.completed(voxels, rendered)
        # Before they are evened, or what cells differ by is taken for unevenness. As cut insides
        # are found to be brighter, the others are less bright beside them.
        if len(insides) and (whole.full is not None or not shone.cells):
            told = look.view(whole, rendered, look.found(whole, rendered), tempered)
            at = _with_insides(posterior_of(replace(insides, held=False), [told]), at)
            rendered = look.rendered(at, light)
            whole = look.completed(voxels, rendered)
        plain, voxels = voxels, whole
        if level.factor == 1 and density.model != "uniform" and shone.interior > 0:
            voxels = look.evened(
                voxels, at, light, rendered, look.found(whole, rendered), plain.weights
            )
        found = look.found(voxels, rendered)
        views = [look.view(voxels, rendered, found, tempered)]
        if second is not None:
            views.append(look.second_view(second, at, light, tempered))
    variance = views[0].variance
    posterior = posterior_of(insides, views)
    firmness = look.firmness(voxels, rendered, found, light) / variance
    left = squares_left(found, voxels)
    return Posed(posterior, at, renderer, variance, left, bool(held), firmness, whole)


def _with_insides(posterior: Posterior, at: Variables) -> Variables:
    """The same with insides as bright as the image says; the shape is held."""
    for _ in range(_ROUNDS):
        now = posterior(at)
        step = now.gradient.insides / posterior.insides_curvature(at, now)
        at = replace(at, insides=posterior.prior.insides.bounded(at.insides - step))
    return at


def _left_out(now: Voxels, before: Voxels, shape: tuple[int, int, int]) -> float:
    """Share of voxels that would count now, but did not before."""
    known = torch.zeros(int(np.prod(shape)), dtype=torch.bool, device=before.index.device)
    known[before.index] = True
    return 1 - float(known[now.index].double().mean())
