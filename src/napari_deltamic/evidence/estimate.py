"""What an image tells about one number, or why it does not."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A number read from an image.

    Attributes
    ----------
    value
        The number; None where the image cannot tell.
    error
        Its standard deviation, in the same unit; 0 where it is exact or not known.
    reason
        How it was found, or why it was not, in plain words.
    """

    value: float | None
    error: float = 0.0
    reason: str = ""

    @property
    def known(self) -> bool:
        """Whether the image tells the number."""
        return self.value is not None


def unknown(reason: str) -> Finding:
    """A finding without a number: the image cannot tell it, for this reason."""
    return Finding(None, 0.0, reason)
