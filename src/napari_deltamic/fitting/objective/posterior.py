"""What a fit makes least: minus the log posterior of shape, densities, PSF and effects, in nats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ...geometry.mesh import FloatArray
from ...scene.light import INSIDES, Light
from ..model.imaging import Imaging
from ..model.level import Voxels
from ..model.likelihood import Match, explained, products, total
from ..model.variables import Variables
from .prediction import Prediction, as_floats

_PIECE = 2**18  # voxels of which products are made at a time; chosen, a few megabytes


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The objective at one place.

    Attributes
    ----------
    value
        Nats.
    gradient
        By each unknown.
    match
        Of the first image.
    rendered
        (Z, Y, X) the first image, of amplitude 1 and without background.
    light
        What shines in it.
    """

    value: float
    gradient: Variables
    match: Match
    rendered: Tensor
    light: Light


class Posterior(Prediction):
    """The objective: how well what is predicted fits what was measured, and what is known."""

    def with_measured(self, measured: Tensor) -> Posterior:
        """The same with another first image, (N,) where voxels count; weights stay."""
        return self.with_voxels(replace(self._views[0].voxels, measured=measured))

    def with_imaging(self, imaging: Imaging) -> Posterior:
        """The same with another PSF and other effects, for which its images are planned."""
        prior = replace(self._prior, imaging=imaging)
        return Posterior(
            self._level, self._renderer, self._views, prior, self._density_fitted, self._structure
        )

    def with_voxels(self, voxels: Voxels) -> Posterior:
        """The same with other voxels of the first image that count."""
        first, *others = self._views
        views = [replace(first, voxels=voxels), *others]
        return Posterior(
            self._level, self._renderer, views, self._prior, self._density_fitted, self._structure
        )

    def __call__(self, at: Variables) -> Evaluation:
        """Value and gradient."""
        self._shone = None  # before what follows takes the most memory
        unknowns = self._unknowns(at)
        optics = self._optics(unknowns)
        effects = self._prior.imaging.effects_of(at.effects)
        renderer = self._with(effects)
        otfs = [self._otf(view, renderer, optics) for view in self._views]
        shining = self._shining(renderer, unknowns, otfs[0].detach())
        spectrum, light = shining.spectrum, shining.light
        nats, told, first = torch.zeros(()), None, None
        for view, otf in zip(self._views, otfs, strict=True):
            known = shining.image if view is self._views[0] else None
            image = self._level.rendered(renderer, spectrum, otf, known)
            voxels = view.voxels
            measured = self._measured(view, effects)
            weights = voxels.weights_for(voxels.of(image.detach()), measured)
            squares, found = explained(image, voxels.index, measured, weights)
            nats = nats.to(squares) + squares / (2 * view.variance)
            if told is None:
                told, first = found, image
        assert told is not None
        assert first is not None
        nats.backward()
        self._shone = at, replace(shining, spectrum=spectrum.detach(), image=first.detach())
        # None where membranes or insides do not shine.
        by_density, by_insides = (
            np.zeros_like(own) if leaf.grad is None else as_floats(leaf.grad)
            for own, leaf in ((at.density, unknowns.density), (at.insides, unknowns.insides))
        )
        gradient = Variables(
            as_floats(unknowns.vertices.grad),
            by_density,
            by_insides,
            as_floats(unknowns.optics.grad),
            self._by_effects(at, told),
        )
        value, gradient = self._with_priors(float(nats.detach()), gradient, at)
        return Evaluation(value, gradient, told, first.detach(), light)

    def _by_effects(self, at: Variables, found: Match) -> FloatArray:
        """(E,) derivatives by the numbers of effects: their columns times the residuals."""
        if not (self._prior.imaging.fitted and len(at.effects)):
            return np.zeros(0)
        with torch.no_grad():
            view, now = self._views[0], self._now(at)
            measured = self._measured(view, now.effects)
            weights = view.voxels.weights_for(now.image, measured)
            pull = (found.amplitude * now.image + found.background - measured) * weights
            return self._prior.imaging.effect_sums(now, view.voxels, pull) / view.variance

    def _with_priors(
        self, nats: float, by_image: Variables, at: Variables
    ) -> tuple[float, Variables]:
        prior = self._prior
        bend, by_vertices = prior.bending(at.vertices)
        turn, by_lines = prior.junctions(at.vertices)
        kappa = prior.stiffness
        rough, by_density = prior.density.prior(at.density, self._views[0].independent)
        known, by_optics, by_effects = prior.imaging.prior(at.optics, at.effects)
        unequal, by_insides = prior.insides.prior(at.insides)
        if not self._density_fitted:
            by_density = np.zeros_like(by_density)
        by_insides = by_image.insides + by_insides
        if prior.insides.held:
            by_insides = np.zeros_like(by_insides)
        gradient = Variables(
            by_image.vertices + kappa * (by_vertices + by_lines),
            by_image.density + by_density,
            by_insides,
            by_image.optics + by_optics,
            by_image.effects + by_effects,
        )
        return nats + kappa * (bend + turn) + rough + unequal + known, gradient

    def insides_curvature(self, at: Variables, now: Evaluation) -> FloatArray:
        """(R,) at least the Gauss-Newton second derivatives by the brightness of insides.

        Of all together: with images of insides that are not negative, no combination of them is
        stiffer than the sums of the rows of their products. now : the evaluation there.
        """
        if not len(at.insides):
            return np.zeros(0)
        unknowns, view = self._unknowns(at), self._views[0]
        renderer = self._with(self._prior.imaging.effects_of(at.effects))
        with torch.no_grad():
            optics = self._optics(unknowns)
        alike = torch.ones_like(unknowns.insides, requires_grad=True)
        spectrum = renderer.transform(unknowns.vertices.detach(), None, INSIDES, alike)
        shown = view.voxels.of(self._image(view, renderer, spectrum, optics))
        (total(view.voxels.weights * shown * shown) / 2).backward()
        bright = now.match.amplitude * now.light.interior
        rows = np.maximum(as_floats(alike.grad), 0.0)
        return bright**2 / view.variance * rows + self._prior.insides.prior_curvature(at.insides)

    def imaging_curvature(self, at: Variables) -> FloatArray:
        """(P + E, P + E) Gauss-Newton second derivatives by PSF and effects.

        Amplitude and background follow; the shape is held.
        """
        if len(at.optics) + len(at.effects) == 0:
            return np.zeros((0, 0))
        view = self._views[0]
        with torch.no_grad():
            now = self._now(at)
            columns = self._imaging_columns(now, at)
            rows = [now.image, torch.ones_like(now.image[:1]).expand(len(now.image)), *columns]
            found = _products(view.voxels.weights, rows)
        # Of norm 1: the brightness of a rendering depends on the unit of length.
        scale = np.sqrt(np.maximum(np.diag(found), 1e-300))
        scale[2:] = 1.0
        found = found / scale / scale[:, None]
        own, mixed, free = found[:2, :2], found[:2, 2:], found[2:, 2:]
        free = free - mixed.T @ np.linalg.pinv(own) @ mixed
        return free / view.variance + self._prior.imaging.prior_curvature()


def _products(weights: Tensor, rows: Sequence[Tensor]) -> FloatArray:
    """(i, i) weighted products of rows (N,).

    Piece by piece: in large images, copies of all rows in double precision are gigabytes.
    """
    found = np.zeros((len(rows), len(rows)))
    for first in range(0, len(weights), _PIECE):
        piece = slice(first, first + _PIECE)
        found += products([row[piece] for row in rows], weights[piece])
    return found
