"""Insides that are uneven, such as chromatin: the image is made as even as insides are modelled.

The inside of a cell is modelled as evenly bright. Where the image is brighter or dimmer there than
the rendering, beyond noise, the border of the cell would move to make up for it. How bright each
inside is at every place is read from voxels that see hardly anything else, and carried a little
further to its border; measured values are divided by that, and their weights multiplied by its
square. In cells as flat as the PSF is long no voxel does: where brightness clearly varies over a
few widths of the PSF, it is read from those that see most; else what varies is the height.

At the border that is a guess, off by about as much as brightness varies. To the variance of every
voxel is added what that makes of the inside's light there, so that the dim side of the border,
where it is little, decides where the border lies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from ...geometry.gaussian_blur import blurred
from ...geometry.mesh import FloatArray

Image = NDArray[np.floating]  # single precision will do, in half of the memory


@dataclass(frozen=True)
class EveningRules:
    """How uneven brightness is read.

    Attributes
    ----------
    deep
        Share of what a voxel sees that is inside, over the largest near it, from which on it is
        read: nearer to the border it would be read from where the border is off. 0.8 and 0.9 were
        about as good on nuclei of which brightness varies by 0.2 to 0.5 (benchmarks.defaults).
    near
        Widths of the PSF along each axis within which the largest is looked for: as far as a border
        dims what is inside (there, a share of 0.98). With 0.8 of everything, three of eight nuclei
        of 2.5 to 6 slices followed their chromatin (``flat-nuclei``, benchmarks.defaults).
    seen
        That the largest must be at least. Chosen: insides of which less is seen hardly shine.
    broad, chromatin
        Times ``width``: what varies over less, by more than this of the brightness, is read in flat
        cells as well. Measured where fits begin and end (``flat-nuclei``, without what noise adds):
        0.11 to 0.26 in nuclei whose heights followed their chromatin, 0.04 to 0.11 in four whose
        did not; 0.08 and less in even ones as high as a wedge, from a flat start.
    width
        Widths of the PSF over which it is smoothed, and so how far it is carried: 0.7 and 1.5 were
        about as good.
    cut_off
        Standard deviations at which the filter ends: so far that it reaches the border of a cell
        from wherever brightness is read.
    noise
        Times the variance that noise gives it: what exceeds that is believed. Measured with noise
        alone, from 3 to 100 photons: 0.7 to 1.0 times in the mean, 1.4 at most.
    inside
        Of the peak of a membrane's image: an inside that is darker is left as it is, since what is
        uneven there may be the membrane's own light. At 0.3 of it and more, evening it brought
        surfaces 1.1 to 2 times as near (cells with a chromatin of 0.2 and 0.4, a membrane and an
        inside); on vesicles with 0.08 it took them 0.03 to 0.1 voxel further from their ridge.
    trusted
        Of the same peak, above which how much insides vary counts for weights: dim ones look uneven
        beside a membrane that is off. Chosen; in 17 simulated fits of insides it changed hardly
        anything. In real nuclei, which begin with a faint membrane, surfaces wound around grains
        without it.
    least, most
        Of the even brightness: beyond, it is another thing.
    """

    deep: float = 0.8
    near: float = 2.0
    seen: float = 0.2
    width: float = 1.0
    broad: float = 4.0
    chromatin: float = 0.09
    cut_off: float = 6.0
    noise: float = 1.4
    inside: float = 0.2
    trusted: float = 1.0
    least: float = 0.3
    most: float = 3.0


RULES = EveningRules()
# Of the largest sum of weights: where there is less, nothing is near enough to read from, and
# brightness is taken to be even.
_FADES = 1e-3


@dataclass(frozen=True, eq=False)
class Unevenness:
    """How uneven insides are.

    Attributes
    ----------
    gain
        (Z, Y, X) brightness relative to the model.
    variance
        Of that, without what noise adds.
    deep
        (Z, Y, X) bool: the voxels that it was read from.
    """

    gain: Image
    variance: float
    deep: NDArray[np.bool_]

    def weights(self, weights: FloatArray, shown: Image, noise: Image) -> FloatArray:
        """(N,) of evened voxels whose insides are known as well as they vary.

        Parameters
        ----------
        weights
            (N,) as before: one over variances, of any unit.
        shown
            (N,) light of the insides in the model.
        noise
            (N,) as large as the noise of each voxel in the mean.
        """
        unit = max(float(np.mean(noise**2 * weights)), 1e-300)
        further = self.variance * shown**2 / unit
        return weights / (1 + weights * further)


def deepest(share: Image, widths: FloatArray) -> NDArray[np.bool_]:
    """Voxels that see more of an inside than those near them do, and some of it.

    All (Z, Y, X); widths : (3,) of the PSF, voxels. In a cell as flat as the PSF is long, no voxel
    sees an inside alone.
    """
    reach = np.ceil(RULES.near * widths).astype(int)
    deep = np.zeros(share.shape, bool)
    some = np.argwhere(share > RULES.deep * RULES.seen)
    if not len(some):
        return deep
    ends = zip(some.min(0) - reach, some.max(0) + reach + 1, strict=True)
    box = tuple(slice(max(0, low), high) for low, high in ends)
    most = maximum_filter(share[box], tuple(2 * reach + 1))
    deep[box] = (share[box] > RULES.deep * most) & (most > RULES.seen)
    return deep


def unevenness(
    insides: Image,
    shown: Image,
    share: Image,
    noise: Image,
    widths: FloatArray,
    counted: NDArray[np.bool_],
    flat: bool = False,
) -> Unevenness | None:
    """Brightness of insides relative to the model; None where noise explains it.

    Parameters
    ----------
    insides
        (Z, Y, X) measured, without membranes and background.
    shown
        The same as modelled.
    share
        Share of what each voxel sees that is inside.
    noise
        As large as the noise of each voxel in the mean.
    widths
        (3,) of the PSF, voxels.
    counted
        (Z, Y, X) bool: where the image tells anything.
    flat
        Whether cells are as flat as the PSF is long.
    """
    alone = (share > RULES.deep) & counted
    deep = deepest(share, widths) & counted if flat else alone
    found = _read(insides, shown, noise, deep, widths) if flat else None
    # Else, what varies in flat cells is their height.
    if found is None or found.varies_finely() <= RULES.chromatin**2:
        deep, found = alone, _read(insides, shown, noise, alone, widths)
    if found is None:
        return None
    variance = float(np.var(found.ratio[deep], dtype=np.float64))
    believed = 1 - RULES.noise * found.by_noise / max(variance, 1e-300)
    if believed <= 0:
        return None
    gain = np.clip(1 + believed * (found.ratio - 1), RULES.least, RULES.most)
    return Unevenness(gain, believed * variance, deep)


@dataclass(frozen=True, eq=False)
class _Read:
    """Brightness over the model, and what noise makes its variance.

    broad : the same, smoothed as widely as takes most of the time; made where it is asked for.
    """

    ratio: Image
    by_noise: float
    deep: NDArray[np.bool_]
    broad: Callable[[], Image]

    def varies_finely(self) -> float:
        """Variance of what is not as broad, without what noise makes of it."""
        fine = self.ratio / np.maximum(self.broad(), RULES.least)
        return float(np.var(fine[self.deep], dtype=np.float64)) - self.by_noise


def _read(
    insides: Image,
    shown: Image,
    noise: Image,
    deep: NDArray[np.bool_],
    widths: FloatArray,
) -> _Read | None:
    """What these voxels tell; arguments as for :func:`unevenness`. None if there are none."""
    if not deep.any():
        return None
    size = RULES.width * widths

    def smooth(image: Image, times: float = 1.0) -> NDArray[np.float32]:
        of_deep = np.where(deep, image, np.float32(0))
        return blurred(of_deep, (times * size).tolist(), RULES.cut_off)

    own, model = smooth(insides), smooth(shown)
    faint = _FADES * float(model.max())
    if faint <= 0:
        return None
    ratio = (own + faint) / (model + faint)

    def broad() -> Image:
        return (smooth(insides, RULES.broad) + faint) / (smooth(shown, RULES.broad) + faint)

    # Of a sum of independent voxels under a Gaussian filter; in places, as dim cells are noisier
    # beside bright ones.
    independent = float(np.prod(2 * np.sqrt(np.pi) * size))
    summed = smooth(noise**2, 0.5**0.5) / independent
    by_noise = float(np.mean((summed / (model + faint) ** 2)[deep], dtype=np.float64))
    return _Read(ratio, by_noise, deep, broad)
