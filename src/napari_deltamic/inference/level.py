"""One level of the coarse-to-fine fit: both images blurred alike, on a grid just fine enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import ceil, sqrt
from typing import Any

import numpy as np
import torch
from scipy.ndimage import gaussian_filter, map_coordinates
from torch import Tensor

from ..errors import InputError
from ..fourier.devices import choose_device, widest
from ..optics import GaussianPSF, Optics
from ..optics.sharpest import Sharpest
from ..scene import Grid, Renderer
from ..scene.effects import Effects, VoxelEffect
from ..scene.render import offset
from ..settings import FitSettings
from .likelihood import ImageNoise, Match, solve_scale
from .readings import late
from .surface import Surface

_REFRESH_EVERY = 10  # iterations between two looks at which voxels count
_PLAN_EVERY = 20  # iterations: edges grow as the mesh moves
FEWEST_VOXELS = 64
_SEEN = 0.3  # of the median brightness of a surface: what is dimmer says nothing of its density
_ANY = 1e-3  # of the weights of a blur: what rests on less is not known
_COARSE_ACCURACY = 1e-2  # of all levels but the last: they only have to point the right way


@dataclass(frozen=True)
class Voxels:
    """The voxels that count: flat indices, measured values and weights, each (N,)."""

    index: Tensor
    measured: Tensor
    weights: Tensor

    def of(self, image: Tensor) -> Tensor:
        """Their values in an image (Z, Y, X)."""
        # Unlike indexing, whose gradient sorts, since an index might come twice.
        return image.to(self.index.device).reshape(-1).index_select(0, self.index)


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
    steps = np.maximum(1, np.floor(factor * sigma / np.asarray(grid.voxel_size) + 1e-9)).astype(int)
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
    halo
        um: voxels count as far from the surface's own image as this, where there is a halo.
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
        halo: float = 0.0,
    ) -> None:
        self.factor = factor
        self.settings = settings
        self.frame = grid
        self._second = second
        shape = level_shape(grid, optics, settings, factor)
        self.blur, self.accuracy, self.width = shape.blur, shape.accuracy, shape.width
        self.smoothing = (settings.smoothing or 0.0) * factor
        self._sample = tuple(slice(None, None, s) for s in shape.step)
        self.grid = shape.grid
        self.volume_ratio = float(1 / np.prod(shape.step))
        for effect in effects.present():
            if isinstance(effect, VoxelEffect):
                counted = counted & ~effect.missing(image)
        self.device = choose_device(settings.device)
        blurred = self._blurred(image, counted, grid)
        self.target, self._counted, self._known = (t.to(self.device) for t in blurred)
        # Where the blur is wider than the field of view, hardly a voxel is left to go by.
        self.usable = int(self._counted.sum()) >= FEWEST_VOXELS
        if self.usable:
            self.noise = ImageNoise(
                self.target[self._counted], settings.likelihood, camera=effects.camera
            )
        self._take(effects)
        self._halo = None if effects.halo is None else halo
        self._renderer: Renderer | None = None
        self._planned_width: np.ndarray | None = None
        self.far = 0.0  # um: how far a vertex has moved since the plan was made, when last read
        # What it may move until that is read.
        self._unread = late(self.device) * settings.step * self.width
        self._voxels: Voxels | None = None
        self._age = 0

    def _blurred(self, image: np.ndarray, counted: np.ndarray, grid: Grid) -> tuple[Tensor, ...]:
        """Blurred image, and the voxels whose blur rests mostly, and at all, on counted ones."""
        if self.factor == 1:
            y, inside, any_inside = image, counted, counted
        else:
            sigma = np.asarray(self.blur) / np.asarray(grid.voxel_size)
            known = counted.astype(np.float32)
            share = gaussian_filter(known, sigma, mode="constant", truncate=3.5)
            y = gaussian_filter(image * known, sigma, mode="constant", truncate=3.5)
            y = y / np.maximum(share, 1e-6)
            inside, any_inside = (share > 0.6) & counted, share > _ANY
        return (
            torch.from_numpy(np.ascontiguousarray(y[self._sample], dtype=np.float32)),
            *(torch.from_numpy(np.array(m[self._sample], order="C")) for m in (inside, any_inside)),
        )

    @property
    def renews(self) -> bool:
        """Whether plan and voxels are about to be made anew, so that a fit can be resumed here."""
        return self._age % _PLAN_EVERY == 0

    def renew(self) -> None:
        """Make plan and voxels anew at the next iteration: the mesh was moved by hand."""
        self._age = 0

    def _take(self, effects: Effects) -> None:
        self.effects = effects
        found = offset(effects, self.grid, self.frame)
        self._offset = None if found is None else found.to(self.device, widest(self.device))

    def set_effects(self, effects: Effects) -> None:
        """Go on with other numbers of the same effects."""
        self._take(effects)
        if self._renderer is not None:
            self._renderer = self._renderer.with_effects(effects)
        if self._voxels is not None and self._offset is not None:
            self._voxels = replace(self._voxels, measured=self._measured(self._voxels.index))

    def _measured(self, index: Tensor) -> Tensor:
        """Measured values of voxels, without what effects add to the image."""
        measured = self.target.reshape(-1)[index]
        if self._offset is None:
            return measured
        return measured - self._offset.reshape(-1)[index].to(measured.dtype)

    # ------------------------------------------------------------------------------- rendering

    def renderer(self, surface: Surface, optics: Optics) -> Renderer:
        """The renderer, planned anew when the mesh or the PSF has left what it was planned for."""
        width = np.asarray(optics.sigma_um)
        stale = (
            self._renderer is None
            or self._age % _PLAN_EVERY == 0
            or self.far + self._unread > self._renderer.margin
            or self._planned_width is None
            or bool((np.abs(np.log(width / self._planned_width)) > 0.1).any())
        )
        if stale:
            # With a PSF that is being fitted the band reaches further: cut at today's width, it
            # would hide what a sharper PSF explains.
            sharper: Any = optics if not self.settings.fit_psf else optics.sharpened(0.9)
            if self._second is not None:
                sharper = Sharpest(sharper, self._second)
            self.far = 0.0
            self._renderer = Renderer(
                surface.mesh,
                self.grid,
                sharper,
                self.accuracy,
                blur=self.blur,
                effects=self.effects,
                frame=self.frame,
                margin=2 * self.width,
                device=self.device,
            )
            self._planned_width = width
        assert self._renderer is not None
        return self._renderer

    def rendered(self, renderer: Renderer, transform: Tensor, otf: Tensor) -> Tensor:
        """Image per voxel of the fine grid, whatever the spacing of this one."""
        return renderer.image(transform, otf) * self.volume_ratio

    def with_effects(
        self,
        renderer: Renderer,
        transform: Tensor,
        again: Callable[[Renderer], Tensor],
        optics: Optics,
        effects: Effects,
    ) -> Tensor:
        """The image with other effects than the transform was made with; no gradient.

        ``again`` transforms the same mesh, which is needed where the bulk is another.
        """
        with torch.no_grad():
            other = renderer.with_effects(effects)
            seen = transform.detach() if effects.bulk == self.effects.bulk else again(other)
            return self.rendered(other, seen, other.otf(optics))

    def heard(self, renderer: Renderer, far: float) -> None:
        """Learn how far a vertex has moved since a plan was made, um, if it is the present one."""
        if renderer is self._renderer:
            self.far = far

    def brightness(self, vertices: np.ndarray, rendered: Tensor, found: Match) -> np.ndarray:
        """(V,) measured over rendered brightness at vertices (V, 3) um.

        Both without the background of the match; 1 where hardly any shows, or nothing is known.
        """
        at = ((vertices - np.asarray(self.grid.origin)) / np.asarray(self.grid.voxel_size)).T
        index = torch.arange(self.target.numel(), device=self.target.device)
        measured = self._measured(index).reshape(self.target.shape) - float(found.background)
        shown = rendered.detach() * float(found.amplitude)
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

    def voxels(self, rendered: Tensor, plain: Callable[[Effects], Tensor] | None = None) -> Voxels:
        """The voxels that count: near the surface, known, weighted by the likelihood.

        Looked at anew every few iterations, as the surface moves. ``plain`` renders the same with
        other effects: a halo is seen everywhere, and would have everything count; an inside darker
        than the outside would leave out voxels just because they are dark.
        """
        self._age += 1
        if self._voxels is not None and self._age % _REFRESH_EVERY != 1:
            return self._voxels
        hiding = self._hiding()
        if not hiding or plain is None:
            near = rendered > self._image_at_reach()
        else:
            near = plain(self.effects.without(*hiding)) > self._image_at_reach()
            if self._halo is not None:
                near = _dilated(near, [self._halo / d for d in self.grid.voxel_size])
        inside = near & self._counted
        index = torch.nonzero((inside if bool(inside.any()) else self._counted).reshape(-1))[:, 0]
        measured, model = self._measured(index), rendered.reshape(-1)[index]
        if self.noise.kind == "poisson":
            a, b, _ = solve_scale(model, measured, torch.ones_like(measured))
            expected = a * model + b
            if self._offset is not None:
                expected = expected + self._offset.reshape(-1)[index].to(expected.dtype)
            weights = self.noise.weights(measured, expected)
        else:
            weights = self.noise.weights(self.target.reshape(-1)[index], None)
        if not bool(measured.min() < measured.max()):
            raise InputError("the image is flat wherever the mesh reaches: start nearer to it")
        self._voxels = Voxels(index, measured, weights)
        return self._voxels

    def _hiding(self) -> tuple[str, ...]:
        """Effects that hide how far from the surface its own image reaches."""
        dark = self.effects.bulk is not None and self.effects.bulk.density < 0
        return ("halo",) * (self._halo is not None) + ("bulk",) * dark

    def reach_of(self, optics: Optics) -> None:
        """Take the reach of this PSF, where images are rendered by another level."""
        self._planned_width = np.asarray(optics.sigma_um)

    def _image_at_reach(self) -> float:
        """What a flat membrane of density 1 gives a voxel at the reach from it."""
        sigma = self.factor * max(self._planned_width) if self._planned_width is not None else 1.0
        volume = float(np.prod(self.grid.voxel_size)) * self.volume_ratio
        return float(np.exp(-(self.settings.reach**2) / 2) / (sqrt(2 * np.pi) * sigma) * volume)


def _dilated(mask: Tensor, voxels: Sequence[float]) -> Tensor:
    """A mask (Z, Y, X) and what lies within so many voxels of it along each axis."""
    grown = mask[None, None].to(torch.float32)
    for axis, n in enumerate(voxels):
        half = [0, 0, 0]
        half[axis] = min(ceil(n), mask.shape[axis] - 1)
        size = [2 * h + 1 for h in half]
        grown = torch.nn.functional.max_pool3d(grown, size, stride=1, padding=half)
    return grown[0, 0] > 0
