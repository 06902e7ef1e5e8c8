"""Results of something that is asked for again and again: the last few, or all of an object."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import wraps
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
S = TypeVar("S")
T = TypeVar("T")


def kept(method: Callable[Concatenate[S, P], T]) -> Callable[Concatenate[S, P], T]:
    """A method that keeps what it returns for each of its arguments as long as its object lives."""

    @wraps(method)
    def asked(own: S, /, *given: P.args, **named: P.kwargs) -> T:
        results: dict[Any, T] = vars(own).setdefault(f"kept {method.__name__}", {})
        key = (given, tuple(named.items()))
        if key not in results:
            results[key] = method(own, *given, **named)
        return results[key]

    return asked


class Kept(Generic[T]):
    """The last few results, by key; several threads may ask at the same time."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._found: OrderedDict[Hashable, T] = OrderedDict()
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._found)

    def get(self, key: Hashable | None, make: Callable[[], T]) -> T:
        """The result kept for a key, else one made now; for the key None it is not kept."""
        if key is None:
            return make()
        with self._lock:
            if key not in self._found:
                while len(self._found) >= self._most:
                    self._found.popitem(last=False)
                self._found[key] = make()
            self._found.move_to_end(key)
            return self._found[key]

    def clear(self) -> None:
        """Forget all results."""
        with self._lock:
            self._found.clear()
