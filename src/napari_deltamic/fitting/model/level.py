"""One level of the coarse-to-fine fit: both images blurred alike, on a grid just fine enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import ceil, prod, sqrt
from typing import Any

import numpy as np
import torch
from scipy.ndimage import gaussian_filter, map_coordinates
from torch import Tensor

from ...errors import InputError
from ...fourier.devices import choose_device, widest
from ...geometry.mesh import Mesh
from ...optics import GaussianPSF, Optics
from ...optics.sharpest import Sharpest
from ...runs.settings import FitSettings
from ...scene import Grid, Renderer, Scene
from ...scene.effects import Effects
from ...scene.render import offset
from .checks import FEWEST_VOXELS
from .likelihood import ImageNoise, Match, solve_scale
from .saturation import cut_at, weights_below

SHARPER = 0.9  # of the width of a PSF that is fitted: what is narrower would need a new plan
_SEEN = 0.3  # of the median brightness of a surface: only what is brighter tells of its density
# Of the weights of a blur: voxels count whose blur rests on more. Beside a flat border it is 0.5;
# half of it lets the blur of what is missing in: surfaces move by 0.09 voxel, as measured.
_MOSTLY = 0.6
CUT_OFF = 3.5  # widths of a blur: only 5e-4 of a Gaussian lies beyond
_ANY = 1e-3  # of those weights: what rests on less is not known; half and twice do nothing
_COARSE_ACCURACY = 1e-2  # of all levels but the last: they only have to point the right way


@dataclass(frozen=True)
class Voxels:
    """The voxels that count: flat indices, measured values and weights, each (N,).

    ``full`` says which were cut: they are at least as bright as measured; None where none was.
    """

    index: Tensor
    measured: Tensor
    weights: Tensor
    full: Tensor | None = None

    def weights_for(self, shown: Tensor, measured: Tensor) -> Tensor:
        """(N,) without those of cut voxels that a model exceeds, of any amplitude and background.

        shown : (N,) the model. measured : (N,) without what effects add.
        """
        if self.full is None:
            return self.weights
        return weights_below(shown, measured, self.weights, self.full)

    def of(self, image: Tensor) -> Tensor:
        """Their values in an image (Z, Y, X)."""
        # Unlike indexing, whose gradient sorts, since an index might come twice.
        return image.to(self.index.device).reshape(-1).index_select(0, self.index)

    def image(self, values: Tensor, shape: tuple[int, ...]) -> Tensor:
        """(Z, Y, X) their values (N,), and 0 elsewhere."""
        return values.new_zeros(prod(shape)).index_copy(0, self.index, values).reshape(shape)


@dataclass(frozen=True)
class LevelShape:
    """What a level computes on, known before it is made.

    Attributes
    ----------
    blur
        um, Z Y X: of both images on top of the PSF.
    step, grid
        Every how many voxels of the image, and the grid that they make.
    accuracy
        Of its images.
    width
        um: of the blurred PSF, along its narrowest axis.
    """

    blur: tuple[float, float, float]
    step: tuple[int, int, int]
    grid: Grid
    accuracy: float
    width: float


def level_shape(grid: Grid, optics: Optics, settings: FitSettings, factor: float) -> LevelShape:
    """The shape of the level whose blurred PSF is ``factor`` times as wide as the PSF."""
    sigma = np.asarray(optics.sigma_um)
    extra = sqrt(factor**2 - 1) * sigma
    # A band-limited image loses nothing on a grid of spacing sigma: its OTF ends there.
    rounded = 1e-9  # so that rounding takes no voxel away
    whole = np.floor(factor * sigma / np.asarray(grid.voxel_size) + rounded)
    steps = np.maximum(1, whole).astype(int)
    step = (int(steps[0]), int(steps[1]), int(steps[2])) if factor > 1 else (1, 1, 1)
    accuracy = settings.image_accuracy
    last = factor == 1 or accuracy == 0
    return LevelShape(
        blur=(float(extra[0]), float(extra[1]), float(extra[2])),
        step=step,
        grid=grid.strided(step),
        accuracy=accuracy if last else max(accuracy, _COARSE_ACCURACY),
        width=float(factor * sigma.min()),
    )


class Level:
    """Target image, grid, renderer and weights at one blur.

    Parameters
    ----------
    image
        (Z, Y, X) measured, float32.
    counted
        (Z, Y, X) bool: voxels that may count at all (missing ones and foreign ground do not).
    grid, optics, settings
        Of the fit.
    factor
        Width of the blurred PSF relative to the PSF; 1 at the last level.
    second
        Another PSF that images are rendered through.
    own_optics
        The PSF of this image, where it is not that of the fit.
    spread
        um: voxels count as far from the surface's own image as this, where effects spread light.
    foreign
        (Z, Y, X) bool: voxels of objects that no mesh describes; None if there are none, and at
        blurred levels.
    frame
        Grid of the whole image, where this one is a piece of it.
    """

    def __init__(
        self,
        image: np.ndarray,
        counted: np.ndarray,
        grid: Grid,
        optics: Optics,
        settings: FitSettings,
        effects: Effects,
        factor: float,
        second: GaussianPSF | None = None,
        spread: float = 0.0,
        own_optics: GaussianPSF | None = None,
        foreign: np.ndarray | None = None,
        frame: Grid | None = None,
    ) -> None:
        self.factor = factor
        self.foreign = foreign
        self.optics = own_optics
        self.settings = settings
        self.frame = frame or grid
        self._second = second
        shape = level_shape(grid, optics, settings, factor)
        self.blur, self.accuracy, self.width = shape.blur, shape.accuracy, shape.width
        self.smoothing = settings.smoothing * factor
        self._sample = tuple(slice(None, None, s) for s in shape.step)
        self.grid = shape.grid
        self.volume_ratio = float(1 / np.prod(shape.step))
        self.device = choose_device(settings.device, prod(grid.shape))
        blurred = self._blurred(image, counted, grid)
        self.target, self.counted, self._known = (t.to(self.device) for t in blurred)
        # Blurred, cut voxels are no longer to be told.
        self.cut = cut_at(image[counted]) if factor == 1 else None
        # Where the blur is wider than the field of view, hardly a voxel is left to go by.
        self.usable = int(self.counted.sum()) >= FEWEST_VOXELS
        if self.usable:
            seen = self.target[self.counted]
            self.noise = ImageNoise(seen, settings.likelihood, camera=effects.detector)
            self.range = float(seen.max() - seen.min()) or 1.0
        self._spread = spread if effects.spread > 0 else 0.0

    def _blurred(self, image: np.ndarray, counted: np.ndarray, grid: Grid) -> tuple[Tensor, ...]:
        """Blurred image, and the voxels whose blur rests mostly, and at all, on counted ones."""
        if self.factor == 1:
            y, inside, any_inside = image, counted, counted
        else:
            sigma = np.asarray(self.blur) / np.asarray(grid.voxel_size)
            known = counted.astype(np.float32)
            share = gaussian_filter(known, sigma, mode="constant", truncate=CUT_OFF)
            y = gaussian_filter(image * known, sigma, mode="constant", truncate=CUT_OFF)
            y = y / np.maximum(share, 1e-6)  # only no division by 0
            inside, any_inside = (share > _MOSTLY) & counted, share > _ANY
        return (
            torch.from_numpy(np.ascontiguousarray(y[self._sample], dtype=np.float32)),
            *(torch.from_numpy(np.array(m[self._sample], order="C")) for m in (inside, any_inside)),
        )

    def offset(self, effects: Effects) -> Tensor | None:
        """(Z, Y, X) what effects add to the measured image; None where nothing is added."""
        found = offset(effects, self.grid, self.frame)
        return None if found is None else found.to(self.device, widest(self.device))

    # ------------------------------------------------------------------------------- rendering

    def renderer(
        self,
        mesh: Mesh,
        optics: Optics,
        effects: Effects,
        accuracy: float | None = None,
        insides: bool = False,
    ) -> Renderer:
        """A renderer planned for this mesh; insides : whether they may shine, too."""
        return self.renderer_of(Scene.of(mesh, optics, effects, None, insides), accuracy)

    def renderer_of(self, scene: Scene, accuracy: float | None = None) -> Renderer:
        """A renderer planned for a scene, and for what a fit may make of it until it is renewed.

        Of the level's accuracy, or a finer one.

        With a PSF that is being fitted the band reaches further: cut at today's width, it would
        hide what a sharper PSF explains.
        """
        sharper: Any = scene.optics
        if self.settings.fit_psf:
            sharper = sharper.sharpened(SHARPER)
        if self._second is not None:
            sharper = Sharpest(sharper, self._second)
        return Renderer(
            replace(scene, optics=sharper),
            self.grid,
            self.accuracy if accuracy is None else min(accuracy, self.accuracy),
            blur=self.blur,
            frame=self.frame,
            margin=4 * self.width,
            device=self.device,
        )

    def rendered(
        self, renderer: Renderer, transform: Tensor, otf: Tensor, known: Tensor | None = None
    ) -> Tensor:
        """Image per voxel of the fine grid, whatever the spacing of this one.

        known : that image, where it was made before and only its gradients are wanted.
        """
        if known is not None and self.volume_ratio != 1:
            known = known / self.volume_ratio
        image = renderer.image(transform, otf, known)
        return image if self.volume_ratio == 1 else image * self.volume_ratio

    def brightness(
        self,
        vertices: np.ndarray,
        rendered: Tensor,
        found: Match,
        effects: Effects,
        inside: Tensor | None = None,
    ) -> np.ndarray:
        """(V,) measured over rendered brightness at vertices (V, 3) um.

        Both without the background of the match, and without the light from inside that is
        rendered; 1 where hardly any shows, or nothing is known.
        """
        at = ((vertices - np.asarray(self.grid.origin)) / np.asarray(self.grid.voxel_size)).T
        added = self.offset(effects)
        measured = (self.target if added is None else self.target - added) - found.background
        shown = rendered.detach() * found.amplitude
        if inside is not None:
            further = inside.detach() * found.amplitude
            measured, shown = measured - further.to(measured), shown - further
        known = self._known.to(measured.dtype)
        one, other, share = (
            map_coordinates(image.cpu().numpy(), at, order=1, mode="nearest")
            for image in (measured * known, shown * known, known)
        )
        if not share.any():
            return np.ones(len(vertices))
        # An inside darker than the outside may leave less than nothing on the surface.
        seen = other > _SEEN * max(float(np.median(other[share > 0])), 0.0)
        return np.where(seen, one / np.where(seen, other, 1.0), 1.0)

    # ---------------------------------------------------------------------------------- voxels

    def near(
        self, membranes: Tensor, effects: Effects, plain: Callable[[Effects], Tensor], width: float
    ) -> Tensor:
        """(N,) flat indices of the voxels that count: known, and near the surface.

        Parameters
        ----------
        membranes
            (Z, Y, X) image of the surface as it is now, with these effects.
        effects
            As they are now.
        plain
            Renders the same with other effects: some hide how far the surface's image reaches.
        width
            um: largest of the PSF that it was rendered through.

        Raises
        ------
        InputError
            If the image is flat there.
        """
        hiding = [e.name for e in effects.present() if e.hides_reach()]
        least = self._image_at_reach(width)
        near = (plain(effects.without(*hiding)) if hiding else membranes) > least
        if hiding and self._spread > 0:
            near = _dilated(near, [self._spread / d for d in self.grid.voxel_size])
        return self._varied(near & self.counted)

    def weighted(self, index: Tensor, rendered: Tensor, effects: Effects) -> Voxels:
        """Some voxels, weighted by the likelihood.

        Parameters
        ----------
        index
            (N,) flat indices.
        rendered
            (Z, Y, X) image of what shines as it is now, with these effects.
        """
        measured, model = self.target.reshape(-1)[index], rendered.reshape(-1)[index]
        if self.noise.kind != "poisson":
            return Voxels(index, measured, self.noise.weights(measured, None))
        added = self.offset(effects)
        further = 0.0 if added is None else added.reshape(-1)[index].to(measured.dtype)
        # Of cut voxels only the light is known that the others tell.
        whole = torch.ones_like(measured, dtype=torch.bool)
        if self.cut is not None and bool((measured < self.cut).any()):
            whole = measured < self.cut
        a, b, _ = solve_scale(model, measured - further, whole.to(measured.dtype))
        expected = a * model + b + further
        left = self.target - (a * rendered + (0.0 if added is None else added)).to(self.target)
        noise = differences(left).reshape(-1)[index]
        return Voxels(
            index,
            measured,
            self.noise.weights(measured, expected, measured - expected, noise, whole),
        )

    def _varied(self, inside: Tensor) -> Tensor:
        """Flat indices of these voxels; of all that count where these are too few."""
        index = torch.nonzero(inside.reshape(-1))[:, 0]
        if len(index) < FEWEST_VOXELS:
            index = torch.nonzero(self.counted.reshape(-1))[:, 0]
        values = self.target.reshape(-1)[index]
        if not bool(values.min() < values.max()):
            raise InputError("the image is flat wherever the mesh reaches: start nearer to it")
        return index

    def _image_at_reach(self, width: float) -> float:
        """What a flat membrane of density 1 gives a voxel at the reach from it."""
        volume = float(np.prod(self.grid.voxel_size)) * self.volume_ratio
        peak = volume / (sqrt(2 * np.pi) * self.factor * width)
        return float(np.exp(-(self.settings.reach**2) / 2) * peak)


def differences(image: Tensor) -> Tensor:
    """(Z, Y, X) what is left of voxels when the mean of their neighbours along X is taken away.

    As large as the noise of one voxel in the mean.
    """
    padded = torch.nn.functional.pad(image, (1, 1, 0, 0), mode="replicate")
    mean = (padded[..., :-2] + padded[..., 2:]) / 2
    return (image - mean) / sqrt(1.5)  # by definition: 1 of the voxel, and a quarter of each of two


def _dilated(mask: Tensor, voxels: Sequence[float]) -> Tensor:
    """A mask (Z, Y, X) and what lies within so many voxels of it along each axis."""
    grown = mask[None, None].to(torch.float32)
    for axis, n in enumerate(voxels):
        half = [0, 0, 0]
        half[axis] = min(ceil(n), mask.shape[axis] - 1)
        size = [2 * h + 1 for h in half]
        grown = torch.nn.functional.max_pool3d(grown, size, stride=1, padding=half)
    return grown[0, 0] > 0
