"""Whether the background of an image rises from side to side, found before any fit.

A fit with the effect ``background`` finds it, too, but only once its shapes are close: surfaces
that are brighter on one side would drift there. So it is read from the darkest voxels of blocks all
over the image, of whose variation a plane or a curved surface must explain nearly all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..common.normal import SIGMA_PER_MEDIAN_DEVIATION
from ..runs.settings import SceneSettings
from ..scene.effects.smooth import Background

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class GroundRules:
    """How the background is read, and when it counts as uneven.

    Attributes
    ----------
    blocks
        Blocks along each axis, of at least three voxels. Chosen, not measured.
    smoothed
        Width of the blur before, voxels: otherwise the darkest voxels would show only noise.
        Chosen.
    dark
        Quantile of a block that is taken as its background, since cells fill most of some blocks.
    brighter
        Standard deviations by which blocks may lie above the others: cells fill those beyond.
        Chosen, not measured.
    fewest
        Share of the blocks that must remain, and of a block that must be known. Chosen.
    explained
        Share of their variance that a polynomial of each degree must explain. Measured: 1.00 where
        a background rises evenly, 0.97 where it fades with depth, at most 0.6 in real stacks and
        0.25 in simulated haze. A dome of light around cells comes closer to the second degree.
    worth
        Share of the image's contrast by which it must vary: less does not mislead a fit. Chosen,
        not measured.
    dome, high
        Share explained by the second degree that is enough if it also varies by ``high`` of the
        contrast: out-of-focus light, in a microscope that does not reject it. Measured in 19
        simulated widefield stacks, explained and height: 0.89 to 0.94 and 0.73 to 1.24 in a haze,
        where fits without it were 0.4 to 9.9 voxels off, and with it 0.2 to 0.5; 0.86 to 0.91 and
        at most 0.55 without a haze or with a faint one, where the light is the cells' own, and most
        membranes are further off with it. In real stacks never both: at most 0.87 and 0.01, 0.82
        and 0.44, 0.64 and 0.51.
    """

    blocks: int = 8
    smoothed: float = 1.0
    dark: float = 0.1
    brighter: float = 2.5
    fewest: float = 0.5
    explained: tuple[float, ...] = (0.9, 0.97)
    worth: float = 0.1
    dome: float = 0.85
    high: float = 0.6


RULES = GroundRules()
_ROUNDS = 20  # rounds of leaving blocks out; chosen, a handful is enough
_MANY = 4  # blocks for each coefficient: chosen, so that noise is not explained as well


def with_ground(scene: SceneSettings, image: NDArray[Any]) -> tuple[SceneSettings, str]:
    """The scene with the background that an image shows, and a sentence on it; "" if it is even.

    A scene that names effects stays as it is, unless it has a background without numbers.
    image : (Z, Y, X); NaN where missing.
    """
    present = scene.effects.present()
    grounds = [effect for effect in present if isinstance(effect, Background)]
    open_still = not present or any(not any(ground.coefficients) for ground in grounds)
    found = tilted_ground(image) if open_still else None
    if found is None:
        return scene, ""
    told = (
        f"the background varies by {_range(found):.3g} over the image: the fit allows for it and "
        "adjusts it"
    )
    return scene.model_copy(update={"effects": scene.effects.adding(found)}), told


def tilted_ground(image: NDArray[Any]) -> Background | None:
    """The background of an image if it is uneven; None if it is even, or cannot be told."""
    if image.ndim != 3 or min(image.shape) < 3:
        return None
    places, dark, contrast = _blocks(np.asarray(image, np.float64))
    for order, least in enumerate(RULES.explained, 1):
        ground = Background(order=order)
        if len(dark) < _MANY * len(ground.coefficients):
            return None
        numbers, kept, explained = _lowest(_columns(ground, places), dark)
        ground = Background(order=order, coefficients=tuple(numbers.tolist()))
        if kept >= RULES.fewest and explained >= least:
            return ground if _range(ground) > RULES.worth * contrast else None
    is_dome = kept >= RULES.fewest and explained >= RULES.dome
    return ground if is_dome and _range(ground) > RULES.high * contrast else None


def _blocks(image: Floats) -> tuple[Floats, Floats, float]:
    """Places of blocks (N, 3), -1 to 1 over the image, their dark values (N,), and the contrast."""
    known = np.isfinite(image)
    if not known.any():
        return np.zeros((0, 3)), np.zeros(0), 0.0
    smooth = gaussian_filter(np.where(known, image, np.median(image[known])), RULES.smoothed)
    counts = [max(1, min(RULES.blocks, n // 3)) for n in image.shape]
    cuts = [np.linspace(0, n, k + 1).astype(int) for n, k in zip(image.shape, counts, strict=True)]
    last = np.array(image.shape) - 1
    places, dark = [], []
    for box in np.ndindex(*counts):
        ends = np.array([cut[i : i + 2] for cut, i in zip(cuts, box, strict=True)])
        part = tuple(slice(a, b) for a, b in ends)
        if known[part].mean() > RULES.fewest:
            places.append((ends.sum(1) - 1) / last - 1)
            dark.append(float(np.quantile(smooth[part][known[part]], RULES.dark)))
    low, high = np.quantile(smooth[known], [RULES.dark, 1 - RULES.dark / 10])
    return np.array(places).reshape(-1, 3), np.array(dark), float(high - low)


def _lowest(columns: Floats, dark: Floats) -> tuple[Floats, float, float]:
    """The polynomial through the blocks, leaving out those that cells brighten.

    Its coefficients, the share of blocks left, and the share of their variance that it explains.
    columns : (N, K) its terms at the blocks.
    """
    columns = np.column_stack([columns, np.ones(len(dark))])
    kept = np.ones(len(dark), bool)
    for _ in range(_ROUNDS):
        numbers = np.asarray(np.linalg.lstsq(columns[kept], dark[kept], rcond=None)[0], float)
        left = dark - columns @ numbers
        middle = np.median(left[kept])
        spread = SIGMA_PER_MEDIAN_DEVIATION * float(np.median(np.abs(left[kept] - middle)))
        now = left <= middle + RULES.brighter * spread
        if (now == kept).all() or now.sum() < _MANY * columns.shape[1]:
            break
        kept = now
    explained = 1 - float(left[kept].var()) / max(float(dark[kept].var()), 1e-300)
    return numbers[:-1], float(kept.mean()), explained


def _columns(ground: Background, places: Floats) -> Floats:
    """(N, K) the terms of its polynomial at places (N, 3)."""
    columns = []
    for name in ground.names_of("coefficients"):  # such as "zy"
        along = [
            legendre.legval(at, [0.0] * name.count(axis) + [1.0])
            for at, axis in zip(places.T, ground.axes, strict=True)
        ]
        columns.append(np.prod(along, axis=0))
    return np.stack(columns, 1)


def _range(ground: Background) -> float:
    """Difference between its brightest and its darkest place."""
    steps = np.linspace(-1, 1, 5)  # for two degrees as good as all voxels
    places = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
    return float(np.ptp(_columns(ground, places) @ np.array(ground.coefficients)))
