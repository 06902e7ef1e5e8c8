"""A quick refit: the smooth modes of the shape together with all other numbers of a scene.

A fit moves every vertex and takes seconds. What effects and shape share is smooth, so a few
Gauss-Newton steps over the modes tell what a new effect changes. They also take a fit that stopped
early the rest of the way, which the score of an effect would otherwise be mistaken for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from ..likelihood import solve_scale
from .model import ImageModel, Scene, parameters_of, with_changed
from .modes import ShapeModes
from .noise import Variance

_LARGEST_PSF = 0.15  # of one step, in the PSF's own numbers
_PRIOR = 2.0  # widths of the PSF: standard deviation of what a mode may be
_PRIOR_DENSITY = 1.0  # of the logarithm
_HALVINGS = 4
_MOST_STEPS = 6
_ENOUGH = 2e-5  # of the loss: steps that gain less are the last
_STALE = 0.15  # widths of the PSF: beyond it derivatives in the shape are computed anew


@dataclass(frozen=True)
class Linearised:
    """Columns of the derivative of the expected image, times the root of the weights.

    Attributes
    ----------
    columns
        (N, K): shape modes, amplitude, background, PSF, effects, density, in this order.
    residual
        (N,) measured minus expected, times the root of the weights.
    root
        (N,) root of the weights.
    modes, psf, effects, density
        How many columns there are of each.
    prior
        (K,) added to the diagonal of the normal equations.
    """

    columns: np.ndarray
    residual: np.ndarray
    root: np.ndarray
    modes: int
    psf: int
    effects: int
    density: int
    prior: np.ndarray

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Coefficients of the columns that explain a weighted image (N,) or several (N, P) best."""
        scale = np.linalg.norm(self.columns, axis=0)
        scale[scale == 0] = 1.0
        a = self.columns / scale
        normal = a.T @ a + np.diag(self.prior / scale**2 + 1e-9)
        solved: np.ndarray = np.linalg.solve(normal, a.T @ right)
        return (solved.T / scale).T

    def left(self, right: np.ndarray) -> np.ndarray:
        """A weighted image (N,), or several (N, P), less what the columns explain of it."""
        rest: np.ndarray = right - self.columns @ self.solve(right)
        return rest


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

    def _surface_columns(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        return (
            self.model.shape_columns(scene, self.modes),
            self.model.density_columns(scene, self.density),
        )

    def linearised(
        self, scene: Scene, surface: tuple[np.ndarray, np.ndarray] | None = None
    ) -> Linearised:
        """Derivatives and residual at a scene; those of the surface may be taken from nearby."""
        rendered = self.model.rendered(scene)
        expected = self.model.measured(rendered, scene)
        root = 1 / np.sqrt(self.variance(expected))
        shape, density = surface or self._surface_columns(scene)
        psf = self.model.psf_columns(scene) if self.fit_psf else np.zeros((len(rendered), 0))
        effects = [self.model.effect_columns(scene, e) for e, _ in parameters_of(scene.effects)]
        others = [rendered[:, None], np.ones((len(rendered), 1)), psf, *effects, density]
        columns = np.concatenate([shape, *others], axis=1)
        columns *= root[:, None]
        prior = np.zeros(columns.shape[1])
        prior[: len(self.modes)] = 1 / (_PRIOR * min(scene.optics.sigma_um)) ** 2
        prior[columns.shape[1] - density.shape[1] :] = 1 / _PRIOR_DENSITY**2
        return Linearised(
            columns,
            (self.measured - expected) * root,
            root,
            len(self.modes),
            psf.shape[1],
            sum(e.shape[1] for e in effects),
            density.shape[1],
            prior,
        )

    def loss(self, scene: Scene, root: np.ndarray) -> float:
        """Weighted sum of squares, with given roots of the weights."""
        return float((((self.measured - self.model.expected(scene)) * root) ** 2).sum())

    def step(self, scene: Scene, at: Linearised) -> tuple[Scene, float]:
        """One Gauss-Newton step; and by what share it lowers the loss."""
        whole = at.solve(at.residual)
        k = at.modes + 2
        if at.psf:
            largest = float(np.abs(whole[k : k + at.psf]).max())
            whole = whole * min(1.0, _LARGEST_PSF / max(largest, 1e-12))
        moved = float(np.abs(np.tensordot(whole[: at.modes], self.modes.fields, axes=1)).max())
        whole = whole * min(1.0, min(scene.optics.sigma_um) / max(moved, 1e-12))
        before = float((at.residual**2).sum())
        share = 1.0
        for _ in range(_HALVINGS):
            tried = self._moved(scene, share * whole, at)
            loss = self.loss(tried, at.root)
            if loss < before:
                return tried, 1 - loss / before
            share /= 2
        return scene, 0.0

    def _moved(self, scene: Scene, change: np.ndarray, at: Linearised) -> Scene:
        k = at.modes
        vertices = self.modes.displaced(scene.mesh.vertices_numpy(), change[:k])
        optics = scene.optics
        if at.psf:
            p = optics.parameters().detach()
            optics = optics.with_parameters(p + torch.from_numpy(change[k + 2 : k + 2 + at.psf]))
        return replace(
            scene,
            mesh=scene.mesh.with_vertices(vertices),
            optics=optics,
            effects=with_changed(scene.effects, change[k + 2 + at.psf :]),
            density=self._dimmed(scene, change[len(change) - at.density :]),
            amplitude=scene.amplitude + float(change[k]),
            background=scene.background + float(change[k + 1]),
        )

    def _dimmed(self, scene: Scene, change: np.ndarray) -> np.ndarray | None:
        if not len(change):
            return scene.density
        held = np.ones(len(scene.mesh.faces)) if scene.density is None else scene.density
        return np.asarray(held * np.exp(np.clip(change @ self.density, -1, 1)))

    def settled(self, scene: Scene) -> tuple[Scene, Linearised]:
        """The scene after steps as long as they lower the loss, and its derivatives there.

        Derivatives in the shape are by far the dearest. They are kept while the surface stays
        within a share of the PSF's width: a step only has to point the right way.
        """
        surface = self._surface_columns(scene)
        at = self.linearised(scene, surface)
        for _ in range(_MOST_STEPS):
            before = scene
            scene, gain = self.step(scene, at)
            if gain == 0:
                break
            if self._apart(before, scene) > _STALE * min(scene.optics.sigma_um):
                surface = self._surface_columns(scene)
            at = self.linearised(scene, surface)
            if gain < _ENOUGH:
                break
        return scene, at

    @staticmethod
    def _apart(one: Scene, other: Scene) -> float:
        apart = one.mesh.vertices_numpy() - other.mesh.vertices_numpy()
        return float(np.sqrt((apart**2).sum(1).mean()))

    def scaled(self, scene: Scene) -> Scene:
        """The scene with the amplitude and background that suit it best."""
        rendered = self.model.rendered(scene)
        expected = self.model.measured(rendered, scene)
        added = expected - scene.amplitude * rendered - scene.background
        rest, weights = self.measured - added, 1 / self.variance(expected)
        a, b, _ = solve_scale(*(torch.from_numpy(t) for t in (rendered, rest, weights)))
        return replace(scene, amplitude=a, background=b)
