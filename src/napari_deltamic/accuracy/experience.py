"""How long fits took on this machine relative to their forecast: kept on disk for the next one."""

from __future__ import annotations

import json
from collections.abc import Hashable
from dataclasses import dataclass
from math import exp, isfinite, log
from pathlib import Path
from typing import Any

from ..common.cache_folder import cache_folder
from ..common.writing import write_if_possible

_NEWEST = 0.5  # weight of the speed of the last fit against that of earlier ones
# The same for its iterations. Within a kind they vary by up to 2.7 times, either way, from image to
# image, so one fit says less about the next than the forecast does (``benchmarks.eta``).
_OF_ITERATIONS = 0.25
_ANY = "any"  # the kind under which the speed of all fits is kept


@dataclass(frozen=True)
class Experience:
    """What a fit took, relative to its forecast.

    Attributes
    ----------
    seconds
        Time of an iteration over the forecast one.
    iterations
        Iterations until convergence over those forecast.
    single
        Whether this is from one converged fit, rather than a mean over several images.
    """

    seconds: float = 1.0
    iterations: float = 1.0
    single: bool = False


class Learned:
    """Means over earlier fits, by kind; a new kind starts with the mean speed of all fits.

    Parameters
    ----------
    folder
        Where they are kept; by default the cache folder.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._path = (folder or cache_folder()) / "fits.json"
        self._known = _read(self._path)
        self._of_images: dict[tuple[tuple[Hashable, ...], str], Experience] = {}

    def about(self, kind: str, image: tuple[Hashable, ...] = ()) -> Experience:
        """What is known about fits of a kind, preferably of the same image.

        image : a key of the image, then keys of what is fitted of it: another region, or time, of
            the same image is most similar. Measured on three regions of an image of nuclei: a fit
            took 55, 39 and 30 times what was forecast.
        """
        for of in (image, image[:1]):
            same = self._of_images.get((of, kind))
            if same is not None:
                return same
        known = self._known.get(kind)
        if known is not None:
            return Experience(exp(known[0]), exp(known[1]))
        found = self._known.get(_ANY)
        return Experience() if found is None else Experience(exp(found[0]), 1.0)

    def learn(self, kind: str, found: Experience, image: tuple[Hashable, ...] = ()) -> None:
        """Learn from what a fit took, and write it to disk if possible.

        image : keys of the image, as above; another fit of it will most likely take as long.
        """
        if image != ():
            self._of_images[image, kind] = self._of_images[image[:1], kind] = found
        for name in (kind, _ANY):
            seconds, iterations, count = self._known.get(name, (0.0, 0.0, 0.0))
            weight = max(_NEWEST, 1 / (count + 1))  # the first counts alone
            self._known[name] = (
                (1 - weight) * seconds + weight * log(found.seconds),
                (1 - _OF_ITERATIONS) * iterations + _OF_ITERATIONS * log(found.iterations),
                count + 1,
            )
        write_if_possible(self._path, json.dumps(self._known, indent=1) + "\n")


def _read(path: Path) -> dict[str, tuple[float, float, float]]:
    """The means in a file; {} where there is none, or it is damaged."""
    try:
        kept: Any = json.loads(path.read_text(encoding="utf-8"))
        found = {str(kind): (float(a), float(b), float(c)) for kind, (a, b, c) in kept.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
    return {kind: row for kind, row in found.items() if all(map(isfinite, row))}
