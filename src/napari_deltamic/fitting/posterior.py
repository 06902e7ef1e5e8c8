"""What a fit makes least: minus the log posterior of shape, densities, PSF and effects, in nats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..common.choices import Structure
from ..fourier.devices import for_objects, widest
from ..geometry.bending import BendingEnergy
from ..geometry.junction_bending import JunctionBending
from ..geometry.mesh import FloatArray, Mesh
from ..optics import Optics
from ..scene import Renderer
from ..scene.columns import Now, effect_columns, optics_columns
from ..scene.effects import Effect, Effects
from ..scene.light import Light
from .amplitudes import light_of
from .density import Density
from .imaging import Imaging
from .lbfgs import dot
from .level import Level, Voxels
from .likelihood import Match, explained, match, total
from .variables import Variables


@dataclass(frozen=True)
class View:
    """One image of the scene.

    Attributes
    ----------
    voxels
        Those that count.
    variance
        Of a residual times the root of its weight, times the number of voxels that one independent
        voxel stands for; see :func:`~.tempering.tempered_variance`.
    independent
        Share of its voxels that are independent.
    optics
        Its PSF; None: that of the fit.
    """

    voxels: Voxels
    variance: float
    independent: float
    optics: Optics | None = None


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


class Posterior:
    """The objective; voxels, weights, variances, connectivity and plan do not change.

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
        self._level, self._renderer, self._views = level, renderer, views
        self._structure = structure
        self._prior, self._density_fitted = prior, density_fitted
        self._imaging = prior.imaging
        self._faces_on = for_objects(level.device)

    def __call__(self, at: Variables) -> Evaluation:
        """Value and gradient."""
        vertices, density, optics_numbers = self._leaves(at)
        optics = self._imaging.optics_of(optics_numbers)
        effects = self._imaging.effects_of(at.effects)
        renderer = self._with(effects)
        weights = self._prior.density.faces(density)
        light = self._light(renderer, at, optics, effects)
        spectrum = renderer.transform(vertices, weights, light)
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
            _array(vertices.grad),
            # None where membranes do not shine.
            np.zeros_like(at.density) if density.grad is None else _array(density.grad),
            _array(optics_numbers.grad),
            by_effects,
        )
        value, gradient = self._with_priors(float(nats.detach()), gradient, at)
        return Evaluation(value, gradient, told, first[0].detach(), light)

    def light(self, at: Variables) -> Light:
        """What shines, and how much of each, in the first image."""
        optics = self._imaging.optics_of(torch.tensor(at.optics))
        effects = self._imaging.effects_of(at.effects)
        return self._light(self._with(effects), at, optics, effects)

    def shown(self, at: Variables, light: Light) -> FloatArray:
        """(N,) the first image of a light where voxels count, of amplitude 1; no gradients."""
        with torch.no_grad():
            vertices, density, numbers = self._leaves(at)
            view, renderer = self._views[0], self._with(self._imaging.effects_of(at.effects))
            spectrum = renderer.transform(vertices, self._prior.density.faces(density), light)
            optics = view.optics or self._imaging.optics_of(numbers)
            image = self._level.rendered(renderer, spectrum, renderer.otf(optics))
            return _array(view.voxels.of(image))

    def _light(self, renderer: Renderer, at: Variables, optics: Optics, effects: Effects) -> Light:
        view = self._views[0]

        def shown(light: Light) -> Tensor:
            vertices, density, _ = self._leaves(at)
            spectrum = renderer.transform(vertices, self._prior.density.faces(density), light)
            otf = renderer.otf(optics if view.optics is None else view.optics)
            return view.voxels.of(self._level.rendered(renderer, spectrum, otf))

        with torch.no_grad():
            measured = self._measured(view, effects)
            return light_of(self._structure, shown, measured, view.voxels.weights)

    @property
    def views(self) -> tuple[View, ...]:
        """The measured images, the fit's own first."""
        return tuple(self._views)

    @property
    def prior(self) -> Prior:
        """What is known beforehand."""
        return self._prior

    @property
    def level(self) -> Level:
        """Where images are compared."""
        return self._level

    def images(self, at: Variables) -> list[FloatArray]:
        """(N,) of each view: its rendering where voxels count, of amplitude 1; no gradients."""
        with torch.no_grad():
            vertices, density, numbers = self._leaves(at)
            optics = self._imaging.optics_of(numbers)
            effects = self._imaging.effects_of(at.effects)
            renderer = self._with(effects)
            light = self._light(renderer, at, optics, effects)
            spectrum = renderer.transform(vertices, self._prior.density.faces(density), light)
            found = []
            for view in self._views:
                otf = renderer.otf(optics if view.optics is None else view.optics)
                image = self._level.rendered(renderer, spectrum, otf)
                found.append(_array(view.voxels.of(image)))
            return found

    def images_of(self, mesh: Mesh, at: Variables, accuracy: float) -> list[FloatArray]:
        """(N,) of each view: the rendering of a finer surface, of amplitude 1.

        Parameters
        ----------
        mesh
            Each face in the place of one of the fit's, or several in a row, all of its density.
        at
            Densities, PSF and effects.
        accuracy
            Of the images.
        """
        with torch.no_grad():
            _, density, numbers = self._leaves(at)
            optics = self._imaging.optics_of(numbers)
            effects = self._imaging.effects_of(at.effects)
            light = self._light(self._with(effects), at, optics, effects)
            insides = light.interior != 0
            renderer = self._level.renderer(mesh, optics, effects, accuracy, insides)
            there = self._faces_on
            weights = self._prior.density.faces(density)
            if weights is not None:
                weights = weights.repeat_interleave(len(mesh.faces) // len(weights))
            vertices = torch.from_numpy(mesh.vertices_numpy()).to(there)
            spectrum = renderer.transform(vertices, weights, light=light)
            found = []
            for view in self._views:
                otf = renderer.otf(optics if view.optics is None else view.optics)
                found.append(_array(view.voxels.of(self._level.rendered(renderer, spectrum, otf))))
            return found

    def measured(self, at: Variables) -> list[FloatArray]:
        """(N,) of each view: what was measured, without what effects add."""
        effects = self._imaging.effects_of(at.effects)
        return [_array(self._measured(view, effects)) for view in self._views]

    def _leaves(self, at: Variables) -> tuple[Tensor, Tensor, Tensor]:
        there = self._faces_on
        vertices = torch.tensor(at.vertices, device=there, dtype=widest(there), requires_grad=True)
        density = torch.tensor(
            at.density,
            device=there,
            dtype=widest(there),
            requires_grad=self._density_fitted and len(at.density) > 0,
        )
        return vertices, density, torch.tensor(at.optics, requires_grad=len(at.optics) > 0)

    def _with(self, effects: Effects) -> Renderer:
        if effects == self._renderer.effects:
            return self._renderer
        return self._renderer.with_effects(effects)

    def _measured(self, view: View, effects: Effects) -> Tensor:
        """What was measured, without what effects add to the first image."""
        measured = view.voxels.measured
        added = self._level.offset(effects) if view.optics is None else None
        if added is None:
            return measured
        return measured - added.reshape(-1)[view.voxels.index].to(measured.dtype)

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
        root = np.sqrt(_array(view.voxels.weights))
        columns, image = self.imaging_columns(at)
        # Of norm 1: the brightness of a rendering depends on the unit of length.
        own = np.stack([c / np.sqrt(max(dot(c, c), 1e-300)) for c in (image * root, root)], 1)
        jacobian = columns * root[:, None]
        mixed = _products(own, jacobian)
        free = _products(jacobian, jacobian) - mixed.T @ np.linalg.pinv(_products(own, own)) @ mixed
        return free / view.variance + self._imaging.prior_curvature()

    def imaging_columns(self, at: Variables) -> tuple[FloatArray, FloatArray]:
        """(N, P + E) derivatives of the first measured image by PSF and effects, and its rendering.

        The rendering (N,) is of amplitude 1.
        """
        with torch.no_grad():
            now = self._now(at)
            columns = optics_columns(now) if len(at.optics) else []
            for effect in self._imaging.fitted:
                columns += effect_columns(now, getattr(now.effects, effect.name))
            return _stacked(columns, len(now.image)), _array(now.image)

    def psf_columns(self, at: Variables) -> FloatArray:
        """(N, P) derivatives of the first measured image by its PSF, fitted or not."""
        with torch.no_grad():
            now = self._now(at)
            return _stacked(optics_columns(now), len(now.image))

    def columns_of(self, at: Variables, effect: Effect) -> FloatArray:
        """(N, E) derivatives of the first measured image by the numbers of a further effect.

        None for one that reaches further than images are padded for.
        """
        effects = self._imaging.effects_of(at.effects).adding(effect)
        if not self._renderer.pads_enough_for(effects, self._imaging.optics):
            return np.zeros((len(self._views[0].voxels.index), 0))
        with torch.no_grad():
            now = self._now(at, effect)
            return _stacked(effect_columns(now, effect), len(now.image))

    def _now(self, at: Variables, further: Effect | None = None) -> Now:
        view = self._views[0]
        vertices, density, numbers = self._leaves(at)
        optics, effects = self._imaging.optics_of(numbers), self._imaging.effects_of(at.effects)
        effects = effects if further is None else effects.adding(further)
        renderer = self._with(effects)
        weights = self._prior.density.faces(density)
        light = self._light(renderer, at, optics, effects)
        spectrum, otf = renderer.transform(vertices, weights, light), renderer.otf(optics)
        image = view.voxels.of(self._level.rendered(renderer, spectrum, otf))
        _, found = match(image, self._measured(view, effects), view.voxels.weights)
        return Now(
            self._level,
            renderer,
            optics,
            effects,
            lambda other: other.transform(vertices, weights, light),
            spectrum,
            otf,
            image,
            view.voxels,
            found.amplitude,
        )


def _stacked(columns: Sequence[Tensor], rows: int) -> FloatArray:
    each = [_array(column) for column in columns]
    return np.stack(each, 1) if each else np.zeros((rows, 0))


def _array(gradient: Tensor | None) -> FloatArray:
    if gradient is None:
        return np.zeros(0)
    return gradient.detach().cpu().numpy().astype(np.float64)


def _products(one: FloatArray, other: FloatArray) -> FloatArray:
    """(i, j) of columns (N, i) and (N, j), to the same bits on every number of threads."""
    return np.array([[dot(a, b) for b in other.T] for a in one.T])
