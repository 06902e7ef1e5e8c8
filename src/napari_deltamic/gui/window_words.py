"""Texts for the window: errors, and texts written for the command line."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Sequence

from psygnal import EmitLoopError

from ..common.description import described
from ..errors import InputError, failure
from ..runs.settings import FitSettings

_log = logging.getLogger(__name__)
_OF_THE_COMMAND_LINE = " (-v shows where)"
_FIELDS = described(FitSettings)
# Where the window has what a flag sets: sections, and fields by their titles.
_PLACES = {
    "--effects": "Corrections",
    "--structure": _FIELDS["structure"].title,
    "--fit-psf": _FIELDS["fit_psf"].title,
    "--modality": "Microscope",
    "--accuracy": "quick, normal, careful",
}


def for_window(text: str) -> str:
    """A text for the window: with field names instead of flags in brackets, and with µm."""
    shown = re.sub(r" \(try (--[a-z-]+) (\w+)\)", _tried, text)
    shown = re.sub(r" \((--[^)]*)\)", _placed, shown)
    shown = shown.replace("give it a radius", "set 'start from' to 'a sphere'")
    return re.sub(r"\bum\b", "µm", shown).replace("µm^2", "µm²").replace("µm^3", "µm³")


def as_tip(text: str) -> str:
    """A text as a tooltip: rich text, which Qt wraps; '' for none."""
    return f"<qt>{for_window(text)}</qt>" if text else ""


def words_of(error: Exception, shape: Sequence[int] | None = None) -> str:
    """An error in one line for the user; the traceback of a bug goes to the log.

    shape : of the image, which tells how much memory is needed.
    """
    while isinstance(error, EmitLoopError) and isinstance(error.__cause__, Exception):
        error = error.__cause__  # of what was told of a change
    if isinstance(error, InputError):
        return str(error)
    _log.error("unexpected error", exc_info=error)
    return str(failure(error, shape)).replace(_OF_THE_COMMAND_LINE, "; the log shows where")


def attempt(action: Callable[[], None], warn: Callable[[str], None]) -> None:
    """Run an action that may fail; the user reads why, without a traceback."""
    try:
        action()
    except Exception as error:  # a bug is no reason to frighten a user or to lose the fit
        warn(words_of(error))


def _tried(asked: re.Match[str]) -> str:
    """For a flag with a value: the field, and what to choose there; '' if there is none."""
    place = _PLACES.get(asked[1])
    return f" (try {asked[2]} for '{place}')" if place else ""


def _placed(flags: re.Match[str]) -> str:
    places = [place for flag, place in _PLACES.items() if flag in flags[1]]
    return f" (see {', '.join(places)})" if places else ""
