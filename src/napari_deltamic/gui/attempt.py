"""What may fail, and how the user hears of it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from psygnal import EmitLoopError

from ..errors import InputError, failure

_log = logging.getLogger(__name__)
_OF_THE_COMMAND_LINE = " (-v shows where)"


def words_of(error: Exception, shape: Sequence[int] | None = None) -> str:
    """What the user reads of an error, in one line; the log has the traceback of what is a bug.

    shape : of the image, which tells how much memory is needed.
    """
    while isinstance(error, EmitLoopError) and isinstance(error.__cause__, Exception):
        error = error.__cause__  # of what was told of a change
    if isinstance(error, InputError):
        return str(error)
    _log.error("unexpected error", exc_info=error)
    return str(failure(error, shape)).replace(_OF_THE_COMMAND_LINE, "; the log shows where")


def attempt(action: Callable[[], None], warn: Callable[[str], None]) -> None:
    """Run something that may fail; the user reads why, without a traceback."""
    try:
        action()
    except Exception as error:  # a bug is no reason to frighten a user or to lose the fit
        warn(words_of(error))
