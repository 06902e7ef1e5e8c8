"""The ball around a point that is brighter than its surroundings, where nothing else is found.

In noise and haze, a threshold may not separate a cell from its surroundings; a mean over a ball
does. As in a scale space (T. Lindeberg, Int. J. Comput. Vis. 30, 1998), each radius is asked how
much brighter the ball is than a shell of the same volume around it. The middle stays the point:
from beside the middle of a cell, the ball is too large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from skimage.transform import downscale_local_mean

from ...common.triple import geometric_mean
from ..mesh import FloatArray, IntArray


@dataclass(frozen=True)
class BallRules:
    """Thresholds that decide whether a ball is brighter than its surroundings.

    Attributes
    ----------
    smallest
        The first radius, in sides of a voxel. Chosen: a ball has at least 33 voxels.
    errors
        Standard errors by which it must be brighter. Chosen: more than five, as noise is alike in
        voxels nearby. Measured: 24 and 203 in two simulated nuclei at which nothing else was found,
        one of which cannot be seen in single slices.
    half
        Share of the difference of ball and shell by which all smaller balls must be brighter than
        the shell, too, within ``sure`` errors: else the light is beside the point, as between two
        nuclei. Chosen.
    span
        By how much it must be brighter, as a share of the span of the means over cubes of its
        volume in the image, less each slice's median: else it may be something's halo. Measured at
        96 random places of five real images where nothing else was found: 14 had a ball, with 0.02
        to 0.45; 0.80 and 0.83 in those two nuclei.
    sure
        Standard errors taken off a difference before radii are compared. Chosen: with few voxels a
        large difference is chance.
    most
        About how many voxels are used: larger surroundings are sampled along each axis. Chosen.
    """

    smallest: float = 2.0
    errors: float = 10.0
    half: float = 0.5
    span: float = 0.5
    sure: float = 3.0
    most: int = 1_000_000


RULES = BallRules()
# Radii grow by 2^(1/6), chosen; by definition, the volume is twice as large after two steps.
_STEPS, _TWICE = 6, 2
_IN_A_CUBE = 4  # blocks along each side whose means are looked at; chosen
# By definition: the side of a cube as large as a ball of radius 1.
_CUBE = (4 * np.pi / 3) ** (1 / 3)


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball around a point, compared with a shell around it of the same volume.

    Attributes
    ----------
    radius
        um.
    brighter, error
        By how much it is brighter than the shell, and the standard error of that.
    clear
        Whether all smaller ones are bright, too.
    """

    radius: float
    brighter: float
    error: float
    clear: bool

    @property
    def surely(self) -> float:
        """How much brighter the ball is, less ``RULES.sure`` standard errors."""
        return self.brighter - RULES.sure * self.error


def bright_ball(data: FloatArray, size: FloatArray, voxel: IntArray) -> Ball | None:
    """Find the ball around a voxel that is brightest beside its shell; None if none surely is.

    Parameters
    ----------
    data : (Z, Y, X).
    size : (3,) um, sides of a voxel.
    voxel : (3,) index of the middle.
    """
    # Stacks of cells may be flat.
    largest = float(np.sort(np.multiply(data.shape, size))[1]) / 2
    balls = _balls(data, size, voxel, largest)
    if not balls:
        return None
    best = max(balls, key=lambda ball: ball.surely)
    # The largest radius may be part of something larger: light that rises towards the point.
    sure = best.brighter > RULES.errors * best.error
    return best if sure and best.clear and best is not balls[-1] else None


def stands_out(data: FloatArray, size: FloatArray, ball: Ball) -> bool:
    """Whether a ball is bright for its image: else it may be the halo of something else."""
    sides = np.maximum(np.rint(_CUBE * ball.radius / size).astype(int), 1)
    every = np.clip(sides // _IN_A_CUBE, 1, data.shape)
    whole = tuple(
        slice(0, n - n % step) for n, step in zip(data.shape, every.tolist(), strict=True)
    )
    blocks = downscale_local_mean(data[whole], tuple(every.tolist()))
    means = uniform_filter(blocks, np.maximum(sides // every, 1).tolist(), mode="nearest")
    means -= np.median(means, axis=(1, 2), keepdims=True)  # light that fades with depth
    return bool(ball.brighter >= RULES.span * np.ptp(means))


def ball_at(
    shape: tuple[int, ...], size: FloatArray, voxel: IntArray, radius: float
) -> tuple[tuple[slice, ...], NDArray[np.bool_]]:
    """Return the box around a ball, and a mask of the ball in that box."""
    box, far = squares(shape, size, voxel, radius)
    return box, far <= radius**2


def _balls(data: FloatArray, size: FloatArray, voxel: IntArray, largest: float) -> list[Ball]:
    """Measure balls of all radii below ``largest``, by sums over shells one radius step thick."""
    first = RULES.smallest * geometric_mean(size)
    if largest <= first:
        return []
    count = 1 + int(_STEPS * np.log2(largest / first))
    reach = first * 2 ** ((count + _TWICE) / _STEPS)
    box, far = squares(data.shape, size, voxel, reach, RULES.most)
    values, far = data[box].ravel(), far.ravel()
    log = _STEPS / 2 * np.log2(np.maximum(far / first**2, 1e-30))  # steps beyond the first radius
    shell = np.clip(np.ceil(log).astype(int), 0, count + _TWICE)
    sums = [np.bincount(shell, w, count + _TWICE + 1) for w in (None, values, values**2)]
    upto = np.cumsum(np.array(sums, float), axis=1)
    inner: list[tuple[FloatArray, FloatArray]] = []
    found = []
    for k in range(count):
        around = upto[:, k + _TWICE] - upto[:, k]
        if around[0] < 2 or not upto[0, k]:
            continue
        (mean, error), (dark, beyond) = mean_of(upto[:, k]), mean_of(around)
        least = dark + RULES.half * (mean - dark)
        clear = all(core + RULES.sure * chance > least for core, chance in inner)
        radius = first * 2 ** (k / _STEPS)
        found.append(Ball(radius, float(mean - dark), float(np.hypot(error, beyond)), clear))
        inner.append((mean, error))
    return found


def mean_of(sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means and their standard errors, from numbers, sums and sums of squares of values."""
    n, total, squared = np.maximum(sums[0], 1e-30), sums[1], sums[2]
    mean = total / n
    return mean, np.sqrt(np.maximum(squared / n - mean**2, 0.0) / n)


def squares(
    shape: tuple[int, ...],
    size: FloatArray,
    voxel: IntArray,
    radius: float,
    most: int | None = None,
) -> tuple[tuple[slice, ...], FloatArray]:
    """Return the box around a ball, and in it the squared distances to its middle, um^2.

    most : about how many voxels to use; a larger box is sampled along each axis.
    """
    reach = np.ceil(radius / size).astype(int)
    low, high = np.maximum(voxel - reach, 0), np.minimum(voxel + reach + 1, shape)
    every = 1 if most is None else max(int(np.cbrt(np.prod((high - low).astype(float)) / most)), 1)
    box = tuple(slice(*ends, every) for ends in zip(low.tolist(), high.tolist(), strict=True))
    places = np.ix_(*(np.arange(one.start, one.stop, every) for one in box))
    far: FloatArray = sum(
        ((place - middle) * side) ** 2
        for place, middle, side in zip(places, voxel.tolist(), size.tolist(), strict=True)
    )
    return box, far
