"""Insides that are uneven, such as chromatin: the image is made as even as insides are modelled.

The inside of a cell is modelled as evenly bright. Where the image is brighter or dimmer there than
the rendering, beyond noise, the border of the cell would move to make up for it. How bright each
inside is at every place is read from voxels that see nothing else, and carried a little further to
its border; measured values are divided by that, and their weights multiplied by its square.

At the border that is a guess, off by about as much as brightness varies. To the variance of every
voxel is added what that makes of the inside's light there, so that the dim side of the border,
where it is little, decides where the border lies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter

from ..geometry.mesh import FloatArray


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
        Widths of the PSF within which the largest is looked for: as far as a border dims what is
        inside (2 of them, a share of 0.98). With 0.8 of everything, the surfaces of three of eight
        nuclei of 2.5 to 6 slices followed their chromatin (1.5 voxels off, then 0.4).
    seen
        That share at least: chosen, a quarter of what makes a voxel one of the inside elsewhere.
    width
        Widths of the PSF over which it is smoothed, and so how far it is carried: 0.7 and 1.5 were
        about as good.
    cut_off
        Standard deviations at which the filter ends: so far that it reaches the border of a cell
        from wherever brightness is read.
    noise
        Times the variance that noise gives it: what exceeds that is believed.
    inside
        Of the peak of a membrane's image: an inside that is darker is left as it is, since what is
        uneven there may be the membrane's own light. At 0.3 of it and more, evening it brought
        surfaces 1.1 to 2 times as near (cells with a chromatin of 0.2 and 0.4, a membrane and an
        inside); on vesicles with 0.08 it took them 0.03 to 0.1 voxel further from their ridge.
    trusted
        Of the same peak, above which how much insides vary counts for weights: dim ones look uneven
        beside a membrane that is off. Chosen. With 1, 15 simulated fits of both end as without;
        real nuclei no longer wind around their grains before membranes have left the model.
    least, most
        Of the even brightness: beyond, it is another thing.
    """

    deep: float = 0.8
    near: float = 2.0
    seen: float = 0.2
    width: float = 1.0
    cut_off: float = 6.0
    noise: float = 2.0
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
    """

    gain: FloatArray
    variance: float

    def weights(self, weights: FloatArray, shown: FloatArray, noise: FloatArray) -> FloatArray:
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


def deep_inside(share: FloatArray, widths: FloatArray) -> NDArray[np.bool_]:
    """Voxels that tell how bright an inside is; all (Z, Y, X), widths (3,) of the PSF, voxels.

    Of those near a voxel, the ones that see most: in a cell as flat as the PSF is long, none sees
    an inside alone. Were its brightness not read there, its height would follow it.
    """
    near = 2 * np.ceil(RULES.near * widths).astype(int) + 1
    most = maximum_filter(share, tuple(near))
    return np.asarray((share > RULES.deep * most) & (most > RULES.seen))


def unevenness(
    insides: FloatArray,
    shown: FloatArray,
    share: FloatArray,
    noise: FloatArray,
    widths: FloatArray,
) -> Unevenness | None:
    """Brightness of insides relative to the model; None where noise explains it.

    Parameters
    ----------
    insides
        (Z, Y, X) measured, without membranes and background.
    shown
        The same as modelled.
    share
        Share of what each voxel sees that is inside; 0 where it does not count.
    noise
        As large as the noise of each voxel in the mean.
    widths
        (3,) of the PSF, voxels.
    """
    deep = deep_inside(share, widths)
    if not deep.any():
        return None
    size = RULES.width * widths
    sums = (np.where(deep, image, 0.0) for image in (insides, shown))
    own, model = (gaussian_filter(s, size, truncate=RULES.cut_off) for s in sums)
    faint = _FADES * float(model.max())
    if faint <= 0:
        return None
    found = (own + faint) / (model + faint)
    # Of the mean of independent voxels under a Gaussian filter: one voxel's variance over this.
    independent = float(np.prod(2 * np.sqrt(np.pi) * size))
    # In places, as dim cells are noisier beside bright ones.
    by_noise = float(np.mean((noise[deep] / np.maximum(shown[deep], faint)) ** 2)) / independent
    variance = float(np.var(found[deep]))
    believed = 1 - RULES.noise * by_noise / max(variance, 1e-300)
    if believed <= 0:
        return None
    gain = np.clip(1 + believed * (found - 1), RULES.least, RULES.most)
    return Unevenness(gain, believed * variance)
