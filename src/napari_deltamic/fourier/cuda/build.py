"""How the kernels are compiled and launched, and what is told where memory is short."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol


class OutOfMemoryWarning(UserWarning):
    """The device has less memory than was asked for; the work is cut into smaller pieces."""


def tell_out_of_memory(what: str) -> None:
    """Warn that the device's memory is short and what is done about it."""
    warnings.warn(f"the memory of the GPU is short: {what}", OutOfMemoryWarning, stacklevel=2)


@dataclass(frozen=True)
class Build:
    """Numbers that the source is compiled with.

    real : type of the inner loops. width : wavevectors in a segment. threads : in a block.
    tile : faces or segments in shared memory. resident : blocks that a multiprocessor holds.
    """

    real: str
    width: int
    threads: int = 128
    tile: int = 64
    resident: int = 5

    @property
    def face_bytes(self) -> int:
        """Size of what is kept of a face of a band."""
        return 96 if self.real == "float" else 176

    @property
    def defines(self) -> list[str]:
        """Options of the compiler."""
        return [
            f"-DDELTAMIC_REAL={self.real}",
            f"-DDELTAMIC_WIDTH={self.width}",
            f"-DDELTAMIC_THREADS={self.threads}",
            f"-DDELTAMIC_TILE={self.tile}",
            f"-DDELTAMIC_RESIDENT={self.resident}",
        ]


SINGLE, DOUBLE = Build("float", 8), Build("double", 4, resident=2)


class Kernels(Protocol):
    """Compiled kernels of one type on one device."""

    build: Build
    multiprocessors: int

    def launch(self, name: str, grid: tuple[int, int], arguments: Sequence[Any]) -> None:
        """Start a kernel on the current stream; the arguments are ctypes values."""
