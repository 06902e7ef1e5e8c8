"""How well a shape explains the image near certain places, to compare two shapes there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from ...geometry.mesh import FloatArray, Mesh
from ...optics import Optics
from ...scene import Renderer, Scene
from ...scene.effects import Effects
from ...scene.light import MEMBRANES, Light
from ...scene.render import offset
from ..model.likelihood import ImageNoise, solve_scale
from ..model.problem import Problem
from ..model.tempering import tempered_variance
from ..solvers.lbfgs import dot

_NEAR = 0.05  # of the brightest voxel of the rendered image: what is darker lies further away than
# two and a half widths of the PSF
# Sides of the blocks over which differences are added up, in widths of the PSF: more than the two
# over which what a fit leaves is correlated.
_BLOCK = 3.0


@dataclass(frozen=True, eq=False)
class Misfit:
    """Weighted residuals of one shape.

    Attributes
    ----------
    residual
        (Z, Y, X) float32: measured minus rendered, times the root of the weight; 0 where nothing
        counts.
    variance
        Of one near the surface, times the voxels that one independent voxel stands for; see
        :func:`~.tempering.tempered_variance`.
    independent
        Share of its voxels that are independent.
    weights
        (Z, Y, X).
    """

    residual: NDArray[np.float32]
    variance: float
    independent: float
    weights: torch.Tensor


@dataclass(frozen=True)
class Gap:
    """How much better a shape explains the image near a place than the one before.

    nats : of log likelihood. error : its standard error.
    """

    nats: float
    error: float


def misfit_of(
    problem: Problem,
    mesh: Mesh,
    density: FloatArray,
    optics: Optics,
    effects: Effects,
    accuracy: float,
    like: Misfit | None = None,
    light: Light = MEMBRANES,
) -> Misfit:
    """Residuals of a shape at the image's own sharpness, whatever the level.

    Weights come from the measured image alone: with those of the model, of two shapes the brighter
    one would seem the better.

    Parameters
    ----------
    problem, mesh, optics, effects, accuracy
        As of a fit.
    density
        (F,) of the faces.
    like
        Of the shape to compare with: voxels count alike.
    light
        What shines.
    """
    scene = Scene.of(mesh, optics, effects, density, light.interior != 0)
    with torch.no_grad():
        renderer = Renderer(scene, problem.grid, accuracy)
        rendered = renderer.image(renderer.transform(light=light), renderer.otf(optics)).float()
    measured = torch.from_numpy(problem.image)
    added = offset(effects, problem.grid)
    measured = measured if added is None else measured - added.to(measured)
    counted = problem.counted_with(effects)
    weights = (
        _weights(problem, measured.numpy(), counted, optics, effects)
        if like is None
        else like.weights
    )
    known = torch.from_numpy(counted)
    bright = rendered.abs() > _NEAR * float(rendered.abs().max())
    near = (known & bright).reshape(-1).nonzero()[:, 0]
    some = (t.reshape(-1)[near] for t in (rendered, measured, weights))
    amplitude, background, _ = solve_scale(*some)
    left = torch.sqrt(weights) * (measured - amplitude * rendered - background)
    residual = torch.where(known, left, 0.0).numpy()
    widths = tuple(np.asarray(optics.sigma_um) / np.asarray(problem.grid.voxel_size))
    index = near.numpy()
    some_left = residual.reshape(-1)[index].astype(np.float64)
    variance = tempered_variance(some_left, index, problem.grid.shape, widths, 1e-300)
    alone = float(np.mean(some_left**2))
    return Misfit(residual, variance, alone / variance, weights)


def gaps(
    problem: Problem,
    before: Misfit,
    after: Misfit,
    places: list[FloatArray],
    reach: float,
    optics: Optics,
) -> list[Gap]:
    """For each place, (n, 3) um, how much better the image within ``reach`` um is explained.

    With residuals r before and r - d after, of variance v, the log likelihoods differ by the sum of
    m d / v, where m = r - d / 2. Noise of that variance makes sqrt(sum of d^2 / v) of it, however
    clear the gap is; the sum of its squares over blocks would grow with the gap itself. Where more
    is left than elsewhere, that counts: m without what is in proportion to d, summed over blocks
    wider than it is correlated.

    The variance is that of the shape before; noise, and what the fit leaves.
    """
    variance = before.variance
    size = np.asarray(problem.grid.voxel_size)
    side = np.maximum(1, np.rint(_BLOCK * np.asarray(optics.sigma_um) / size)).astype(np.int64)
    found = []
    for points in places:
        index = _voxels_near(problem, points, reach)
        at = tuple(index.T)
        old, new = (one.residual[at].astype(np.float64) for one in (before, after))
        d, m = old - new, (old + new) / 2
        power, gap = dot(d, d), dot(m, d)
        if power == 0:
            found.append(Gap(0.0, 0.0))
            continue
        _, block = np.unique(index // side, axis=0, return_inverse=True)
        left = np.bincount(block.reshape(-1), (m - gap / power * d) * d)
        error = np.sqrt(max(power * variance, dot(left, left))) / variance
        found.append(Gap(gap / variance, float(error)))
    return found


def _weights(
    problem: Problem,
    measured: NDArray[np.float32],
    counted: np.ndarray,
    optics: Optics,
    effects: Effects,
) -> torch.Tensor:
    widths = np.asarray(optics.sigma_um) / np.asarray(problem.grid.voxel_size)
    share = gaussian_filter(counted.astype(np.float32), widths)
    smooth = gaussian_filter(np.where(counted, measured, np.float32(0)), widths)
    smooth = torch.from_numpy(smooth / np.maximum(share, 1e-6))  # only no division by 0
    seen = torch.from_numpy(measured[counted])
    return ImageNoise(seen, "poisson", camera=effects.detector).weights(smooth)


def _voxels_near(problem: Problem, points: FloatArray, reach: float) -> np.ndarray:
    """(n, 3) indices of the voxels within reach of some points."""
    size, origin = np.asarray(problem.grid.voxel_size), np.asarray(problem.grid.origin)
    shape = np.asarray(problem.grid.shape)
    low = np.floor((points.min(0) - reach - origin) / size).astype(np.int64).clip(0, shape)
    high = np.ceil((points.max(0) + reach - origin) / size + 1).astype(np.int64).clip(0, shape)
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    index = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    apart = cKDTree(points).query(origin + index * size, distance_upper_bound=reach)[0]
    return index[np.isfinite(apart)]
