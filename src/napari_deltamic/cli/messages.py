"""What the command line says besides its results: remarks and failures, a line each."""

from __future__ import annotations

import io
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from math import prod
from typing import Any

from tqdm import tqdm

from ..errors import RepairWarning, SlowPathWarning

_log = logging.getLogger(__name__)

PROGRAM = "napari-deltamic"
_BYTES_PER_VOXEL = 60  # roughly, at the peak of a fit: images, spectra and weights


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
            for category in (RepairWarning, SlowPathWarning):
                warnings.simplefilter("always", category)

            def show(message: Any, category: type[Warning], *rest: Any, **more: Any) -> None:
                if issubclass(category, (RepairWarning, SlowPathWarning)):
                    self.add(str(message))
                else:
                    _log.warning("%s: %s (%s)", category.__name__, message, rest)

            warnings.showwarning = show
            yield

    @staticmethod
    def _say(text: str) -> None:
        with suppress(OSError, ValueError):  # nobody listens: no reason to lose a fit
            tqdm.write(f"note: {text}", file=sys.stderr)  # does not break a progress bar


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


def one_line(text: str) -> str:
    """The text without line breaks, and without what would steer a terminal."""
    plain = " ".join(text.split())
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in plain)


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
