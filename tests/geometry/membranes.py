"""Images of membranes for the tests of seeds."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
SIZE = np.array([0.3, 0.15, 0.15])
SHAPE = (34, 64, 64)


def coordinates(shape: tuple[int, ...] = SHAPE) -> Float:
    return np.stack(np.indices(shape), axis=-1) * SIZE


def ball(center: tuple[float, ...], radius: float) -> Float:
    """Signed distance, negative inside."""
    return np.linalg.norm(coordinates() - center, axis=-1) - radius


def sausage(points: Float, radius: float) -> Float:
    """Signed distance to a tube around a polyline."""
    x = coordinates()
    best = np.full(SHAPE, np.inf)
    for a, b in pairwise(points):
        t = np.clip(((x - a) @ (b - a)) / ((b - a) @ (b - a)), 0, 1)
        best = np.minimum(best, np.linalg.norm(x - a - t[..., None] * (b - a), axis=-1))
    return best - radius


def membrane(
    distance: Float, brightness: Float | float = 1000.0, haze: float = 0.0, width: float = 0.2
) -> Float:
    """A blurred shell; `haze` is added inside."""
    return brightness * np.exp(-0.5 * (distance / width) ** 2) + haze * (distance < 0)


def noisy(image: Float, noise: float = 30.0) -> Float:
    return image + 100 + np.random.default_rng(0).normal(0, noise, image.shape)


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    return float((a & b).sum() / (a | b).sum())


CENTER = (5.0, 4.7, 4.8)
