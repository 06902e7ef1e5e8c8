"""A quick refit: the smooth modes of the shape together with all other numbers of a scene.

A fit moves every vertex and takes seconds. What effects and shape share is smooth, so a few
Gauss-Newton steps over the modes tell what a new effect changes. They also take a fit that stopped
early the rest of the way, which the score of an effect would otherwise be mistaken for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from scipy.linalg import lu_factor, lu_solve

from ..fitting.model.likelihood import solve_scale
from .evidence_rules import REFIT
from .fitted_scene import FittedScene
from .image_model import ImageModel, parameters_of, with_changed
from .modes import ShapeModes
from .voxel_variance import Variance

# Of columns of size 1, so that those that are the same as others can be solved for. Measured: with
# a thousandth and a thousand times of it scores change by 5e-4 at most.
_RIDGE = 1e-9


@dataclass(frozen=True)
class Linearised:
    """Columns of the derivative of the expected image, times the root of the weights.

    Attributes
    ----------
    columns
        (N, K): shape modes, amplitude, background and interior, PSF, effects, density, in this
        order.
    residual
        (N,) measured minus expected, times the root of the weights.
    root
        (N,) root of the weights.
    modes, light, psf, effects, density
        How many columns there are of each.
    prior
        (K,) added to the diagonal of the normal equations.
    """

    columns: np.ndarray
    residual: np.ndarray
    root: np.ndarray
    modes: int
    light: int
    psf: int
    effects: int
    density: int
    prior: np.ndarray

    @cached_property
    def gram(self) -> np.ndarray:
        """(K, K) products of the columns."""
        found: np.ndarray = self.columns.T @ self.columns
        return found

    @cached_property
    def _factors(self) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Sizes of the columns, and the normal equations of columns of size 1, factorised."""
        scale = np.sqrt(np.diag(self.gram))
        scale[scale == 0] = 1.0
        normal = self.gram / np.outer(scale, scale) + np.diag(self.prior / scale**2 + _RIDGE)
        return scale, lu_factor(normal)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Coefficients of the columns that explain a weighted image (N,) or several (N, P) best."""
        scale, factors = self._factors
        solved: np.ndarray = lu_solve(factors, ((self.columns.T @ right).T / scale).T)
        return (solved.T / scale).T

    def left(self, right: np.ndarray) -> np.ndarray:
        """A weighted image (N,), or several (N, P), less what the columns explain of it."""
        rest: np.ndarray = right - self.columns @ self.solve(right)
        return rest

    @cached_property
    def rest(self) -> np.ndarray:
        """(N,) the residual less what the columns explain of it."""
        return self.left(self.residual)

    def without(self, own: np.ndarray, residual: np.ndarray) -> Linearised:
        """With another residual, and without some of the columns of effects."""
        kept = np.setdiff1d(np.arange(self.columns.shape[1]), own)
        found = replace(
            self,
            columns=self.columns[:, kept],
            residual=residual,
            effects=self.effects - len(own),
            prior=self.prior[kept],
        )
        found.__dict__["gram"] = self.gram[np.ix_(kept, kept)]  # what it would compute
        return found

    def with_residual(self, residual: np.ndarray) -> Linearised:
        """The same columns, with what has been computed of them."""
        found = replace(self, residual=residual)
        found.__dict__.update(gram=self.gram, _factors=self._factors)
        return found


@dataclass(frozen=True)
class _Surface:
    """Derivatives in the shape and the density, and where they were computed."""

    scene: FittedScene
    image: np.ndarray
    shape: np.ndarray
    density: np.ndarray

    def hold_for(self, scene: FittedScene, image: np.ndarray, moved: float, changed: float) -> bool:
        """Whether the surface is within some widths of the PSF, the image within a share of it."""
        apart = self.scene.mesh.vertices_numpy() - scene.mesh.vertices_numpy()
        near = float(np.sqrt((apart**2).sum(1).mean())) <= moved * min(scene.optics.sigma_um)
        by = float(np.linalg.norm(image - self.image))
        return near and by <= changed * float(np.linalg.norm(self.image))


class Refit:
    """Measured voxels with their weights, and the steps towards them.

    Parameters
    ----------
    model
        Of the expected image.
    measured
        (N,) values of the voxels that count.
    variance
        Function of the expected image (N,): variance of each voxel.
    modes
        Of the shape.
    fit_psf
        Whether the PSF's numbers are among what is fitted.
    density
        (M, F) fields that the logarithm of the density is made of, beside the amplitude.
    """

    def __init__(
        self,
        model: ImageModel,
        measured: np.ndarray,
        variance: Variance,
        modes: ShapeModes,
        fit_psf: bool,
        density: np.ndarray,
    ) -> None:
        self.model, self.measured, self.variance = model, measured, variance
        self.modes, self.fit_psf, self.density = modes, fit_psf, density
        self._held: _Surface | None = None

    def _surface_columns(self, scene: FittedScene, image: np.ndarray, fresh: bool) -> _Surface:
        """Derivatives in shape and density, by far the dearest: kept while little has changed."""
        held = self._held
        limits = REFIT.fresh if fresh else REFIT.near
        if held is None or not held.hold_for(scene, image, *limits):
            shape = self.model.shape_columns(scene, self.modes)
            density = self.model.density_columns(scene, self.density)
            self._held = held = _Surface(scene, image, shape, density)
        return held

    def linearised(self, scene: FittedScene, fresh: bool = True) -> Linearised:
        """Derivatives and residual at a scene.

        Those of the surface may be taken from nearby: for a step from further away than where they
        have to be ``fresh``, since it only has to point the right way.
        """
        rendered = self.model.rendered(scene)
        expected = self.model.measured(rendered, scene)
        root = 1 / np.sqrt(self.variance(expected))
        surface = self._surface_columns(scene, scene.amplitude * rendered, fresh)
        shape, density = surface.shape, surface.density
        psf = self.model.psf_columns(scene) if self.fit_psf else np.zeros((0, len(rendered))).T
        effects = [self.model.effect_columns(scene, e) for e, _ in parameters_of(scene.effects)]
        light = self.model.light_columns(scene, rendered)
        columns = np.concatenate([shape, light, psf, *effects, density], axis=1)
        columns *= root[:, None]
        prior = np.zeros(columns.shape[1])
        prior[: len(self.modes)] = 1 / (REFIT.prior * min(scene.optics.sigma_um)) ** 2
        prior[columns.shape[1] - density.shape[1] :] = 1 / REFIT.prior_density**2
        return Linearised(
            columns,
            (self.measured - expected) * root,
            root,
            len(self.modes),
            light.shape[1],
            psf.shape[1],
            sum(e.shape[1] for e in effects),
            density.shape[1],
            prior,
        )

    def loss(self, scene: FittedScene, root: np.ndarray) -> float:
        """Weighted sum of squares, with given roots of the weights."""
        return float((((self.measured - self.model.expected(scene)) * root) ** 2).sum())

    def step(self, scene: FittedScene, at: Linearised) -> tuple[FittedScene, float]:
        """One Gauss-Newton step; and by what share it lowers the loss."""
        whole = at.solve(at.residual)
        k = at.modes + at.light
        if at.psf:
            largest = float(np.abs(whole[k : k + at.psf]).max())
            whole = whole * min(1.0, REFIT.largest_psf / max(largest, 1e-12))
        moved = float(np.abs(np.tensordot(whole[: at.modes], self.modes.fields, axes=1)).max())
        whole = whole * min(1.0, min(scene.optics.sigma_um) / max(moved, 1e-12))
        before = float((at.residual**2).sum())
        share = 1.0
        for _ in range(REFIT.halvings):
            tried = self._moved(scene, share * whole, at)
            loss = self.loss(tried, at.root)
            if loss < before:
                return tried, 1 - loss / before
            share /= 2
        return scene, 0.0

    def _moved(self, scene: FittedScene, change: np.ndarray, at: Linearised) -> FittedScene:
        k, first = at.modes, at.modes + at.light
        vertices = self.modes.displaced(scene.mesh.vertices_numpy(), change[:k])
        optics = scene.optics
        if at.psf:
            p = optics.parameters().detach()
            optics = optics.with_parameters(p + torch.from_numpy(change[first : first + at.psf]))
        density = self._dimmed(scene, change[len(change) - at.density :])
        moved = scene.with_surface(
            scene.mesh.with_vertices(vertices), 1.0 if density is None else density
        )
        interior = scene.light.interior + float(change[k + 2 : first].sum())
        return replace(
            moved,
            optics=optics,
            effects=with_changed(scene.effects, change[first + at.psf :]),
            amplitude=scene.amplitude + float(change[k]),
            background=scene.background + float(change[k + 1]),
            light=replace(scene.light, interior=interior),
        )

    def _dimmed(self, scene: FittedScene, change: np.ndarray) -> np.ndarray | None:
        if not len(change):
            return scene.density
        held = np.ones(len(scene.mesh.faces)) if scene.density is None else scene.density
        return np.asarray(held * np.exp(np.clip(change @ self.density, -1, 1)))

    def settled(self, scene: FittedScene) -> tuple[FittedScene, Linearised]:
        """The scene after steps as long as they lower the loss, and its derivatives there."""
        at = self.linearised(scene, fresh=False)
        for _ in range(REFIT.most_steps):
            scene, gain = self.step(scene, at)
            if gain < REFIT.enough:
                break
            if gain > REFIT.little:
                at = self.linearised(scene, fresh=False)
            else:
                expected = self.model.expected(scene)
                at = at.with_residual((self.measured - expected) * at.root)
        return scene, self.linearised(scene)

    def scaled(self, scene: FittedScene) -> FittedScene:
        """The scene with the amplitude and background that suit it best."""
        rendered = self.model.rendered(scene)
        expected = self.model.measured(rendered, scene)
        added = expected - scene.amplitude * rendered - scene.background
        rest, weights = self.measured - added, 1 / self.variance(expected)
        a, b, _ = solve_scale(*(torch.from_numpy(t) for t in (rendered, rest, weights)))
        return scene.scaled(a, b)
