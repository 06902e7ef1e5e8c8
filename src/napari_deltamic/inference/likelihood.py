"""How well a rendered image explains a measured one; amplitude and background are solved for."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
import torch
from torch import Tensor

from ..fourier.devices import widest
from ..scene.effects import Camera
from ..settings import Likelihood


@dataclass(frozen=True)
class Match:
    """Measured = amplitude * rendered + background, over the voxels that count.

    ``loss`` is the weighted residual relative to the weighted variance of the measured voxels, so
    that 1 means that nothing is explained. All are 0-dim tensors on the device of the image.
    """

    loss: Tensor
    amplitude: Tensor
    background: Tensor
    bounded: Tensor


class ImageNoise:
    """Weights of the voxels: one over the variance that the likelihood gives them.

    ``"poisson"``: variance in proportion to the (detached) model above the dark level, and a floor.
    It needs the dark level and the scale of the image only, both from its histogram; gain cancels.
    A camera that is known replaces both.
    ``"gaussian"``: all alike. ``"paper"``: the measured intensity, as in the paper, which costs
    about three times the photons and shifts the background by one.
    """

    def __init__(
        self,
        measured: Tensor,
        kind: Likelihood,
        floor: float = 0.05,
        camera: Camera | None = None,
    ) -> None:
        self.kind = kind
        sample = measured.reshape(-1)[:: max(1, measured.numel() // 200_000)]
        low, high = (
            float(torch.quantile(sample.to(widest(sample.device)), q)) for q in (0.01, 0.999)
        )
        self.dark = low
        self.floor = max(floor * (high - low), 1e-12 * max(abs(high), 1.0))
        if camera is not None:
            # Its variance, gain (model - offset) + read noise^2, over the gain; a floor below a
            # hundredth of the range would let a few dark voxels outweigh all others.
            self.dark = camera.offset
            self.floor = max(camera.read_noise**2 / camera.gain, self.floor / 5)

    def weights(self, measured: Tensor, model: Tensor | None) -> Tensor:
        """Weights of voxels, given what the model shows there (None: the measured values)."""
        if self.kind == "gaussian":
            return torch.ones_like(measured)
        if self.kind == "paper":
            return (measured - self.dark).clamp(min=0)
        reference = measured if model is None else model
        return self.floor / ((reference - self.dark).clamp(min=0) + self.floor)


def voxel_noise(image: np.ndarray, known: np.ndarray) -> float:
    """Standard deviation of the noise of single voxels.

    From what is left of neighbours along the last axis when their mean is taken away, by the median
    absolute deviation, so that structures do not count.
    """
    left = image[..., 1:-1] - (image[..., :-2] + image[..., 2:]) / 2
    left = left[known[..., 1:-1] & known[..., :-2] & known[..., 2:]]
    return 1.4826 * float(np.median(np.abs(left))) / sqrt(1.5) if left.size else 0.0


def noise_ratio(image: np.ndarray, known: np.ndarray) -> float:
    """Noise of single voxels relative to the range of the image; 0 where nothing is known."""
    if not known.any():
        return 0.0
    low, high = np.percentile(image[known][:: max(1, image.size // 500_000)], (1, 99.9))
    return voxel_noise(image, known) / float(high - low) if high > low else 0.0


def smoothing_for(noise: float) -> float:
    """lambda of the preconditioner for a :func:`noise_ratio`.

    Noise and what no model describes ask for a smooth gradient, fine detail for a rough one: 2 on
    images without noise, 10 from 1 % on (measured on rendered targets and on real vesicles).
    """
    return 2.0 + 8.0 * min(noise / 0.01, 1.0)


def solve_scale(rendered: Tensor, measured: Tensor, weights: Tensor) -> tuple[float, float, bool]:
    """Amplitude and background of the weighted least squares; whether the bound was met.

    A free amplitude turns negative near a bad start, and the mesh then runs away from the membrane:
    it stays above a small positive bound.
    """
    amplitude, background, bounded = scale_on_device(rendered, measured, weights)
    return float(amplitude), float(background), bool(bounded)


def scale_on_device(
    rendered: Tensor, measured: Tensor, weights: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """As :func:`solve_scale`, without waiting for the device: 0-dim tensors there."""
    wide = widest(rendered.device)
    tiny = 1e-300 if wide == torch.float64 else 1e-30
    w, m, y = (t.to(wide) for t in (weights, rendered, measured))
    varies = torch.dot(w, (m - m.mean()) ** 2) > 0
    total = w.sum().clamp(min=tiny)
    m, y = m - torch.dot(w, m) / total, y - torch.dot(w, y) / total
    wm = w * m
    var_m = torch.dot(wm, m).clamp(min=tiny)
    least = 0.05 * torch.sqrt(torch.dot(w * y, y) / var_m)
    amplitude = torch.dot(wm, y) / var_m
    bounded = (amplitude < least) | ~varies
    amplitude = torch.where(varies, torch.maximum(amplitude, least), 0.0)
    means = torch.dot(w, measured.to(wide)), torch.dot(w, rendered.to(wide))
    return amplitude, (means[0] - amplitude * means[1]) / total, bounded


def match(rendered: Tensor, measured: Tensor, weights: Tensor) -> Match:
    """Loss of a rendered image, differentiable in it; all (N,) over the voxels that count.

    Amplitude and background are at their optimum, where their own derivatives vanish, so they are
    held constant in the gradient.
    """
    a, b, bounded = scale_on_device(rendered.detach(), measured, weights)
    measured, weights = measured.to(rendered.dtype), weights.to(rendered.dtype)
    residual = a * rendered + (b - measured)
    total = weights.sum().clamp(min=1e-30)
    centred = measured - torch.dot(weights, measured) / total
    # Above the smallest number of single precision.
    scale = torch.dot(weights, centred**2).clamp(min=1e-30)
    return Match(torch.dot(weights, residual**2) / scale, a, b, bounded)
