"""What may fail, and how the user hears of it."""

from __future__ import annotations

from collections.abc import Callable

from ..cli.messages import failure
from ..errors import InputError


def attempt(action: Callable[[], None], warn: Callable[[str], None]) -> None:
    """Run something that may fail; the user reads why, without a traceback."""
    try:
        action()
    except InputError as error:
        warn(str(error))
    except Exception as error:  # a bug, but no reason to frighten a user or to lose the fit
        warn(str(failure(error)))
