"""The images that unknowns of a fit predict, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ...common.choices import Structure
from ...common.kept import Kept
from ...fourier.devices import for_objects, widest
from ...geometry.mesh import FloatArray, Mesh
from ...optics import Optics
from ...scene import Renderer
from ...scene.columns import Now, effect_columns, optics_columns
from ...scene.effects import DepthEffect, Effect, Effects, FaceEffect
from ...scene.light import INSIDES, MEMBRANES, Light
from ..model.amplitudes import light_of
from ..model.level import Level, Voxels
from ..model.likelihood import match
from ..model.variables import Variables
from .prior import Prior


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


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Vertices, densities, insides and PSF as tensors to differentiate by; see Variables."""

    vertices: Tensor
    density: Tensor
    insides: Tensor
    optics: Tensor


@dataclass(frozen=True, eq=False)
class _Shining:
    """What shines.

    Attributes
    ----------
    spectrum
        Of all that does, differentiable.
    light
        How much of each does.
    image
        (Z, Y, X) of the spectrum, without gradients; None where no image was needed to find the
        light.
    """

    spectrum: Tensor
    light: Light
    image: Tensor | None


def mixed(parts: Sequence[tuple[float, Tensor]]) -> Tensor:
    """Weighted sum of one or two tensors."""
    each = [part if by == 1 else by * part for by, part in parts]
    return each[0] if len(each) == 1 else each[0] + each[1]


class Prediction:
    """The images that unknowns predict; voxels, weights, connectivity and plan do not change.

    Parameters
    ----------
    level, renderer
        Where images are compared, and what renders them.
    views
        The measured images, the fit's own first.
    prior
        What is known beforehand, and how the unknowns give densities of faces, the brightness of
        insides, PSF and effects.
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
        self._level, self._renderer, self._views, self._prior = level, renderer, views, prior
        self._structure, self._density_fitted = structure, density_fitted
        self._faces_on = for_objects(level.device)
        self._seen_through = Kept[Optics](1)
        # Where gradients were last asked for: a descent that begins there asks for columns, too.
        self._shone: tuple[Variables, _Shining] | None = None

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

    def light(self, at: Variables) -> Light:
        """What shines, and how much of each, in the first image."""
        with torch.no_grad():
            unknowns = self._unknowns(at)
            renderer = self._with(self._prior.imaging.effects_of(at.effects))
            otf = self._otf(self._views[0], renderer, self._optics(unknowns))
            return self._shining(renderer, unknowns, otf).light

    def shown(self, at: Variables, light: Light) -> FloatArray:
        """(N,) the first image of a light where voxels count, of amplitude 1; no gradients."""
        with torch.no_grad():
            unknowns = self._unknowns(at)
            view, renderer = self._views[0], self._with(self._prior.imaging.effects_of(at.effects))
            spectrum = self._transform(renderer, unknowns, light)
            optics = self._optics(unknowns)
            return as_floats(view.voxels.of(self._image(view, renderer, spectrum, optics)))

    def _transform(self, renderer: Renderer, at: Unknowns, light: Light) -> Tensor:
        """Spectrum of a light, of the insides that are unknowns."""
        weights = self._prior.density.faces(at.density) if light.membrane else None
        cells = self._prior.insides.factors(at.insides) if light.interior else None
        return renderer.transform(at.vertices, weights, light, cells)

    def _optics(self, at: Unknowns) -> Optics:
        """The PSF, differentiable where gradients are asked for.

        Else the same object for the same numbers: it keeps its OTF, and makes it once.
        """
        if torch.is_grad_enabled():
            return self._prior.imaging.optics_of(at.optics)
        numbers = as_floats(at.optics)
        made = self._prior.imaging.optics_of
        return self._seen_through.get(numbers.tobytes(), lambda: made(at.optics))

    def _otf(self, view: View, renderer: Renderer, optics: Optics) -> Tensor:
        """The OTF of the view's own PSF, or of the fit's."""
        return renderer.otf(optics if view.optics is None else view.optics)

    def _shining(self, renderer: Renderer, at: Unknowns, otf: Tensor) -> _Shining:
        """What shines, and how much of each does, by the first image.

        Membranes and insides are transformed once each: what shines is a sum of the two.
        otf : of the first image, without gradient.
        """
        view = self._views[0]
        parts: dict[Light, Tensor] = {}
        images: dict[Light, Tensor] = {}
        with torch.no_grad():
            measured = self._measured(view, renderer.effects)

        def part(light: Light) -> Tensor:
            if light not in parts:
                parts[light] = self._transform(renderer, at, light)
            return parts[light]

        def shown(light: Light) -> Tensor:
            spectrum = part(light).detach()
            with torch.no_grad():
                images[light] = self._level.rendered(renderer, spectrum, otf)
            return view.voxels.of(images[light])

        light = light_of(self._structure, shown, measured, view.voxels.weights)
        both = (light.membrane, MEMBRANES), (light.interior, INSIDES)
        each = [(by, of) for by, of in both if by]
        image = mixed([(by, images[of]) for by, of in each]) if images else None
        spectrum = mixed([(by, part(of)) for by, of in each])
        return _Shining(spectrum, self._prior.insides.shining(light, as_floats(at.insides)), image)

    def images(self, at: Variables, light: Light | None = None) -> list[FloatArray]:
        """(N,) of each view: its rendering where voxels count, of amplitude 1; no gradients.

        light : what shines; by default what explains most.
        """
        with torch.no_grad():
            unknowns = self._unknowns(at)
            optics = self._optics(unknowns)
            renderer = self._with(self._prior.imaging.effects_of(at.effects))
            if light is None:
                otf = self._otf(self._views[0], renderer, optics)
                spectrum = self._shining(renderer, unknowns, otf).spectrum
            else:
                weights = self._prior.density.faces(unknowns.density)
                spectrum = renderer.transform(unknowns.vertices, weights, light)
            return self._of_every_view(renderer, spectrum, optics)

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
            unknowns = self._unknowns(at)
            optics = self._optics(unknowns)
            effects = self._prior.imaging.effects_of(at.effects)
            light = self.light(at)
            insides = light.interior != 0
            renderer = self._level.renderer(mesh, optics, effects, accuracy, insides)
            there = self._faces_on
            weights = self._prior.density.faces(unknowns.density)
            if weights is not None:
                weights = weights.repeat_interleave(len(mesh.faces) // len(weights))
            vertices = torch.from_numpy(mesh.vertices_numpy()).to(there)
            spectrum = renderer.transform(vertices, weights, light=light)
            return self._of_every_view(renderer, spectrum, optics)

    def _of_every_view(
        self, renderer: Renderer, spectrum: Tensor, optics: Optics
    ) -> list[FloatArray]:
        seen = [(view, self._image(view, renderer, spectrum, optics)) for view in self._views]
        return [as_floats(view.voxels.of(image)) for view, image in seen]

    def _image(self, view: View, renderer: Renderer, spectrum: Tensor, optics: Optics) -> Tensor:
        """(Z, Y, X) through the view's own PSF, or the fit's."""
        return self._level.rendered(renderer, spectrum, self._otf(view, renderer, optics))

    def measured(self, at: Variables) -> list[FloatArray]:
        """(N,) of each view: what was measured, without what effects add."""
        effects = self._prior.imaging.effects_of(at.effects)
        return [as_floats(self._measured(view, effects)) for view in self._views]

    def less_effects(self, at: Variables, voxels: Voxels) -> Tensor:
        """(N,) what voxels of the first image measured, without what effects add."""
        view = replace(self._views[0], voxels=voxels)
        return self._measured(view, self._prior.imaging.effects_of(at.effects))

    def _unknowns(self, at: Variables) -> Unknowns:
        there = self._faces_on

        def leaf(numbers: FloatArray, fitted: bool = True) -> Tensor:
            asked = fitted and len(numbers) > 0
            return torch.tensor(numbers, device=there, dtype=widest(there), requires_grad=asked)

        optics = torch.tensor(at.optics, requires_grad=len(at.optics) > 0)
        density = leaf(at.density, self._density_fitted)
        return Unknowns(leaf(at.vertices), density, leaf(at.insides), optics)

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

    def imaging_columns(
        self, at: Variables, rows: np.ndarray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """(N, P + E) derivatives of the first measured image by PSF and effects, and its rendering.

        The rendering (N,) is of amplitude 1. rows : of the voxels wanted, all where not given.
        """
        with torch.no_grad():
            now = self._now(at)
            columns, image = self._imaging_columns(now, at), now.image
            if rows is not None:
                wanted = torch.from_numpy(rows).to(image.device)
                columns, image = [c[wanted] for c in columns], image[wanted]
            return _stacked(columns, len(image)), as_floats(image)

    def _imaging_columns(self, now: Now, at: Variables) -> list[Tensor]:
        """(N,) each: derivatives of the first image by PSF and effects."""
        columns = optics_columns(now) if len(at.optics) else []
        return columns + self._prior.imaging.effect_columns(now)

    def psf_columns(self, at: Variables) -> FloatArray:
        """(N, P) derivatives of the first measured image by its PSF, fitted or not."""
        with torch.no_grad():
            now = self._now(at)
            return _stacked(optics_columns(now), len(now.image))

    def columns_of(self, at: Variables, effect: Effect) -> FloatArray:
        """(N, E) derivatives of the first measured image by the numbers of a further effect.

        Instead of those that pass for it. For one without numbers, the whole difference that it
        makes.
        """
        with torch.no_grad():
            now = self._now(at, effect)
            if effect.bounds:
                return _stacked(effect_columns(now, effect), len(now.image))
            without = self._with(now.effects.without(effect.name))
            spectrum = now.transform(without)
            plain = self._image(self._views[0], without, spectrum, now.optics)
            return _stacked([now.amplitude * (now.image - now.voxels.of(plain))], len(now.image))

    def pads_enough_for(self, at: Variables, effect: Effect) -> bool:
        """Whether a further effect reaches no further than images are padded for."""
        effects = _with_further(self._prior.imaging.effects_of(at.effects), effect)
        return self._renderer.pads_enough_for(effects, self._renderer.scene.optics)

    def membranes(self, at: Variables, densities: FloatArray) -> FloatArray:
        """(N,) the first image of membranes of given densities (F,), of amplitude 1."""
        with torch.no_grad():
            unknowns, view = self._unknowns(at), self._views[0]
            renderer = self._with(self._prior.imaging.effects_of(at.effects))
            weights = torch.from_numpy(densities).to(unknowns.vertices)
            spectrum = renderer.transform(unknowns.vertices, weights, MEMBRANES)
            optics = self._optics(unknowns)
            return as_floats(view.voxels.of(self._image(view, renderer, spectrum, optics)))

    def _now(self, at: Variables, further: Effect | None = None) -> Now:
        view = self._views[0]
        unknowns = self._unknowns(at)
        optics = self._optics(unknowns)
        present = self._prior.imaging.effects_of(at.effects)
        effects = present if further is None else _with_further(present, further)
        renderer = self._with(effects)
        otf = renderer.otf(optics)
        if self._shone is None or self._shone[0] is not at or _on_object(present, further):
            shining = self._shining(renderer, unknowns, otf)
        else:
            shining = self._shone[1]
            shining = shining if further is None else replace(shining, image=None)
        spectrum, light = shining.spectrum, shining.light
        image = view.voxels.of(self._level.rendered(renderer, spectrum, otf, shining.image))
        _, found = match(image, self._measured(view, effects), view.voxels.weights)
        return Now(
            self._level,
            renderer,
            optics,
            effects,
            lambda other: self._transform(other, unknowns, light),
            spectrum,
            otf,
            image,
            view.voxels,
            found.amplitude,
        )


def _with_further(effects: Effects, further: Effect) -> Effects:
    return effects.without(*further.contradicts).adding(further)


def _on_object(present: Effects, further: Effect | None) -> bool:
    """Whether a further effect changes the transforms of what shines."""
    if further is None:
        return False
    instead = any(name in present.names for name in further.contradicts)
    return instead or isinstance(further, (FaceEffect, DepthEffect))


def _stacked(columns: Sequence[Tensor], rows: int) -> FloatArray:
    each = [as_floats(column) for column in columns]
    return np.stack(each, 1) if each else np.zeros((rows, 0))


def as_floats(values: Tensor | None) -> FloatArray:
    """Values in double precision on the CPU; an empty array for None."""
    if values is None:
        return np.zeros(0)
    return values.detach().cpu().numpy().astype(np.float64)
