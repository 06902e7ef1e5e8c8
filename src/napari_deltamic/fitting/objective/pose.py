"""Pose the objective anew: which voxels count, how they are weighted, and how much they say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ...common.triple import geometric_mean
from ...geometry.bending import BendingEnergy
from ...geometry.cell_bending import CellBending
from ...geometry.junction_bending import JunctionBending
from ...scene.light import MEMBRANES, Light
from ..model.amplitudes import inside_over_membrane
from ..model.density import Density
from ..model.fitted import Fitted
from ..model.imaging import Imaging
from ..model.level import Level, Voxels
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


@dataclass(frozen=True)
class _Stand:
    """Where an objective is posed: what was looked at there, and what shines."""

    look: Look
    at: Variables
    light: Light
    voxels: Voxels

    def rendered(self) -> Tensor:
        """(Z, Y, X) of that light."""
        return self.look.rendered(self.at, self.light)


def pose(
    levels: tuple[Level, Level | None],
    fitted: Fitted,
    density: Density,
    imaging: Imaging,
    density_fitted: bool,
    tempered: bool,
    held: Sequence[View] = (),
) -> Posed:
    """The objective at a level, from where the surface is now.

    Parameters
    ----------
    levels
        That of the first image, and that of the second.
    fitted
        As it is now: insides are as bright as they were. Where nothing is known of them, they
        begin with what the image says.
    density, imaging
        How unknowns give its densities, PSF and effects.
    density_fitted
        Whether densities are unknowns. A smooth one of which nothing is known begins with the
        brightness of the image where the surface lies.
    tempered
        Whether residuals are taken to be as correlated as they are; while the shape is still far
        off they are correlated because of that.
    held
        Views of the objective before, where voxels, weights and variances stay what they are: as
        long as the surface has not left them.
    """
    level, second = levels
    stand = _begun(level, fitted, density, imaging)
    if held and _left_out(stand.voxels, held[0].voxels, level.grid.shape) > _LEFT:
        held = ()
    if held:
        stand = replace(stand, voxels=held[0].voxels)
    if density_fitted and fitted.shape.log_density is None:
        stand = _with_density(stand)
    prior = _prior(stand, fitted, density)

    def posterior_of(views: Sequence[View], prior: Prior) -> Posterior:
        look = stand.look
        return Posterior(level, look.renderer, views, prior, density_fitted, look.structure)

    views, whole = list(held), stand.voxels
    if not held:
        whole = stand.look.completed(stand.voxels, stand.rendered())
        # Before they are evened, or what cells differ by is taken for unevenness. As cut insides
        # are found to be brighter, the others are less bright beside them.
        if len(prior.insides) and (whole.full is not None or not fitted.light.cells):
            told = _view(stand, whole, tempered)
            free = replace(prior, insides=replace(prior.insides, held=False))
            stand = replace(stand, at=_with_insides(posterior_of([told], free), stand.at))
            whole = stand.look.completed(stand.voxels, stand.rendered())
        views = [_view(stand, _evened(stand, whole, fitted), tempered)]
        if second is not None:
            views.append(stand.look.second_view(second, stand.at, stand.light, tempered))
    look, rendered, voxels = stand.look, stand.rendered(), views[0].voxels
    found, variance = look.found(voxels, rendered), views[0].variance
    firmness = look.firmness(voxels, rendered, found, stand.light) / variance
    left = squares_left(found, voxels)
    posterior = posterior_of(views, prior)
    return Posed(posterior, stand.at, look.renderer, variance, left, bool(held), firmness, whole)


def _begun(level: Level, fitted: Fitted, density: Density, imaging: Imaging) -> _Stand:
    """Find the voxels that count, and what shines."""
    shape, structure, shone = fitted.shape, fitted.structure, fitted.light
    known = shape.log_density
    log = np.zeros(len(density)) if known is None else density.centred(known)
    insides = Insides.of(shape.mesh, density.model, structure, level.factor > 1)
    volumes = np.array(list(shape.mesh.volumes().values()))
    cells = insides.numbers(shone, volumes)
    at = Variables(shape.mesh.vertices_numpy(), log, cells, *imaging.numbers())
    renderer = level.renderer(
        shape.mesh, imaging.optics, imaging.effects, insides=structure != "membrane"
    )
    look = Look(level, renderer, density, insides, imaging, structure, shape.mesh, fitted.dimmed)
    voxels, light = look.voxels(at)
    shining = inside_over_membrane(light, level.factor * np.asarray(imaging.optics.sigma_um))
    if insides.held and not shone.cells and shining < UNEQUAL.at_blurred:
        at, look = replace(at, insides=np.zeros(0)), replace(look, insides=insides.alike())
    if level.factor > 1 and shining < _HARDLY:
        light, look = MEMBRANES, replace(look, structure="membrane")
    return _Stand(look, at, light, voxels)


def _with_density(stand: _Stand) -> _Stand:
    """The same with a smooth density, as bright as the image where the surface lies."""
    look, light = stand.look, stand.light
    if look.density.model != "smooth" or not light.membrane:
        return stand
    smoother = Preconditioner(look.mesh, look.level.smoothing)
    at = look.with_density(stand.voxels, stand.at, light, stand.rendered(), smoother)
    return replace(stand, at=at)


def _prior(stand: _Stand, fitted: Fitted, density: Density) -> Prior:
    look, mesh = stand.look, fitted.mesh
    width = geometric_mean(look.imaging.optics.sigma_um)
    alone = look.structure == "interior"
    walls = CellBending(mesh) if alone else BendingEnergy(mesh, width)
    junctions = JunctionBending(mesh, width)
    stiffness = look.level.settings.bending
    return Prior(walls, junctions, stiffness, density, look.insides, look.imaging)


def _view(stand: _Stand, voxels: Voxels, tempered: bool) -> View:
    rendered = stand.rendered()
    return stand.look.view(voxels, rendered, stand.look.found(voxels, rendered), tempered)


def _evened(stand: _Stand, whole: Voxels, fitted: Fitted) -> Voxels:
    """The voxels, corrected for uneven insides."""
    look, rendered = stand.look, stand.rendered()
    if look.level.factor != 1 or look.density.model == "uniform" or fitted.light.interior <= 0:
        return whole
    found, plain = look.found(whole, rendered), stand.voxels.weights
    return look.evened(whole, stand.at, stand.light, rendered, found, plain)


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
