"""How well a fit explains the image near certain places, to compare two shapes there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from torch import Tensor

from ..scene import render
from ..scene.effects import VoxelEffect
from ..scene.render import offset
from .likelihood import ImageNoise, solve_scale

if TYPE_CHECKING:
    from .run import Run

_NEAR = 0.05  # of the brightest voxel of the rendered image: what is darker is far from a surface


def local_misfit(run: Run, places: Sequence[np.ndarray], reach: float) -> np.ndarray:
    """(n,) negative log likelihood (nats) of what is measured within ``reach`` um of each place.

    Half the weighted squared residuals there, over their mean in the whole image: noise, and what
    the fit leaves. What a fit gains everywhere from one iteration to the next does not count so.

    The image is rendered at its own sharpness, whatever the level. Weights come from the measured
    image alone: with those of the model, of two shapes the brighter one would seem the better.

    Parameters
    ----------
    run
        The fit.
    places
        (n, 3) um each.
    reach
        um.
    """
    measured, rendered = _images(run)
    counted = run.counted
    for effect in run.effects.present():
        if isinstance(effect, VoxelEffect):
            counted = counted & ~effect.missing(run.image)
    weights = _weights(run, measured, counted)
    known = torch.from_numpy(counted)
    near = (known & (rendered > _NEAR * rendered.max())).reshape(-1).nonzero()[:, 0]
    given = (t.reshape(-1)[near] for t in (rendered, measured, weights))
    amplitude, background, _ = solve_scale(*given)
    squares = weights * (measured - amplitude * rendered - background) ** 2
    variance = float(squares.reshape(-1)[near].mean())
    squares = torch.where(known, squares, 0.0)
    sums = [_sum_near(squares.numpy(), run, points, reach) for points in places]
    return np.array(sums) / max(2 * variance, 1e-300)


def _images(run: Run) -> tuple[Tensor, Tensor]:
    """Measured image, without what effects add to it, and rendered one, (Z, Y, X)."""
    accuracy, density = run.settings.image_accuracy, run.density.faces_numpy()
    with torch.no_grad():
        given = run.mesh, run.grid, run.optics, accuracy
        rendered = render(*given, density=density, effects=run.effects).double()
        measured = torch.from_numpy(run.image).double()
        added = offset(run.effects, run.grid)
        return measured if added is None else measured - added, rendered


def _weights(run: Run, measured: Tensor, counted: np.ndarray) -> Tensor:
    widths = np.asarray(run.optics.sigma_um) / np.asarray(run.grid.voxel_size)
    share = gaussian_filter(counted.astype(float), widths)
    smooth = gaussian_filter(np.where(counted, measured.numpy(), 0.0), widths)
    smooth = smooth / np.maximum(share, 1e-6)
    seen, camera = measured[torch.from_numpy(counted)], run.effects.camera
    noise = ImageNoise(seen, run.settings.likelihood, camera=camera)
    return noise.weights(torch.from_numpy(smooth), None)


def _sum_near(image: np.ndarray, run: Run, points: np.ndarray, reach: float) -> float:
    origin, size = np.asarray(run.grid.origin), np.asarray(run.grid.voxel_size)
    low = np.floor((points.min(0) - reach - origin) / size).astype(int).clip(0)
    high = np.ceil((points.max(0) + reach - origin) / size).astype(int).clip(-1) + 1
    cut = image[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    at = origin + size * (low + np.argwhere(np.ones(cut.shape, bool)))
    if not len(at):
        return 0.0
    near = cKDTree(points).query(at, distance_upper_bound=reach)[0] < reach
    return float(cut.reshape(-1)[near].sum())
