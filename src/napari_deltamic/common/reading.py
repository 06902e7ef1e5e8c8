"""Reading text files from elsewhere: with a limit on size, and every fault named in one line."""

from __future__ import annotations

import json
import logging
import tomllib
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError

# Lists within lists take up to 30 times as much memory as their text.
LARGEST_TEXT = 1 << 24  # bytes: more than any settings or table of ours; more could fill memory


def read_text(path: str | Path) -> str:
    """A text file in UTF-8; a byte order mark at its beginning is left out.

    Raises
    ------
    InputError
        If the file is missing, unreadable, longer than ``LARGEST_TEXT`` bytes, or not text; names
        the file.
    """
    try:
        with Path(path).open("rb") as stream:
            data = stream.read(LARGEST_TEXT + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from None
    if len(data) > LARGEST_TEXT:
        raise InputError(f"{path}: cannot be read: it is longer than {LARGEST_TEXT >> 20} MiB")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: cannot be read: it is not text (UTF-8)") from None


@contextmanager
def reading(what: str, path: str | Path) -> Iterator[None]:
    """Within the block, an InputError is extended by what could not be read, and from where."""
    try:
        yield
    except InputError as error:
        reason = str(error).removeprefix(f"{path}: ").removeprefix("cannot be read: ")
        raise InputError(f"cannot read {what} from {path}: {reason}") from None


def toml_values(text: str) -> dict[str, Any]:
    """The values in a TOML document; InputError if it is not valid, or nested too deeply."""
    found: dict[str, Any] = _values(text, tomllib.loads)
    return found


def json_values(text: str) -> Any:
    """The values in a JSON document; InputError if it is not valid, or nested too deeply."""
    return _values(text, json.loads)


def one_reason(error: BaseException) -> str:
    """The message of an error in one short line."""
    said = f"there is no {error}" if isinstance(error, KeyError) else str(error)
    return " ".join(said.split())[:200] or type(error).__name__


@contextmanager
def quiet(*loggers: str) -> Iterator[None]:
    """Silence log messages of these loggers, and all warnings: what matters becomes an error."""
    found = [logging.getLogger(name) for name in loggers]
    levels = [logger.level for logger in found]
    for logger in found:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(found, levels, strict=True):
            logger.setLevel(level)


def _values(text: str, parse: Callable[[str], Any]) -> Any:
    if len(text) > LARGEST_TEXT:
        raise InputError(f"it is longer than {LARGEST_TEXT >> 20} million characters")
    try:
        return parse(text)
    except RecursionError:
        raise InputError("it is nested too deeply") from None
    except (ValueError, OverflowError) as error:
        raise InputError(one_reason(error)) from None
