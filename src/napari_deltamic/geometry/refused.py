"""Seeds that cannot be used, while the rest goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from napari_deltamic.errors import InputError


@dataclass(frozen=True)
class Refused:
    """Why one seed, or one of two, is left out.

    text : a sentence that names the points, from 1.
    points : their numbers; the last one is left out.
    """

    text: str
    points: tuple[int, ...]


def told(refused: Sequence[str], of: int, what: str) -> str:
    """All that is left out of so many seeds, in one line.

    Parameters
    ----------
    refused : a sentence for each.
    what : "point" or "label".

    Raises
    ------
    InputError
        With the sentences, if none of the seeds is left.
    """
    listed = "; ".join(refused)
    if len(refused) >= of:
        raise InputError(listed)
    verb = "is" if len(refused) == 1 else "are"
    return f"{len(refused)} of {of} {what}s {verb} left out: {listed}"
