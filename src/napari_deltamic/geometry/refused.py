"""Seeds that cannot be used, while the rest goes on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import InputError


@dataclass(frozen=True)
class Refused:
    """Why one seed, or one of two, is left out.

    text : a sentence that names the points, from 1.
    points : their numbers; the last one is left out.
    closed : whether a region is closed around it, but too small.
    """

    text: str
    points: tuple[int, ...]
    closed: bool = False


_NAMED = 12  # of those that are left out for one reason; chosen: two lines of the window


def told(refused: Sequence[str], of: int, what: str) -> str:
    """Say in one line what is left out of so many seeds.

    Parameters
    ----------
    refused : a sentence for each.
    what : "point" or "label".

    Raises
    ------
    InputError
        With the sentences, if none of the seeds is left.
    """
    listed = "; ".join(_grouped(refused, what))
    if len(refused) >= of:
        raise InputError(listed)
    verb = "is" if len(refused) == 1 else "are"
    return f"{len(refused)} of {of} {what}s {verb} left out: {listed}"


def _grouped(refused: Sequence[str], what: str) -> list[str]:
    """Join sentences that say the same about several seeds."""
    found: dict[str, tuple[str, list[str]]] = {}
    for text in refused:
        numbers = re.findall(rf"\b{what} (\d+)", text)
        one = len(numbers) == 1
        key = re.sub(rf"\b{what} \d+", what, text) if one else text
        found.setdefault(key, (text, []))[1].extend(numbers if one else [])
    return [text + _likewise(numbers[1:]) for text, numbers in found.values()]


def _likewise(numbers: Sequence[str]) -> str:
    more = len(numbers) - _NAMED
    named = [*numbers[:_NAMED], *([f"{more} more"] if more > 0 else [])]
    if len(named) < 2:
        return "".join(f", likewise {name}" for name in named)
    return f", likewise {', '.join(named[:-1])} and {named[-1]}"
