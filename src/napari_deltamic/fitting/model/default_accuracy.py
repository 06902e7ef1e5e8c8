"""The accuracy that the noise of an image asks for, and the names on the dial.

A rendering that is not exact moves the fitted surface, noise scatters it, and only the larger of
the two is worth paying for. Measured on fits of a furrowed cell and the paper's cow (PSF 1.5 voxels
wide, 10 to 1000 photons at the peak): on the cell, in voxels, noise scatters the surface by 1.2
times the noise ratio n or more, and an accuracy A moves it by about 0.03 (A / 0.1)^1.25; on the
cow, which has thin parts, both are several times larger. With A = n the second is about a third of
the first or less, for n from 1 % to 8 %, so that the error of the surface is at most a twentieth
above the best that the image allows.
"""

from __future__ import annotations

from math import ceil, isfinite
from typing import Any, Literal, get_args

import numpy as np

from ...common.accuracy_bounds import is_accuracy
from ...common.words import scientific
from ...errors import InputError
from ...runs.fit_settings import asked_error
from .likelihood import noise_ratio

# Finer than the first nothing improved even without noise. Coarser than the last little time is
# left to save, widths of the PSF and densities are fitted to the same image, and a start that
# finds nothing was seen to pass for a fit: with 1e-1, nuclei passed for membranes and ended 0.6 and
# 1.0 voxel off (benchmarks.defaults).
FINEST, COARSEST = 1e-3, 2e-2
_LOOKED_AT = 400_000  # voxels

Preset = Literal["quick", "normal", "careful", "exact"]
PRESETS: tuple[Preset, ...] = get_args(Preset)
# Relative to what the noise asks for, since no number is coarse or fine of itself.
_TIMES: dict[Preset, float] = {"quick": 5.0, "normal": 1.0, "careful": 0.1, "exact": 0.0}


def accuracy_for(noise: float) -> float:
    """The accuracy for an image with this :func:`~.likelihood.noise_ratio`.

    The coarsest one whose effect on the fitted surface is below a third of that of the noise;
    between 1e-3 (little noise) and 2e-2.

    Raises
    ------
    InputError
        If the noise is negative or not finite.
    """
    if not (isfinite(noise) and noise >= 0):
        raise InputError(f"noise must be a number from 0 on, not {noise}")
    # One digit: nobody should read more into it.
    return float(f"{min(max(noise, FINEST), COARSEST):.0e}")


def preset_accuracy(name: str, noise: float) -> float:
    """The accuracy that a name stands for, on an image with this noise.

    ``normal`` is :func:`accuracy_for`; ``quick`` five times coarser, but not coarser than 2e-2;
    ``careful`` ten times finer, ``exact`` the closed form at every wavevector of the grid.
    """
    if name not in _TIMES:
        raise InputError(f"accuracy must be a number or one of {', '.join(PRESETS)}, not '{name}'")
    return float(f"{min(_TIMES[name] * accuracy_for(noise), COARSEST):.3g}")


def image_noise(image: np.ndarray, known: np.ndarray | None = None) -> float:
    """The noise ratio of an image, from as many of its planes as are needed (milliseconds).

    Parameters
    ----------
    image
        (Z, Y, X); what is not finite is left out.
    known
        (Z, Y, X) bool: voxels to go by.
    """
    every = max(1, ceil(image.size / _LOOKED_AT))
    some = np.asarray(image[:: min(every, max(1, len(image) // 3))], dtype=np.float32)
    finite = np.isfinite(some)
    if known is not None:
        finite &= np.asarray(known[:: min(every, max(1, len(image) // 3))], dtype=bool)
    return noise_ratio(np.where(finite, some, 0), finite)


def accuracy_for_image(image: np.ndarray, known: np.ndarray | None = None) -> float:
    """:func:`accuracy_for` the noise of an image; see :func:`image_noise`."""
    return accuracy_for(image_noise(image, known))


# ---- what is chosen on the dial: a name, a length, or a number -----------------------------------


def chosen(text: str) -> str:
    """A choice as the dial shows it."""
    plain = text.strip().lower()
    return "exact" if plain == "0" else plain


def relative(choice: str) -> bool:
    """Whether a choice depends on the noise."""
    return (choice in PRESETS and choice != "exact") or is_length(choice)


def is_length(choice: str) -> bool:
    """Whether a choice is how far the shape may be off, such as 20nm."""
    try:
        return asked_error(choice.replace(" ", "")) is not None
    except InputError:
        return False


def accuracy_of(choice: str, noise: float) -> float:
    """The accuracy that a choice stands for on an image with this noise. InputError if none."""
    choice = chosen(choice)
    if choice in PRESETS:
        return preset_accuracy(choice, noise)
    if is_length(choice):
        return preset_accuracy("normal", noise)  # until start and image are known
    try:
        accuracy = float(choice.replace(",", "."))
    except ValueError:
        accuracy = -1.0
    if not is_accuracy(accuracy):
        raise InputError(
            f"accuracy must be {', '.join(PRESETS)}, a length such as 20nm, or a number from 0 to "
            f"below 1, not '{choice}'"
        )
    return accuracy


def written(accuracy: float) -> str:
    """A number as a user would type it: 3e-3, and 'exact' for 0."""
    if accuracy == 0:
        return "exact"
    short = scientific(accuracy, 7)
    # All digits where they matter: a saved analysis goes on with the very number.
    return short if float(short) == accuracy else repr(float(accuracy))


def usable_choice(choice: Any) -> str:
    """A choice of the preferences; ValueError if it is none."""
    try:
        accuracy_of(str(choice), 0.0)
    except InputError as error:
        raise ValueError(str(error)) from None
    return chosen(str(choice))
