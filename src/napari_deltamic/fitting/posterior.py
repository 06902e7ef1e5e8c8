"""What a fit makes least: minus the log posterior of shape, densities, PSF and effects, in nats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..common.choices import Structure
from ..geometry.bending import BendingEnergy
from ..geometry.junction_bending import JunctionBending
from ..geometry.mesh import FloatArray
from ..optics import Optics
from ..scene import Renderer
from ..scene.columns import Now, effect_columns
from ..scene.effects import Effects
from ..scene.light import Light
from .density import Density
from .imaging import Imaging
from .lbfgs import dot
from .level import Level
from .likelihood import Match, explained, total
from .prediction import Prediction, View, as_floats
from .variables import Variables


@dataclass(frozen=True)
class Prior:
    """What is known beforehand.

    Attributes
    ----------
    bending, junctions
        The bending energies of the surface and of the lines where walls meet.
    stiffness
        Their weight, a pure number.
    density
        The densities and their prior.
    imaging
        PSF and effects, and theirs.
    """

    bending: BendingEnergy
    junctions: JunctionBending
    stiffness: float
    density: Density
    imaging: Imaging


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
    """The objective: how well what is predicted fits what was measured, and what is known.

    Parameters
    ----------
    level, renderer
        Where images are compared, and what renders them.
    views
        The measured images, the fit's own first.
    prior
        See :class:`Prior`.
    density_fitted
        Whether the densities are unknowns, or held.
    structure
        What may shine; how much of each is solved for at every evaluation.
    """

    def __init__(
        self,
        level: Level,
        renderer: Renderer,
        views: Sequence[View],
        prior: Prior,
        density_fitted: bool,
        structure: Structure = "membrane",
    ) -> None:
        given = prior.density, prior.imaging, density_fitted, structure
        super().__init__(level, renderer, views, *given)
        self._prior = prior

    def __call__(self, at: Variables) -> Evaluation:
        """Value and gradient."""
        vertices, density, optics_numbers = self._leaves(at)
        optics = self._imaging.optics_of(optics_numbers)
        effects = self._imaging.effects_of(at.effects)
        renderer = self._with(effects)
        weights = self._prior.density.faces(density)
        spectrum, light = self._shining(renderer, vertices, weights, optics)
        nats, told, first = torch.zeros(()), None, None
        for view in self._views:
            otf = renderer.otf(optics if view.optics is None else view.optics)
            image = self._level.rendered(renderer, spectrum, otf)
            voxels = view.voxels
            measured = self._measured(view, effects)
            squares, found = explained(image, voxels.index, measured, voxels.weights)
            nats = nats.to(squares) + squares / (2 * view.variance)
            if told is None:
                told, first = found, (image, otf)
        assert told is not None
        assert first is not None
        nats.backward()
        held = weights.detach() if weights is not None else None
        given = effects, optics, vertices.detach(), held, light
        by_effects = self._by_effects(*given, spectrum, first, told)
        gradient = Variables(
            as_floats(vertices.grad),
            # None where membranes do not shine.
            np.zeros_like(at.density) if density.grad is None else as_floats(density.grad),
            as_floats(optics_numbers.grad),
            by_effects,
        )
        value, gradient = self._with_priors(float(nats.detach()), gradient, at)
        return Evaluation(value, gradient, told, first[0].detach(), light)

    @property
    def prior(self) -> Prior:
        """What is known beforehand."""
        return self._prior

    def _by_effects(
        self,
        effects: Effects,
        optics: Optics,
        vertices: Tensor,
        density: Tensor | None,
        light: Light,
        spectrum: Tensor,
        first: tuple[Tensor, Tensor],
        found: Match,
    ) -> FloatArray:
        """(E,) derivatives by the numbers of effects: their columns times the residuals."""
        if not self._imaging.fitted:
            return np.zeros(0)
        with torch.no_grad():
            view = self._views[0]
            image, otf = (t.detach() for t in first)
            values = view.voxels.of(image)
            measured = self._measured(view, effects)
            pull = (found.amplitude * values + found.background - measured) * view.voxels.weights
            now = Now(
                self._level,
                self._with(effects),
                optics.detach(),
                effects,
                lambda other: other.transform(vertices, density, light),
                spectrum.detach(),
                otf,
                values,
                view.voxels,
                found.amplitude,
            )
            columns = [c for e in effects.fitted() for c in effect_columns(now, e)]
            dots = [float(total(c.to(pull) * pull)) for c in columns]
        return np.array(dots) / view.variance

    def _with_priors(
        self, nats: float, by_image: Variables, at: Variables
    ) -> tuple[float, Variables]:
        bend, by_vertices = self._prior.bending(at.vertices)
        turn, by_lines = self._prior.junctions(at.vertices)
        kappa = self._prior.stiffness
        rough, by_density = self._prior.density.prior(at.density, self._views[0].independent)
        known, by_optics, by_effects = self._imaging.prior(at.optics, at.effects)
        if not self._density_fitted:
            by_density = np.zeros_like(by_density)
        gradient = Variables(
            by_image.vertices + kappa * (by_vertices + by_lines),
            by_image.density + by_density,
            by_image.optics + by_optics,
            by_image.effects + by_effects,
        )
        return nats + kappa * (bend + turn) + rough + known, gradient

    def imaging_curvature(self, at: Variables) -> FloatArray:
        """(P + E, P + E) Gauss-Newton second derivatives by PSF and effects.

        Amplitude and background follow; the shape is held.
        """
        if len(at.optics) + len(at.effects) == 0:
            return np.zeros((0, 0))
        view = self._views[0]
        root = np.sqrt(as_floats(view.voxels.weights))
        columns, image = self.imaging_columns(at)
        # Of norm 1: the brightness of a rendering depends on the unit of length.
        own = np.stack([c / np.sqrt(max(dot(c, c), 1e-300)) for c in (image * root, root)], 1)
        jacobian = columns * root[:, None]
        mixed = _products(own, jacobian)
        free = _products(jacobian, jacobian) - mixed.T @ np.linalg.pinv(_products(own, own)) @ mixed
        return free / view.variance + self._imaging.prior_curvature()


def _products(one: FloatArray, other: FloatArray) -> FloatArray:
    """(i, j) of columns (N, i) and (N, j), to the same bits on every number of threads."""
    return np.array([[dot(a, b) for b in other.T] for a in one.T])
