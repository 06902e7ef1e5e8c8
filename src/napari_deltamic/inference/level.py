"""One level of the coarse-to-fine fit: both images blurred alike, on a grid just fine enough."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from ..errors import InputError
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid, Renderer
from ..settings import FitSettings
from .likelihood import ImageNoise, solve_scale

_REFRESH_EVERY = 10  # iterations between two looks at which voxels count
_PLAN_EVERY = 20  # iterations: edges grow as the mesh moves
FEWEST_VOXELS = 64
_COARSE_ACCURACY = 1e-2  # of all levels but the last: they only have to point the right way


@dataclass(frozen=True)
class Voxels:
    """The voxels that count: flat indices, measured values and weights, each (N,)."""

    index: Tensor
    measured: Tensor
    weights: Tensor

    def of(self, image: Tensor) -> Tensor:
        """Their values in an image (Z, Y, X)."""
        return image.reshape(-1)[self.index]


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
    """

    def __init__(
        self,
        image: np.ndarray,
        counted: np.ndarray,
        grid: Grid,
        optics: Optics,
        settings: FitSettings,
        effects: tuple[str, ...],
        factor: float,
    ) -> None:
        self.factor = factor
        self.settings = settings
        self._effects = effects
        shape = level_shape(grid, optics, settings, factor)
        self.blur, self.accuracy, self.width = shape.blur, shape.accuracy, shape.width
        self.smoothing = (settings.smoothing or 0.0) * factor
        self._sample = tuple(slice(None, None, s) for s in shape.step)
        self.grid = shape.grid
        self.volume_ratio = float(1 / np.prod(shape.step))
        self.target, self._counted = self._blurred(image, counted, grid)
        # Where the blur is wider than the field of view, hardly a voxel is left to go by.
        self.usable = int(self._counted.sum()) >= FEWEST_VOXELS
        if self.usable:
            self.noise = ImageNoise(self.target[self._counted], settings.likelihood)
        self._renderer: Renderer | None = None
        self._planned_width: np.ndarray | None = None
        self._voxels: Voxels | None = None
        self._age = 0

    def _blurred(self, image: np.ndarray, counted: np.ndarray, grid: Grid) -> tuple[Tensor, Tensor]:
        """Blurred image and the voxels whose blur rests mostly on counted ones."""
        if self.factor == 1:
            y, inside = image, counted
        else:
            sigma = np.asarray(self.blur) / np.asarray(grid.voxel_size)
            known = counted.astype(np.float32)
            share = gaussian_filter(known, sigma, mode="constant", truncate=3.5)
            y = gaussian_filter(image * known, sigma, mode="constant", truncate=3.5)
            y = y / np.maximum(share, 1e-6)
            inside = (share > 0.6) & counted
        return (
            torch.from_numpy(np.ascontiguousarray(y[self._sample], dtype=np.float32)),
            torch.from_numpy(np.ascontiguousarray(inside[self._sample])),
        )

    @property
    def renews(self) -> bool:
        """Whether plan and voxels are about to be made anew, so that a fit can be resumed here."""
        return self._age % _PLAN_EVERY == 0

    def renew(self) -> None:
        """Make plan and voxels anew at the next iteration: the mesh was moved by hand."""
        self._age = 0

    # ------------------------------------------------------------------------------- rendering

    def renderer(self, mesh: Mesh, optics: Optics) -> Renderer:
        """The renderer, planned anew when the mesh or the PSF has left what it was planned for."""
        width = np.asarray(optics.sigma_um)
        stale = (
            self._renderer is None
            or self._age % _PLAN_EVERY == 0
            or not self._renderer.holds_for(mesh.vertices_numpy())
            or self._planned_width is None
            or bool((np.abs(np.log(width / self._planned_width)) > 0.1).any())
        )
        if stale:
            # With a PSF that is being fitted the band reaches further: cut at today's width, it
            # would hide what a sharper PSF explains.
            sharper = optics if not self.settings.fit_psf else _scaled(optics, 0.9)
            self._renderer = Renderer(
                mesh,
                self.grid,
                sharper,
                self.accuracy,
                blur=self.blur,
                pixel_integration="pixel_integration" in self._effects,
                margin=2 * self.width,
            )
            self._planned_width = width
        assert self._renderer is not None
        return self._renderer

    def rendered(self, renderer: Renderer, transform: Tensor, otf: Tensor) -> Tensor:
        """Image per voxel of the fine grid, whatever the spacing of this one."""
        return renderer.image(transform, otf) * self.volume_ratio

    # ---------------------------------------------------------------------------------- voxels

    def voxels(self, rendered: Tensor) -> Voxels:
        """The voxels that count: near the surface, known, weighted by the likelihood.

        Looked at anew every few iterations, as the surface moves.
        """
        self._age += 1
        if self._voxels is not None and self._age % _REFRESH_EVERY != 1:
            return self._voxels
        inside = (rendered > self._image_at_reach()) & self._counted
        index = torch.nonzero((inside if bool(inside.any()) else self._counted).reshape(-1))[:, 0]
        measured, model = self.target.reshape(-1)[index], rendered.reshape(-1)[index]
        if self.noise.kind == "poisson":
            a, b, _ = solve_scale(model, measured, torch.ones_like(measured))
            weights = self.noise.weights(measured, a * model + b)
        else:
            weights = self.noise.weights(measured, None)
        if not bool(measured.min() < measured.max()):
            raise InputError("the image is flat wherever the mesh reaches: start nearer to it")
        self._voxels = Voxels(index, measured, weights)
        return self._voxels

    def _image_at_reach(self) -> float:
        """What a flat membrane of density 1 gives a voxel at the reach from it."""
        sigma = self.factor * max(self._planned_width) if self._planned_width is not None else 1.0
        volume = float(np.prod(self.grid.voxel_size)) * self.volume_ratio
        return float(np.exp(-(self.settings.reach**2) / 2) / (sqrt(2 * np.pi) * sigma) * volume)


def _scaled(optics: Optics, factor: float) -> Optics:
    p = optics.parameters().detach().clone()
    p[:3] += float(np.log(factor))
    return optics.with_parameters(p)
