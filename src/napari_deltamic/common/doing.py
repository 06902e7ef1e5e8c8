"""What a long computation is at. Whoever runs it may listen, and end it there by raising."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
Listener = Callable[[str], None]
_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)


def doing(what: str = "") -> None:
    """Called now and then by what takes long and yields nothing, at least once in a second or so.

    what : is being done, for a user; '' for the same as before.
    """
    listener = _LISTENER.get()
    if listener is not None:
        listener(what)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Hear, in this thread, what is done within."""
    before = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(before)


def heard(items: Iterable[T], listener: Listener) -> Iterator[T]:
    """The same items; what is done to make each is heard."""
    made = iter(items)
    while True:
        with listening(listener):
            try:
                item = next(made)
            except StopIteration:
                return
        yield item
