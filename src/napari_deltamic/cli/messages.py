"""What the command line says besides its results: remarks and failures, a line each."""

from __future__ import annotations

import io
import logging
import os
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from tqdm import tqdm

from ..errors import TOLD, one_line

INTERRUPTED = 130  # exit code, as of a program that SIGINT has ended

_log = logging.getLogger(__name__)


class Notes:
    """Remarks for stderr, held back until a run starts, so that an error stays one line.

    Attributes
    ----------
    texts : all remarks so far.
    """

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._held = True

    def add(self, text: str) -> None:
        """Say something now, or when released."""
        text = one_line(text)
        self.texts.append(text)
        if not self._held:
            self._say(text)

    def release(self) -> None:
        """Say what was held back; from now on everything is said at once."""
        if self._held:
            self._held = False
            for text in self.texts:
                self._say(text)

    @contextmanager
    def catching_warnings(self) -> Iterator[None]:
        """The warnings that are meant for users become notes; others are logged."""
        with warnings.catch_warnings():
            for category in TOLD:
                warnings.simplefilter("always", category)

            def show(message: Any, category: type[Warning], *rest: Any, **more: Any) -> None:
                if issubclass(category, TOLD):
                    self.add(str(message))
                else:
                    _log.warning("%s: %s (%s)", category.__name__, message, rest)

            warnings.showwarning = show
            yield

    @staticmethod
    def _say(text: str) -> None:
        with suppress(OSError, ValueError):  # nobody listens: no reason to lose a fit
            tqdm.write(f"note: {text}", file=sys.stderr)  # does not break a progress bar


class _Nowhere(io.TextIOBase):
    """Takes everything, keeps nothing."""

    def write(self, text: str) -> int:
        return len(text)


def tell(path: object) -> None:
    """Print the path of a result, a line on stdout.

    The result is there all the same where stdout cannot take it: then nothing more goes there.
    """
    try:
        try:
            str(path).encode(getattr(sys.stdout, "encoding", None) or "utf-8")
            print(path, flush=True)
        except UnicodeEncodeError:  # a name that is no text here; its bytes are
            sys.stdout.flush()
            sys.stdout.buffer.write(os.fsencode(str(path)) + b"\n")
            sys.stdout.buffer.flush()
    except (OSError, ValueError, AttributeError):
        sys.stdout = _Nowhere()


class Bar(tqdm):  # type: ignore[misc]
    """A progress bar without the thread that watches over progress bars."""

    monitor_interval = 0
    _told = 0.0  # s: when it last said what is done meanwhile

    def tell(self, text: str) -> None:
        """Say what is done meanwhile, as often as it says how far it is; '' for the same."""
        if text:
            self.set_description_str(text, refresh=False)
        if time.monotonic() - self._told >= self.mininterval:
            self.refresh()
            self._told = time.monotonic()
