"""What the command line says besides its results: remarks and failures, one line each."""

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

INTERRUPTED = 130  # exit code, as of a program ended by SIGINT

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
        """Print a remark now, or, if still held back, on :meth:`release`."""
        text = one_line(text)
        self.texts.append(text)
        if not self._held:
            self._say(text)

    def release(self) -> None:
        """Print what was held back; from now on everything is printed at once."""
        if self._held:
            self._held = False
            for text in self.texts:
                self._say(text)

    @contextmanager
    def catching_warnings(self) -> Iterator[None]:
        """Within the block, warnings meant for users become notes; others are logged."""
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
        with suppress(OSError, ValueError):  # stderr is closed: no reason to lose a fit
            tqdm.write(f"note: {text}", file=sys.stderr)  # does not break a progress bar


class _Nowhere(io.TextIOBase):
    """A stream that discards everything."""

    def write(self, text: str) -> int:
        return len(text)


def tell(path: object) -> None:
    """Print the path of a result on a line of stdout.

    If stdout cannot be written to, nothing more is printed: the result exists all the same.
    """
    try:
        try:
            str(path).encode(getattr(sys.stdout, "encoding", None) or "utf-8")
            print(path, flush=True)
        except UnicodeEncodeError:  # a name that this encoding lacks: write its bytes
            sys.stdout.flush()
            sys.stdout.buffer.write(os.fsencode(str(path)) + b"\n")
            sys.stdout.buffer.flush()
    except (OSError, ValueError, AttributeError):
        sys.stdout = _Nowhere()


class Bar(tqdm):  # type: ignore[misc]
    """A progress bar without tqdm's monitoring thread."""

    monitor_interval = 0
    _told = 0.0  # s: when it last showed what is being done

    def tell(self, text: str) -> None:
        """Show what is being done, as often as the bar is refreshed; '' for the same as before."""
        if text:
            self.set_description_str(text, refresh=False)
        if time.monotonic() - self._told >= self.mininterval:
            self.refresh()
            self._told = time.monotonic()
