"""How well a rendered image explains a measured one; amplitude and background are solved for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
import torch
from torch import Tensor

from ...common.choices import Likelihood
from ...common.normal import MEDIAN_SQUARE, SIGMA_PER_MEDIAN_DEVIATION
from ...fourier.devices import widest
from ...fourier.explain import explain
from ...fourier.explain import products as compiled_products
from ...fourier.real_fft import compiled
from ...geometry.mesh import FloatArray
from ...scene.effects import DetectorEffect

_BLOCK = 4096  # values that are added up in one go, so that each sum stays in the cache
_EVEN = 1e-14  # of squares, by definition: what columns vary by less is the rounding of their sums


@dataclass(frozen=True)
class Match:
    """Measured = amplitude * rendered + background, over the voxels that count.

    ``squares`` is the weighted sum of squared residuals, ``loss`` the same relative to the weighted
    variance of the measured voxels, so that 1 means that nothing is explained.
    """

    squares: float
    loss: float
    amplitude: float
    background: float
    bounded: bool


@dataclass(frozen=True)
class LikelihoodRules:
    """What weighs voxels, and how dim a rendering may be made.

    Attributes
    ----------
    floor
        Of the range of an image, the least variance: so that dark voxels, where the model is least
        right, do not decide. Measured: half and twice move surfaces by 0.01 voxel, a cluster's by
        0.06.
    low, high
        Quantiles that are the range: single dark or hot voxels would be otherwise.
    least
        Amplitude, of the ratio of the standard deviations of measured and rendered image: a free
        one turns negative near a bad start, and the mesh then runs away from the membrane.
    """

    floor: float = 0.05
    low: float = 0.01
    high: float = 0.999
    least: float = 0.05


RULES = LikelihoodRules()


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
        camera: DetectorEffect | None = None,
    ) -> None:
        self.kind = kind
        sample = measured.reshape(-1)[:: max(1, measured.numel() // 200_000)]
        ends = RULES.low, RULES.high
        low, high = (float(torch.quantile(sample.to(widest(sample.device)), q)) for q in ends)
        self.dark = low
        self.floor = max(RULES.floor * (high - low), 1e-12 * max(abs(high), 1.0))
        if camera is not None:
            # Its variance, gain (model - offset) + read noise^2, over the gain; a floor below a
            # hundredth of the range would let a few dark voxels outweigh all others.
            self.dark = camera.offset
            self.floor = max(camera.read_noise**2 / camera.gain, self.floor / 5)

    def weights(
        self,
        measured: Tensor,
        expected: Tensor | None = None,
        residual: Tensor | None = None,
        noise: Tensor | None = None,
        whole: Tensor | None = None,
    ) -> Tensor:
        """Weights of voxels, all (N,).

        Where a model leaves more than noise, its error and not the light decides how far a voxel
        can be trusted, and that is alike everywhere: real stacks are then weighted almost evenly.

        Parameters
        ----------
        measured
            Values.
        expected
            What the model shows there.
        residual
            Measured minus expected.
        noise
            Single draws of about the noise of each voxel.
        whole
            Which of them tell how large noise and errors are; all, if not given.
        """
        if self.kind == "gaussian":
            return torch.ones_like(measured)
        if self.kind == "paper":
            return (measured - self.dark).clamp(min=0)
        light = ((measured if expected is None else expected) - self.dark).clamp(min=0)
        floor = self.floor
        if residual is not None and noise is not None:
            variance = light + floor
            if whole is not None:
                variance, residual, noise = variance[whole], residual[whole], noise[whole]
            gain = float(torch.median(noise**2 / variance)) / MEDIAN_SQUARE
            count = max(len(residual), 1)
            error = float(total(residual**2) - gain * total(variance)) / count
            # What is beyond the range of the image changes no weight.
            floor += min(max(error, 0.0) / max(gain, 1e-300), 1e3 * float(variance.max()))
        return floor / (light + floor)


def voxel_noise(image: np.ndarray, known: np.ndarray) -> float:
    """Standard deviation of the noise of single voxels.

    From what is left of neighbours along the last axis when their mean is taken away, by the median
    absolute deviation, so that structures do not count.
    """
    left = image[..., 1:-1] - (image[..., :-2] + image[..., 2:]) / 2
    left = left[known[..., 1:-1] & known[..., :-2] & known[..., 2:]]
    if not left.size:
        return 0.0
    own = sqrt(1.5)  # of a voxel and a quarter of each of two others, by definition
    return SIGMA_PER_MEDIAN_DEVIATION * float(np.median(np.abs(left))) / own


def noise_ratio(image: np.ndarray, known: np.ndarray) -> float:
    """Noise of single voxels relative to the range of the image; 0 where nothing is known."""
    if not known.any():
        return 0.0
    ends = 100 * RULES.low, 100 * RULES.high
    low, high = np.percentile(image[known][:: max(1, image.size // 500_000)], ends)
    return voxel_noise(image, known) / float(high - low) if high > low else 0.0


def total(values: Tensor) -> Tensor:
    """The sum of values (N,), to the same bits on every number of threads.

    Blocks are summed on their own and their sums in turn; a sum or a dot product over all is cut
    where threads meet. On a GPU one plain sum is taken: it
    is cut the same way every time, and each further sum is another launch.
    """
    whole = values.numel() - values.numel() % _BLOCK
    if not whole or values.device.type != "cpu":
        return values.sum()
    return total(values[:whole].view(-1, _BLOCK).sum(1)) + values[whole:].sum()


def products(columns: Sequence[Tensor], weights: Tensor) -> FloatArray:
    """(K, K) weighted products of columns, each with each; all (N,).

    To the same bits on every number of threads; compiled where that can be had.
    """
    if len(weights) and compiled(weights.device):
        found: FloatArray = compiled_products(columns, weights)
        return found
    wide = widest(weights.device)
    each = torch.stack([column.to(wide) for column in columns])
    return _products(each, weights.to(wide)).cpu().numpy().astype(np.float64)


def _products(rows: Tensor, weights: Tensor) -> Tensor:
    """(K, K) of rows (K, N)."""
    return torch.stack([_totals(weights * row * rows) for row in rows])


def _totals(rows: Tensor) -> Tensor:
    """(K,) sums of rows (K, N); see :func:`total`."""
    return torch.stack([total(row) for row in rows]) if rows.device.type == "cpu" else rows.sum(1)


def _moments(columns: Sequence[Tensor], weights: Tensor, tiny: float) -> tuple[Tensor, Tensor]:
    """(K, K) weighted products of columns less their weighted means, and those (K,)."""
    if len(weights) and compiled(weights.device):
        # Less what the voxel that weighs most holds, or a large mean would cost digits.
        heaviest = int(weights.numpy().argmax())
        level = [float(column[heaviest]) for column in columns]
        given = [*columns, torch.ones_like(weights)]
        found = compiled_products(given, weights, [*level, 0.0])
        sums, held = found[-1, :-1], max(found[-1, -1], tiny)
        moments = found[:-1, :-1] - np.outer(sums / held, sums)
        even = np.diag(moments) < _EVEN * np.diag(found)[:-1]
        moments[even] = moments[:, even] = 0.0
        return torch.from_numpy(moments), torch.from_numpy(np.array(level) + sums / held)
    wide = widest(weights.device)
    w, rows = weights.to(wide), torch.stack([column.to(wide) for column in columns])
    means = _totals(w * rows) / total(w).clamp(min=tiny)
    return _products(rows - means[:, None], w), means


def centred_products(columns: Sequence[Tensor], weights: Tensor) -> FloatArray:
    """Like :func:`products`, after the weighted means of columns are subtracted."""
    moments, _ = _moments(columns, weights, 1e-30)
    return moments.cpu().numpy().astype(np.float64)


def solve_scale(rendered: Tensor, measured: Tensor, weights: Tensor) -> tuple[float, float, bool]:
    """Amplitude and background of the weighted least squares; whether the bound was met.

    A free amplitude turns negative near a bad start, and the mesh then runs away from the membrane:
    it stays above a small positive bound.
    """
    amplitude, background, bounded, _ = _scale(rendered, measured, weights).tolist()
    return amplitude, background, bool(bounded)


def _scale(rendered: Tensor, measured: Tensor, weights: Tensor) -> Tensor:
    """(4,) as :func:`solve_scale`, on the device; and weighted squares of what was measured, less
    its weighted mean."""
    wide = widest(rendered.device)
    tiny = 1e-300 if wide == torch.float64 else 1e-30
    moments, (mean_m, mean_y) = _moments([rendered, measured], weights, tiny)
    (squares, shared), (_, var_y) = moments
    varies, var_m = squares > 0, squares.clamp(min=tiny)
    least = RULES.least * torch.sqrt(var_y / var_m)
    amplitude = shared / var_m
    bounded = (amplitude < least) | ~varies
    amplitude = torch.where(varies, torch.maximum(amplitude, least), 0.0)
    return torch.stack([amplitude, mean_y - amplitude * mean_m, bounded.to(wide), var_y])


def match(rendered: Tensor, measured: Tensor, weights: Tensor) -> tuple[Tensor, Match]:
    """Weighted squared residuals, differentiable in the rendered image; all (N,) voxels that count.

    Amplitude and background are at their optimum, where their own derivatives vanish, so they are
    held constant in the gradient. Sums are in double precision where the device holds it.
    """
    found = _scale(rendered.detach(), measured, weights)
    wide = widest(rendered.device)
    y, w = measured.to(wide), weights.to(wide)
    residual = found[0] * rendered.to(wide) + (found[1] - y)
    squares = total(w * residual**2)
    told = torch.cat([squares.detach()[None], found])
    value, amplitude, background, bound, scale = told.tolist()
    # Above the smallest number of single precision.
    return squares, Match(value, value / max(scale, 1e-30), amplitude, background, bool(bound))


def explained(
    image: Tensor, index: Tensor, measured: Tensor, weights: Tensor
) -> tuple[Tensor, Match]:
    """Like :func:`match`, for some voxels of a rendered image; compiled where possible.

    Parameters
    ----------
    image
        Rendered, any shape.
    index
        (N,) flat indices of the voxels that count, each once and in order.
    measured, weights
        (N,) of these voxels.
    """
    singles = measured.dtype == weights.dtype == torch.float32
    if singles and len(index) and compiled(image.device):
        squares, told = explain(image, index, measured, weights, RULES.least)
        return squares, Match(*told)
    # Unlike indexing, whose gradient sorts, since an index might come twice.
    values = image.to(index.device).reshape(-1).index_select(0, index)
    return match(values, measured, weights)
