"""Errors and warnings that are meant to be read by a user, and the words of failures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import prod

PROGRAM = "napari-deltamic"  # the command
_NAMED = 6  # at most, in a sentence: more would fill lines that nobody reads
_BYTES_PER_VOXEL = 60  # roughly, at the peak of a fit: images, spectra and weights


class InputError(ValueError):
    """Something the user gave cannot be used; the message says what and why, in one line.

    The command line prints it and exits with code 2; the widget shows it.
    """


class NoCellsFound(InputError):
    """No cell is found in an image: another size, or seeds, may help."""


class Stopped(Exception):
    """Whoever asked for something long wants it no more."""


class RepairWarning(UserWarning):
    """Input was usable only after a repair; the message says what was changed."""


class DoubtWarning(UserWarning):
    """Input can be used but may not be what was meant; the message says why and what to do."""


class SlowPathWarning(UserWarning):
    """The compiled extension is missing: images are the same, but slower; nothing is remeshed."""


TOLD = (RepairWarning, DoubtWarning, SlowPathWarning)  # warnings that users see


class Failure(Exception):
    """The engine could not finish; the message says why, in one line. Exit code 1."""


def failure(error: BaseException, shape: Sequence[int] | None = None) -> Failure:
    """What to tell a user of an exception of the engine, that worked on an image of a shape."""
    text = one_line(str(error))
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and _is_memory(text)):
        return Failure(
            f"not enough memory{_needed(text, shape)}: a coarser accuracy (--accuracy 1e-2) or a "
            "cropped image would fit"
        )
    if isinstance(error, FloatingPointError):
        return Failure(text)
    return Failure(f"{type(error).__name__}: {text or 'no reason given'} (-v shows where)")


def one_line(text: str) -> str:
    """The text without line breaks, and without what would steer a terminal."""
    plain = " ".join(text.split())
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in plain)


def listed(noun: str, names: Sequence[object]) -> str:
    """'cell 3', 'cells 3 and 5', 'cells 1, 2, 3, 4, 5, 6 and 9 others'."""
    shown = [str(name) for name in names[:_NAMED]]
    if len(names) > _NAMED:
        left = len(names) - _NAMED
        shown.append(f"{left} others" if left > 1 else "1 other")
    words = " and ".join(filter(None, [", ".join(shown[:-1]), shown[-1]]))
    return f"{noun}{'s' if len(names) > 1 else ''} {words}"


def _is_memory(text: str) -> bool:
    return bool(re.search(r"can't allocate|not enough memory|out of memory|bad_alloc", text, re.I))


def _needed(text: str, shape: Sequence[int] | None) -> str:
    """How much was asked for, as far as the error or the size of the image tells."""
    asked = re.search(r"allocate (\d+) bytes", text)
    if asked:
        return f" ({_size(int(asked[1]))} more were needed)"
    asked = re.search(r"allocate ([\d.]+ [KMGTP]iB)", text)
    if asked:
        return f" ({asked[1]} more were needed)"
    if shape:
        image = " x ".join(map(str, shape))
        return f" (an image of {image} voxels needs about {_size(_BYTES_PER_VOXEL * prod(shape))})"
    return ""


def _size(n: float) -> str:
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if n < 1024:
            return f"{n:.3g} {unit}"
        n /= 1024
    return f"{n:.3g} TiB"
