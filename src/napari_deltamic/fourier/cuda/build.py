"""How the kernels are compiled and launched, and the warning if memory is short."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar

import torch


class OutOfMemoryWarning(UserWarning):
    """The device has less memory than was asked for; the work is cut into smaller pieces."""


def pointer(t: torch.Tensor) -> ctypes.c_void_p:
    """Return the address of a tensor's numbers, as kernels take it."""
    return ctypes.c_void_p(t.data_ptr())


@dataclass(frozen=True)
class Build:
    """A source file in ``csrc`` and the constants it is compiled with.

    real : number type of the inner loops. threads : number of threads in a block.
    """

    real: str
    threads: int = 128
    source: ClassVar[str]
    headers: ClassVar[tuple[str, ...]]

    @property
    def defines(self) -> list[str]:
        """Options of the compiler."""
        return [f"-DDELTAMIC_REAL={self.real}", f"-DDELTAMIC_THREADS={self.threads}"]

    @property
    def kind(self) -> torch.dtype:
        """The torch type of such numbers."""
        return torch.float32 if self.real == "float" else torch.float64


@dataclass(frozen=True)
class PointBuild(Build):
    """Spreading and gathering."""

    source = "particle_mesh_cuda.cu"
    headers = ("measure.h",)

    @property
    def point_bytes(self) -> int:
        """Size of what is kept of a point."""
        return 36 if self.real == "float" else 64


@dataclass(frozen=True)
class ClosedFormBuild(Build):
    """The closed form.

    width : wavevectors in a segment. tile : faces or segments in shared memory. resident : blocks
    that a multiprocessor holds.
    """

    width: int = 8
    tile: int = 64
    resident: int = 5
    source = "mesh_ft_cuda.cu"
    headers = ("cuda_faces.h", "triangle_ft.h")

    @property
    def face_bytes(self) -> int:
        """Size of what is kept of a face of a band."""
        return 96 if self.real == "float" else 176

    @property
    def defines(self) -> list[str]:
        """Options of the compiler."""
        return [
            *super().defines,
            f"-DDELTAMIC_WIDTH={self.width}",
            f"-DDELTAMIC_TILE={self.tile}",
            f"-DDELTAMIC_RESIDENT={self.resident}",
        ]


# By whether in single precision.
CLOSED_FORM = {
    True: ClosedFormBuild("float"),
    False: ClosedFormBuild("double", width=4, resident=2),
}
POINTS = {True: PointBuild("float"), False: PointBuild("double")}

Of = TypeVar("Of", bound=Build, covariant=True)


class Kernels(Protocol[Of]):
    """Compiled kernels of one build on one device."""

    multiprocessors: int

    @property
    def build(self) -> Of:
        """The build from which they were compiled."""

    def launch(self, name: str, grid: tuple[int, int], arguments: Sequence[Any]) -> None:
        """Start a kernel on the current stream; the arguments are ctypes values."""
