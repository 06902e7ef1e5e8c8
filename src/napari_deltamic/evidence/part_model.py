"""The objective of a fit on the part of its image that is judged: derivatives, further steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ..fitting.model.imaging import Imaging
from ..fitting.model.shape import Shape
from ..fitting.model.state import FitState
from ..fitting.model.variables import Variables
from ..fitting.objective.descent import Descent
from ..fitting.objective.limits import Limits
from ..fitting.objective.metric import Metric
from ..fitting.objective.posed import Posed
from ..fitting.objective.posterior import Evaluation, Posterior
from ..fitting.objective.prediction import as_floats
from ..fitting.uncertainty.curvature import following_insides
from ..fitting.uncertainty.errors_of_measures import posed_at
from ..geometry.mesh import FloatArray, IntArray
from ..runs.settings import FitSettings
from ..scene import Grid
from ..scene.effects import Effect, Effects, ViewEffect, VoxelEffect
from .crop import Crop
from .evidence_rules import JUDGING, REFIT
from .linearised import Linearised
from .modes import density_fields, shape_modes
from .voxel_variance import Variance

# Step for finite differences of shape, over the PSF's width. Measured: with five times as much,
# some predicted biases are 1.6 times as large, since modes that hardly differ then seem to.
_MOVE = 0.004


@dataclass(frozen=True, eq=False)
class Settled:
    """The end of steps of a fit.

    Attributes
    ----------
    state
        State of the part.
    posterior, at, now
        The objective on the voxels that are evidence, its variables, and its value there.
    linearised
        The derivatives of the image there.
    """

    state: FitState
    posterior: Posterior
    at: Variables
    now: Evaluation
    linearised: Linearised

    @property
    def imaging(self) -> Imaging:
        """PSF and effects."""
        return self.posterior.prior.imaging

    def columns(self, effect: Effect) -> FloatArray:
        """(N, P) derivatives of the image by an effect's numbers; see ``Posterior.columns_of``."""
        return self.posterior.columns_of(self.at, effect)

    def own_columns(self, effect: Effect) -> IntArray:
        """Indices of an effect's columns in ``linearised``; empty if the effect is not fitted."""
        first = self.linearised.columns.shape[1] - len(self.at.effects)
        for other in self.imaging.fitted:
            n = len(other.parameters())
            if other.name == effect.name:
                return np.arange(first, first + n)
            first += n
        return np.zeros(0, int)


@dataclass(frozen=True, eq=False)
class _Surface:
    """Columns of the surface, by far the most expensive ones, and where they were computed."""

    at: Variables
    now: Evaluation
    columns: list[FloatArray]

    def near(self, at: Variables, now: Evaluation, width: float) -> bool:
        """Whether surface and image are nearly the same there, so that the columns still hold."""
        moved, changed = REFIT.same
        apart = at.vertices - self.at.vertices
        image, before = (e.match.amplitude * e.rendered for e in (now, self.now))
        near = float(np.sqrt((apart**2).sum(1).mean())) <= moved * width
        return near and float((image - before).norm()) <= changed * float(before.norm())


class PartModel:
    """A fit's own objective on a part of the image.

    Parameters
    ----------
    part
        The part of the image.
    image, frame
        (Z, Y, X) the whole image without NaN, and its grid.
    variance
        Variance of voxels as a function of the expected image.
    settings
        Settings of the fit.
    """

    def __init__(
        self,
        part: Crop,
        image: np.ndarray,
        frame: Grid,
        variance: Variance,
        settings: FitSettings,
    ) -> None:
        self._part, self._frame, self._variance = part, frame, variance
        self._image = image[part.box]
        self._settings = settings.model_copy(update={"accuracy": JUDGING.accuracy})
        self.modes = shape_modes(part.mesh, part.cells)
        self._fields = density_fields(part.mesh, settings.density, part.cells)
        free = part.mesh.faces[np.isin(part.mesh.regions, part.cells).any(1)]
        self._held = np.ones(len(part.mesh.vertices), bool)
        self._held[free] = False
        self._held_for: _Surface | None = None
        self.density_fitted = len(self._fields) > 0
        self._counted = np.zeros(part.grid.shape, bool)
        self._counted.reshape(-1)[part.index] = True

    def begun(self, state: FitState) -> Settled:
        """Continue the fit of the part from a state."""
        self._posed = posed = self._pose(state)
        shape = Shape.begun(state.mesh, self._settings.density).with_pins(self._held)
        self._metric = Metric.at_end(posed, shape, self._settings, density_fitted=True)
        now = posed.posterior(posed.at)
        posterior = self._of_voxels(posed.posterior, posed.at, now, self._part.index)
        return self._settled(state, posterior, posed.at)

    def with_effects(self, before: Settled, effects: Effects, moved: FloatArray) -> Settled:
        """Continue with other effects, after moving the shape by ``moved``, (K,) of its modes."""
        vertices = self.modes.displaced(np.zeros_like(before.at.vertices), moved)
        # Moves are limited to a width of the PSF: beyond that the image is not linear.
        far = float(np.abs(vertices).max()) / before.posterior.level.width
        vertices = before.at.vertices + vertices / max(far, 1.0)
        own = _of_part(effects)
        imaging = replace(before.imaging, optics=before.state.optics, effects=own)
        optics, numbers = imaging.numbers()
        at = replace(before.at, vertices=vertices, optics=optics, effects=numbers)
        state = replace(before.state, effects=effects)
        return self._settled(state, before.posterior.with_imaging(imaging), at)

    def _settled(self, state: FitState, posterior: Posterior, at: Variables) -> Settled:
        width = posterior.level.width
        limits = Limits(at.vertices, width, posterior.prior.imaging)
        descent = Descent(posterior, at, self._metric, width, limits)
        for _ in range(REFIT.most_steps):
            before = descent.now.value
            if not descent.step() or before - descent.now.value < REFIT.enough:
                break
        state, at, now = _at_end(state, descent, posterior), descent.at, descent.now
        if not self._holds_for(state):
            return self.begun(state)
        return Settled(state, posterior, at, now, self._linearised(posterior, at, now))

    def _holds_for(self, state: FitState) -> bool:
        """Whether rendered images have enough padding and resolution for the PSF and effects."""
        renderer = self._posed.renderer
        planned = renderer.scene.optics
        sharp = np.greater_equal(state.optics.width(), planned.width()).all()
        padded = renderer.pads_enough_for(_of_part(state.effects), planned)
        return bool(sharp) and padded

    def with_voxels(self, settled: Settled, index: IntArray) -> Linearised:
        """The linearisation with further voxels, (N,) flat indices into the part, at its end."""
        at, now = settled.at, settled.now
        posterior = self._of_voxels(settled.posterior, at, now, index)
        residual, root = self._residual(posterior, at, now)
        own = self._on_surface(posterior, at, now) + _solved_for(posterior, at, now)
        columns = root[:, None] * np.stack(own, 1)
        return settled.linearised.with_voxels(columns, residual * root)

    def density_columns(self, settled: Settled, fields: FloatArray) -> FloatArray:
        """(N, M) derivatives of the image by fields (M, F) of the logarithm of the density."""
        found = _dimmed(settled.posterior, settled.at, settled.now, fields)
        return np.stack(found, 1)

    def _pose(self, state: FitState) -> Posed:
        one = replace(state, effects=_of_part(state.effects), dimmed=None)
        given = self._image, self._part.grid, one, self._settings, self._counted
        return posed_at(*given, frame=self._frame, density_fitted=True)

    def _of_voxels(
        self, posterior: Posterior, at: Variables, now: Evaluation, index: IntArray
    ) -> Posterior:
        """The objective on other voxels: evidence lies further from surfaces than a fit looks."""
        which = torch.from_numpy(index).to(posterior.level.device)
        effects = posterior.prior.imaging.effects_of(at.effects)
        return posterior.with_voxels(posterior.level.weighted(which, now.rendered, effects))

    def _residual(
        self, posterior: Posterior, at: Variables, now: Evaluation
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) measured minus expected, and the root of the weights."""
        voxels = posterior.views[0].voxels
        shown = now.match.amplitude * as_floats(voxels.of(now.rendered)) + now.match.background
        residual = posterior.measured(at)[0] - shown
        return residual, 1 / np.sqrt(self._variance(as_floats(voxels.measured) - residual))

    def _on_surface(self, posterior: Posterior, at: Variables, now: Evaluation) -> list[FloatArray]:
        """Derivatives, (N,) each, by the shape modes and the fields of the density."""
        shown = _Shown(posterior, self._part.mesh.faces, now)
        before, which, columns = np.zeros(0), np.zeros(0, bool), list[FloatArray]()
        for field in self.modes.fields:
            h = _MOVE * posterior.level.width / max(float(np.abs(field).max()), 1e-12)
            moves = (field != 0).any(1)
            if not np.array_equal(moves, which):  # several modes move the same vertices
                before, which = shown(at, moves), moves
            there = replace(at, vertices=at.vertices + h * field)
            columns.append(now.match.amplitude / h * (shown(there, moves) - before))
        return columns + _dimmed(posterior, at, now, self._fields)

    def _linearised(self, posterior: Posterior, at: Variables, now: Evaluation) -> Linearised:
        residual, root = self._residual(posterior, at, now)
        if self._held_for is None or not self._held_for.near(at, now, posterior.level.width):
            self._held_for = _Surface(at, now, self._on_surface(posterior, at, now))
        columns = self._held_for.columns + _solved_for(posterior, at, now)
        free, modes = len(columns), len(self.modes)
        columns += list(posterior.imaging_columns(at)[0].T)
        firm = np.zeros(free)
        firm[:modes] = 1 / (REFIT.prior * posterior.level.width) ** 2
        firm[modes : modes + len(self._fields)] = 1 / REFIT.prior_density**2
        prior = block_diag(np.diag(firm), posterior.prior.imaging.prior_curvature())
        weighted = (np.array(columns) * root).T
        return Linearised(weighted, residual * root, root, modes, prior)


@dataclass(frozen=True, eq=False)
class _Shown:
    """The image, (N,) with amplitude 1, as far as it changes when some vertices (V,) move.

    With membranes alone, only faces that move are rendered. faces : (F, 3).
    """

    posterior: Posterior
    faces: IntArray
    now: Evaluation

    def __call__(self, at: Variables, moves: NDArray[np.bool_]) -> FloatArray:
        light, posterior = self.now.light, self.posterior
        if light.interior:
            return posterior.images(at, light)[0]
        own = light.membrane * posterior.prior.density.faces_numpy(at.density)
        return posterior.membranes(at, own * moves[self.faces].any(1))


def _of_part(effects: Effects) -> Effects:
    """The effects without a second view and without those that leave out voxels, except detectors.

    Which voxels tell nothing is already decided for the whole image.
    """
    detector = effects.detector
    effects = effects.in_role(ViewEffect, None).in_role(VoxelEffect, None)
    return effects if detector is None else effects.adding(detector)


def _solved_for(posterior: Posterior, at: Variables, now: Evaluation) -> list[FloatArray]:
    """Derivatives, (N,) each, by amplitude, background, and brightness of insides."""
    image = as_floats(posterior.views[0].voxels.of(now.rendered))
    alone = [posterior.images(at, one)[0] for one in following_insides(now.light)]
    return [image, np.ones(len(image)), *alone]


def _dimmed(
    posterior: Posterior, at: Variables, now: Evaluation, fields: FloatArray
) -> list[FloatArray]:
    """Derivatives, (N,) each, by relative changes of the brightness of membranes (M, F)."""
    own = posterior.prior.density.faces_numpy(at.density)
    by = now.match.amplitude * now.light.membrane
    return [posterior.membranes(at, by * own * field) for field in fields]


def _at_end(state: FitState, descent: Descent, posterior: Posterior) -> FitState:
    at, now, known = descent.at, descent.now, posterior.prior
    effects = known.imaging.effects_of(at.effects)
    return replace(
        state,
        mesh=state.mesh.with_vertices(at.vertices),
        density=known.density.faces_numpy(at.density),
        optics=known.imaging.optics_of(torch.from_numpy(at.optics)).detach(),
        effects=state.effects.adding(*effects.present()),
        light=now.light,
        amplitude=now.match.amplitude,
        background=now.match.background,
    )
