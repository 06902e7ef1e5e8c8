"""Progress of a long computation. Whoever runs it may listen, and stop it there by raising."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
Listener = Callable[[str], None]
_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)


def doing(what: str = "") -> None:
    """Report progress; computations that take long and yield nothing call it about every second.

    what : what is being done, in words for a user; '' for the same as before.
    """
    listener = _LISTENER.get()
    if listener is not None:
        listener(what)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Within the block, pass on to the listener what :func:`doing` reports in this thread."""
    before = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(before)


def heard(items: Iterable[T], listener: Listener) -> Iterator[T]:
    """The same items; the listener hears what is reported while each one is made."""
    made = iter(items)
    while True:
        with listening(listener):
            try:
                item = next(made)
            except StopIteration:
                return
        yield item
