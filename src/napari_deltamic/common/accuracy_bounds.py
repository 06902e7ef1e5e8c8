"""The range of values that the accuracy of a rendering may have."""

from __future__ import annotations

from ..errors import InputError


def is_accuracy(value: float) -> bool:
    """Whether a value can be an accuracy: 0 is exact; at 1 nothing of the image need be right."""
    return 0 <= value < 1


def check_accuracy(accuracy: float) -> None:
    """Raise InputError unless the accuracy is at least 0 and below 1."""
    if not is_accuracy(accuracy):
        raise InputError(f"accuracy must be at least 0 and below 1, not {accuracy:g}")
