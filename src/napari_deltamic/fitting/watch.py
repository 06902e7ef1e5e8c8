"""What is called while a fit compares models, and yields no state."""

from collections.abc import Callable

Watch = Callable[[], None]


def unwatched() -> None:
    """Nobody watches."""
