"""The PSF's half of the staggered scheme: shape held, parameters moved.

The paper takes Adam steps. A PSF has a handful of parameters and its images are cheap once the
mesh is transformed, so a damped Gauss-Newton step of parameters, amplitude and background together
gets there in a few steps without a step size to tune.
"""

from __future__ import annotations

from math import log

import numpy as np
import torch
from torch import Tensor

from ..optics import Optics
from ..scene import Renderer
from .level import Level, Voxels
from .likelihood import solve_scale

_DIFFERENCE = 1e-3
_LARGEST = 0.15  # of one step, in log widths
_RANGE = log(4)  # of log widths, around those at the start


def psf_step(
    level: Level,
    renderer: Renderer,
    optics: Optics,
    transform: Tensor,
    voxels: Voxels,
    start: Optics,
) -> Optics:
    """The optics after one damped Gauss-Newton step on the weighted least squares.

    Widths stay within a factor of 4 of those at the start: an image that tells nothing about the
    PSF, noise for example, would let them run to nothing or beyond the image.
    """
    with torch.no_grad():
        p = optics.parameters()
        image = voxels.of(level.rendered(renderer, transform, renderer.otf(optics)))
        a, b, _ = solve_scale(image, voxels.measured, voxels.weights)
        columns = [image, torch.ones_like(image)]
        for i in range(len(p)):
            change = torch.zeros_like(p)
            change[i] = _DIFFERENCE
            otf = renderer.otf(optics.with_parameters(p + change)) - renderer.otf(
                optics.with_parameters(p - change)
            )
            column = level.rendered(renderer, transform, otf / (2 * _DIFFERENCE))
            columns.append(a * voxels.of(column))
        root = torch.sqrt(voxels.weights)
        jacobian = torch.stack([c * root for c in columns], 1).to(torch.float64)
        residual = ((voxels.measured - a * image - b) * root).to(torch.float64)
        normal = jacobian.T @ jacobian
        damping = 1e-6 * torch.diagonal(normal)
        delta = torch.linalg.solve(normal + torch.diag(damping), jacobian.T @ residual)[2:]
        largest = float(delta.abs().max())
        if not np.isfinite(largest):
            return optics
        p = p + delta * min(1.0, _LARGEST / max(largest, 1e-12))
        widths = start.parameters()[:3]
        p[:3] = torch.clamp(p[:3], widths - _RANGE, widths + _RANGE)
        return optics.with_parameters(p)
