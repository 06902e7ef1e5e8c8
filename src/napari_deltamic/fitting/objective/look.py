"""What a fit looks at before its objective is posed: images of the surface as it is."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...common.choices import Structure
from ...common.kept import Kept
from ...common.triple import geometric_mean
from ...fourier.devices import for_objects
from ...geometry.mesh import Mesh
from ...scene import Renderer
from ...scene.effects import Effects
from ...scene.light import INSIDES, MEMBRANES, Light
from ..model.amplitudes import all_flat, inside_over_membrane, light_of
from ..model.density import Density
from ..model.imaging import Imaging
from ..model.level import Level, Voxels, differences
from ..model.likelihood import Match, explained, total
from ..model.saturation import censored
from ..model.tempering import tempered_variance
from ..model.unequal_insides import Insides
from ..model.variables import Variables
from ..solvers.preconditioner import Preconditioner
from ..voxels.foreign_light import foreign_light
from .evening import RULES as EVENING
from .evening import Image, unevenness
from .prediction import View, as_floats, mixed

# Rounds to the brightness that cut voxels tell while the shape stays, at most, and when it is
# found, of itself. Chosen: each round is a Newton step, and few take more than ten.
_BRIGHTER, _ALIKE = 20, 1e-3


@dataclass(frozen=True)
class Look:
    """Images of the surface as it is, without gradients."""

    level: Level
    renderer: Renderer
    density: Density
    insides: Insides
    imaging: Imaging
    structure: Structure
    mesh: Mesh
    dimmed: NDArray[np.float32] | None = None
    _parts: Kept[Tensor] = field(default_factory=lambda: Kept(2), repr=False)

    def rendered(
        self,
        at: Variables,
        light: Light,
        effects: Effects | None = None,
        level: Level | None = None,
    ) -> Tensor:
        """(Z, Y, X) with the effects as they are now, or others.

        Membranes and insides are rendered once each: a light is a sum of the two.
        """
        if effects is not None or level is not None:
            return self._made(at, light, effects, level or self.level)

        def part(one: Light) -> Tensor:
            key = at, self.insides, one
            return self._parts.get(key, lambda: self._made(at, one, None, self.level))

        both = (light.membrane, MEMBRANES), (light.interior, INSIDES)
        return mixed([(by, part(one)) for by, one in both if by])

    def _made(self, at: Variables, light: Light, effects: Effects | None, level: Level) -> Tensor:
        imaging = self.imaging
        renderer = self.renderer if effects is None else self.renderer.with_effects(effects)
        there = for_objects(level.device)
        with torch.no_grad():
            vertices = torch.from_numpy(at.vertices.copy()).to(there)
            weights = self.density.faces(torch.from_numpy(at.density).to(there))
            cells = self.insides.factors(torch.from_numpy(at.insides).to(there))
            spectrum = renderer.transform(vertices, weights, light, cells)
            otf = renderer.otf(level.optics or imaging.optics)
            return level.rendered(renderer, spectrum, otf)

    def voxels(
        self, at: Variables, light: Light | None = None, level: Level | None = None
    ) -> tuple[Voxels, Light]:
        """The voxels that count, and what shines, unless it is given."""
        membranes = self.rendered(at, MEMBRANES, level=level)

        def plain(effects: Effects) -> Tensor:
            return self.rendered(at, MEMBRANES, effects, level)

        def image(one: Light) -> Tensor:
            return membranes if one == MEMBRANES else self.rendered(at, one, level=level)

        here = level or self.level
        width = max((here.optics or self.imaging.optics).sigma_um)
        index = here.near(membranes, self.imaging.effects, plain, width)
        flat = here.target.reshape(-1)[index]
        voxels = Voxels(index, flat, torch.ones_like(flat))

        def shown(one: Light) -> Tensor:
            return voxels.of(image(one))

        measured = self._measured(voxels, here)
        light = light or light_of(self.structure, shown, measured, voxels.weights)
        return here.weighted(index, image(light), self.imaging.effects), light

    def _measured(self, voxels: Voxels, level: Level) -> Tensor:
        added = level.offset(self.imaging.effects)
        if added is None:
            return voxels.measured
        return voxels.measured - added.reshape(-1)[voxels.index].to(voxels.measured.dtype)

    def found(self, voxels: Voxels, rendered: Tensor, level: Level | None = None) -> Match:
        """How well the image is explained."""
        measured = self._measured(voxels, level or self.level)
        return explained(rendered, voxels.index, measured, voxels.weights)[1]

    def view(
        self,
        voxels: Voxels,
        rendered: Tensor,
        found: Match,
        tempered: bool,
        level: Level | None = None,
    ) -> View:
        """The image; the variance of its residuals is not less than that of what is left out."""
        level = level or self.level
        measured = self._measured(voxels, level)
        root = torch.sqrt(voxels.weights)
        signal = found.amplitude * voxels.of(rendered)
        residual = as_floats((measured - signal - found.background) * root)
        least = level.accuracy**2 * float(np.mean(as_floats(signal * root) ** 2))
        alone = max(float(np.mean(residual**2)), least, 1e-300)
        optics = None if level is self.level else level.optics
        if not tempered:
            return View(voxels, alone, 1.0, optics)
        widths = level.factor * np.asarray(self.imaging.optics.sigma_um)
        widths = widths / np.asarray(level.grid.voxel_size)
        index = voxels.index.cpu().numpy()
        variance = tempered_variance(residual, index, level.grid.shape, tuple(widths), alone)
        return View(voxels, variance, alone / variance, optics)

    def with_density(
        self,
        voxels: Voxels,
        at: Variables,
        light: Light,
        rendered: Tensor,
        smoother: Preconditioner,
    ) -> Variables:
        """Unknowns whose density is the brightness of the image where the surface lies."""
        found = self.found(voxels, rendered)
        inside = self.rendered(at, replace(light, membrane=0.0)) if light.interior else None
        ratio = self.level.brightness(at.vertices, rendered, found, self.imaging.effects, inside)
        return replace(at, density=self.density.estimate(ratio, smoother))

    def evened(
        self,
        voxels: Voxels,
        at: Variables,
        light: Light,
        rendered: Tensor,
        found: Match,
        given: Tensor,
    ) -> Voxels:
        """Voxels corrected for insides that are uneven in the image but even in the model.

        rendered : (Z, Y, X) of that light. given : (N,) weights before cut voxels were completed.
        """
        level, seen = self.level, inside_over_membrane(light, self.imaging.optics.sigma_um)
        if light.interior <= 0 or seen < EVENING.inside or not found.amplitude > 0:
            return voxels
        volume = float(np.prod(level.grid.voxel_size)) * level.volume_ratio
        alone = rendered if not light.membrane else self.rendered(at, replace(light, membrane=0.0))
        shown, share = found.amplitude * _single(alone), _single(alone) / light.interior
        if at.insides.any():
            alike = replace(at, insides=np.zeros_like(at.insides))
            share = _single(self.rendered(alike, INSIDES))
        share = share / volume
        model = found.amplitude * _single(rendered) + found.background
        insides = self._likely(voxels, model, given) - (model - shown)
        widths = np.asarray(self.imaging.optics.sigma_um) / np.asarray(level.grid.voxel_size)
        noise = _single(differences(torch.from_numpy(insides - shown)))
        counted = level.counted.cpu().numpy()
        flat = all_flat(self.mesh, self.imaging.start)
        shown = shown if self.dimmed is None else self.dimmed * shown
        uneven = unevenness(insides, shown, share, noise, widths, counted, flat)
        if uneven is None and self.dimmed is None:
            return voxels
        even = np.float32(1) if uneven is None else uneven.gain
        told = even if self.dimmed is None else self.dimmed * even
        index = voxels.index.cpu().numpy()
        gain, own = (torch.from_numpy(i.reshape(-1)[index]) for i in (told, insides))
        gain, own = gain.to(voxels.weights), own.to(voxels.weights)
        evened = voxels.measured + own * (1 / gain - 1)
        weights = voxels.weights * gain**2
        # Beside a membrane that is off, dim insides look uneven; of cut ones, that is a guess.
        if uneven is not None and seen > EVENING.trusted and voxels.full is None:
            bright, left = (i.reshape(-1)[index] for i in (shown, noise))
            trusted = uneven.weights(as_floats(weights), bright, left / _single(gain))
            weights = torch.from_numpy(trusted).to(weights)
        return replace(voxels, measured=evened, weights=weights)

    def _likely(self, voxels: Voxels, model: Image, given: Tensor) -> Image:
        """(Z, Y, X) measured, less what effects add; of cut voxels, the mean of what may have been.

        model : (Z, Y, X). given : as for :meth:`evened`.
        """
        level = self.level
        added = level.offset(self.imaging.effects)
        image = _single(level.target if added is None else level.target - added)
        if voxels.full is None:
            return image
        image, index = image.copy(), voxels.index.cpu().numpy()
        expected, measured = model.reshape(-1)[index], as_floats(self._measured(voxels, level))
        share = as_floats(voxels.weights) / np.maximum(as_floats(given), 1e-300)
        image.reshape(-1)[index] = expected + share * (measured - expected)
        return image

    def completed(self, voxels: Voxels, rendered: Tensor) -> Voxels:
        """Voxels corrected for saturation and for the light of other objects."""
        voxels = self._uncut(voxels, rendered)
        level, found = self.level, self.found(voxels, rendered)
        # How bright saturated cells are is a guess, and so is the residual around them: when the
        # halo of such nuclei was taken for other objects, they ended 0.47 voxel off, not 0.30.
        if level.foreign is None or voxels.full is not None:
            return voxels
        added = level.offset(self.imaging.effects)
        image = level.target if added is None else level.target - added.to(level.target)
        own = (found.amplitude * rendered.to(image)).cpu().numpy()
        widths = np.asarray(self.imaging.optics.sigma_um) / np.asarray(level.grid.voxel_size)
        left = image.cpu().numpy() - own - found.background
        light = foreign_light(left, own, level.foreign, level.counted.cpu().numpy(), widths)
        if light is None:
            return voxels
        here = torch.from_numpy(light).to(voxels.measured)
        return replace(voxels, measured=voxels.measured - here.reshape(-1)[voxels.index])

    def _uncut(self, voxels: Voxels, rendered: Tensor) -> Voxels:
        """Voxels corrected for saturation (:mod:`.saturation`)."""
        cut, given = self.level.cut, voxels
        if cut is None or not bool((voxels.measured >= cut).any()):
            return voxels
        found = self.found(voxels, rendered)
        for _ in range(_BRIGHTER):
            ended = found
            voxels = self._censored(given, rendered, found, cut)
            found = self.found(voxels, rendered)
            if abs(found.amplitude - ended.amplitude) < _ALIKE * abs(ended.amplitude):
                break
        return voxels

    def _censored(self, voxels: Voxels, rendered: Tensor, found: Match, cut: float) -> Voxels:
        """Values and weights of cut voxels, of an image as bright as was found."""
        added = self.level.offset(self.imaging.effects)
        light = found.amplitude * as_floats(voxels.of(rendered)) + found.background
        if added is not None:
            light += as_floats(added.reshape(-1)[voxels.index])
        measured, weights = as_floats(voxels.measured), as_floats(voxels.weights)
        full = measured >= cut
        if full.all():
            return voxels
        squares = weights[~full] * (measured - light)[~full] ** 2
        spread = np.sqrt(squares.mean() / np.maximum(weights[full], 1e-300))
        measured[full], factor = censored(light[full], spread, cut)
        weights[full] *= factor
        return Voxels(
            voxels.index,
            torch.from_numpy(measured).to(voxels.measured),
            torch.from_numpy(weights).to(voxels.weights),
            torch.from_numpy(full).to(voxels.index.device),
        )

    def second_view(self, level: Level, at: Variables, light: Light, tempered: bool) -> View:
        """The second image, with a background and an amplitude of its own."""
        rendered = self.rendered(at, light, level=level)
        voxels, _ = self.voxels(at, light, level)
        found = self.found(voxels, rendered, level)
        return self.view(voxels, rendered, found, tempered, level)

    def firmness(self, voxels: Voxels, rendered: Tensor, found: Match, light: Light) -> float:
        """How firmly the image holds a flat surface, before it is divided by the variance.

        A membrane of amplitude a has the image a v g(n), with v the volume that a voxel of the
        rendering stands for and g a Gaussian of width s along its normal: the squares of its
        derivative add up to a^2 v^2 / (4 sqrt(pi) s^3 V) for each um^2, V being the volume of a
        voxel. An inside of amplitude c ends as c v times the integral of g, whose derivative's
        squares add up to c^2 v^2 / (2 sqrt(pi) s V); one is even, the other odd, so both add up.
        """
        level = self.level
        values = voxels.of(rendered).clamp(min=0)
        weight = float(total(voxels.weights * values) / total(values).clamp(min=1e-30))
        volume = float(np.prod(level.grid.voxel_size))
        width = level.factor * geometric_mean(self.imaging.optics.sigma_um)
        brightness = found.amplitude * volume * level.volume_ratio
        sharp = light.membrane**2 / (4 * width**3) + light.interior**2 / (2 * width)
        return weight * brightness**2 * sharp / (np.sqrt(np.pi) * volume)


def _single(image: Tensor) -> Image:
    """The image on the CPU, in single precision: in double, whole images take gigabytes."""
    return image.detach().cpu().numpy().astype(np.float32, copy=False)
