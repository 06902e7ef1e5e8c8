"""The hollow ball around a point: a shell that is brighter than what is in it and beyond it.

In noise, where a membrane is uneven, or dim beside others, no level closes around a point; a mean
over a whole shell still stands out. It is a Hough transform for spheres (P. V. C. Hough, US patent
3,069,654, 1962) near one point: of all radii, and of middles around the point, the one whose shell
stands out most. Cells that are no balls blur the shell, which the octants make up for: a membrane
shows to all sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.triple import geometric_mean
from ..mesh import FloatArray, IntArray
from .bright_ball import mean_of, squares


@dataclass(frozen=True)
class HollowRules:
    """Thresholds that decide whether there is a hollow ball.

    Attributes
    ----------
    errors, octants
        Standard errors by which the shell must be brighter, and octants in which it is. Measured
        on 70 random scenes (``--anything`` of benchmarks.defaults), in which most cells need no
        ball: it is found in 38 % of all from a point in their middle, in 27 % from half a radius
        beside it, with 0.81 to 1.05 of their radius, and at none of 1358 points in no cell.
    hopeful
        Standard errors around the point, from which on the middle is looked for. Chosen.
    shows
        Of the mean difference, by which the shell of an octant must be brighter. Chosen.
    sure
        Standard errors taken off a difference before shells are compared. Chosen: of few voxels, a
        large one is chance.
    whole
        Share of the shell that must lie in the image. Chosen.
    near
        How far its middle may be from the point, in radii. Chosen: the point lies in it.
    most
        Voxels that are looked at, about: of larger surroundings, some of each axis. Chosen.
    """

    errors: float = 5.0
    octants: int = 7
    hopeful: float = 1.0
    shows: float = 0.3
    sure: float = 3.0
    whole: float = 0.7
    near: float = 0.8
    most: int = 1_000_000


RULES = HollowRules()
# Radii grow by 2^(1/6) from the side of a voxel; shells and the gap beyond them, in such steps.
# Chosen: a shell is a quarter of its radius thick, which cells that are no balls need.
_STEPS, _THICK, _GAP, _BEYOND = 6, 2, 1, 2
_AT_ONCE = 12  # steps of the radius that are looked at together: a factor of 4; chosen
_NEAR = 4  # steps up and down in radius when the middle moves; chosen
_PARTS = 4, 8  # of a radius, by which the middle moves; chosen
_MOVES = 6  # of each; chosen, more than were needed
_OCTANTS = 8  # exact
_APART = 3  # voxels; chosen: noise is seldom blurred as far
_POWER = 1.63  # by calculation, see `_blur`
_FEWEST = 3, 6  # voxels inside, and of a shell; chosen


@dataclass(frozen=True, eq=False)
class HollowBall:
    """A hollow ball around a voxel.

    Attributes
    ----------
    middle
        (3,) voxel.
    radius
        um, of the middle of the shell.
    step
        Number of the radius.
    surely
        By how much the shell is brighter than what is in it and beyond it, the lesser of the two,
        chance aside.
    errors
        The lesser of these differences in standard errors.
    octants
        In which it is brighter.
    """

    middle: IntArray
    radius: float
    step: int
    surely: float
    errors: float
    octants: int


def hollow_ball(
    data: FloatArray, size: FloatArray, voxel: IntArray, closed: bool = False
) -> HollowBall | None:
    """Find the hollow ball that a voxel lies in; None if none surely shows.

    Parameters
    ----------
    data : (Z, Y, X).
    size : (3,) um, sides of a voxel.
    voxel : (3,) index.
    closed : whether a region is closed around it, if only a small one: that it rises above the
        noise is then known, and how blurred the noise is does not matter. In small images of clear
        cells, their own brightness looks like blurred noise. Measured at 16 such points of 120
        random scenes (``--anything`` of benchmarks.defaults): found at seven, each in a cell, with
        0.85 to 0.92 of its radius; at four otherwise.
    """
    # Stacks of cells may be flat.
    largest = float(np.sort(np.multiply(data.shape, size))[1]) / 2 / geometric_mean(size)
    radii = range(_THICK, 1 + int(_STEPS * np.log2(max(largest, 1))))
    best = _best(data, size, voxel, radii)
    blur = 1.0 if closed else _blur(data, voxel)
    if best is None or best.errors < RULES.hopeful * blur:
        return None
    for part in _PARTS:
        for _ in range(_MOVES):
            here, best = best, _moved(data, size, voxel, best, part, radii)
            if best is here:
                break
    sure = best.errors > RULES.errors * blur and best.octants >= RULES.octants
    return best if sure else None


def _blur(data: FloatArray, voxel: IntArray) -> float:
    """Return by which factor the errors of means exceed those of noise independent in each voxel.

    About, from second differences along X of neighbours and of voxels three apart, as the median of
    their magnitudes hardly sees membranes. Exact within a few percent, by calculation, for noise
    that was smoothed with a Gaussian of one or two voxels (7 and 19 times).
    """
    reach = round(RULES.most ** (1 / 3) / 2)
    x = data[tuple(slice(max(v - reach, 0), v + reach) for v in voxel.tolist())].astype(float)
    if x.shape[2] <= 2 * _APART:
        return 1.0
    near, far = (
        float(np.median(np.abs(x[..., : -2 * n] - 2 * x[..., n:-n] + x[..., 2 * n :])))
        for n in (1, _APART)
    )
    return max(far / near, 1.0) ** _POWER if near > 0 else 1.0


def _moved(
    data: FloatArray, size: FloatArray, voxel: IntArray, best: HollowBall, part: int, radii: range
) -> HollowBall:
    """Return the best hollow ball of those a part of a radius beside ``best``, or that itself."""
    near = range(max(best.step - _NEAR, radii.start), min(best.step + _NEAR + 1, radii.stop))
    step = np.maximum(np.rint(best.radius / part / size).astype(int), 1)
    start = best.middle
    for axis in range(3):
        for sign in (-1, 1):
            middle = start.copy()
            middle[axis] += sign * step[axis]
            if not 0 <= middle[axis] < data.shape[axis]:
                continue
            one = _best(data, size, middle, near)
            if one is None or one.surely <= best.surely:
                continue
            if np.linalg.norm((middle - voxel) * size) < RULES.near * one.radius:
                best = one
    return best


def _best(data: FloatArray, size: FloatArray, middle: IntArray, radii: range) -> HollowBall | None:
    """Return the hollow ball around a voxel whose shell stands out most, of some radii."""
    balls = []
    for first in range(radii.start, radii.stop, _AT_ONCE):
        together = range(first, min(first + _AT_ONCE, radii.stop))
        balls += _balls(data, size, middle, together)
    return max(balls, key=lambda ball: ball.surely, default=None)


def _balls(data: FloatArray, size: FloatArray, middle: IntArray, radii: range) -> list[HollowBall]:
    """Return hollow balls of some radii around a voxel, if enough of them lies in the image."""
    side = geometric_mean(size)
    last = radii.stop + _GAP + _BEYOND
    upto, each = _sums(data, size, middle, side, last)
    balls = []
    for k in radii:
        inner, outer = k - _THICK, k + _GAP
        core, shell = upto[:, inner], upto[:, k] - upto[:, inner]
        beyond = upto[:, outer + _BEYOND] - upto[:, outer]
        counts = [part[0].sum() for part in (core, shell, beyond)]
        ends = (2.0 ** (n / _STEPS) for n in (k, inner))
        full = 4 / 3 * np.pi * float(np.subtract(*(r**3 for r in ends))) / each
        if counts[0] < _FEWEST[0] or min(counts[1:]) < _FEWEST[1] or counts[1] < RULES.whole * full:
            continue
        (dark, e), (bright, f), (far, g) = (mean_of(part.sum(1)) for part in (core, shell, beyond))
        rise, fall = bright - dark, bright - far
        errors = [max(float(np.hypot(*pair)), 1e-30) for pair in ((e, f), (f, g))]
        shells, beyonds = mean_of(shell)[0], mean_of(beyond)[0]
        shows = (shells > dark + RULES.shows * rise) & (shells > beyonds + RULES.shows * fall)
        balls.append(
            HollowBall(
                middle,
                side * 2 ** ((k - _THICK / 2) / _STEPS),
                k,
                float(min(rise - RULES.sure * errors[0], fall - RULES.sure * errors[1])),
                float(min(rise / errors[0], fall / errors[1])),
                int((shows & (np.minimum(core[0], np.minimum(shell[0], beyond[0])) > 0)).sum()),
            )
        )
    return balls


def _sums(
    data: FloatArray, size: FloatArray, middle: IntArray, side: float, last: int
) -> tuple[FloatArray, int]:
    """Return (3, steps, octants) number, sum and sum of squares of the voxels up to each radius.

    Only one in several voxels counts; the second result says one in how many.
    """
    box, far = squares(data.shape, size, middle, side * 2 ** (last / _STEPS), RULES.most)
    values = data[box].astype(float).ravel()
    log = _STEPS / 2 * np.log2(np.maximum(far / side**2, 1e-30))  # steps beyond the first radius
    shell = np.clip(np.ceil(log).astype(int), 0, last + 1)
    places = (np.arange(one.start, one.stop, one.step) for one in box)
    sides = zip(np.ix_(*places), middle.tolist(), strict=True)
    octant = sum((place >= at).astype(int) << n for n, (place, at) in enumerate(sides))
    key, length = (shell * _OCTANTS + octant).ravel(), (last + 2) * _OCTANTS
    sums = [np.bincount(key, w, length) for w in (None, values, values**2)]
    return np.cumsum(np.array(sums, float).reshape(3, -1, _OCTANTS), axis=1), box[0].step ** 3
