"""The base classes of effects: where each acts, what it costs, and its numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from ..grid import Grid

Where = Literal["object", "fourier", "image", "likelihood"]
Axes = tuple[Tensor, Tensor, Tensor]


@dataclass(frozen=True)
class Cost:
    """What an effect adds to the cost of a plain rendering.

    Attributes
    ----------
    transforms
        Further transforms of the mesh, each as expensive as the plain one with its gradient.
    images
        Further transforms from the band to the image.
    bands, voxels
        Further elementwise passes over the band and over the image.
    """

    transforms: float = 0.0
    images: float = 0.0
    bands: float = 0.0
    voxels: float = 0.0


@dataclass(frozen=True)
class Bounds:
    """Unit and range of a number of an effect, and the size of a change that matters."""

    unit: str
    low: float
    high: float
    scale: float


class Value(NamedTuple):
    """One number of an effect, as it is shown to a user."""

    name: str
    unit: str
    value: float


class Effect(BaseModel):
    """An optional part of image formation; not computed if absent.

    Subclasses name their numbers in ``bounds`` and implement the one method of the side on which
    they act. There, ``frame`` is the grid of the whole image, to which positions are relative, even
    if only every other voxel of it is rendered.

    Attributes
    ----------
    name
        Name of its field in :class:`Effects`.
    where
        The side on which it acts, which determines its cost.
    help
        What it is, and what leaving it out does to the shape.
    cost
        Cost that it adds to a rendering.
    contradicts
        Names of effects that no image can tell from this one: only one of them can be fitted.
    bounds
        Bounds of its numbers by field; a field may hold several.
    tried_widths
        By field, values in widths of the PSF in the plane that are tried when the effect is judged.
        Such a number says how far the effect reaches but not how strong it is, so the derivative by
        it is zero where the effect changes nothing.
    needs_data
        Whether it is data, so that no image can show that it is needed.
    of_one_image
        Whether it belongs to one image only: a further view of the scene has its own, or none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: ClassVar[str]
    where: ClassVar[Where]
    title: ClassVar[str]
    help: ClassVar[str]
    cost: ClassVar[Cost] = Cost()
    contradicts: ClassVar[tuple[str, ...]] = ()
    bounds: ClassVar[dict[str, Bounds]] = {}
    tried_widths: ClassVar[dict[str, tuple[float, ...]]] = {}
    needs_data: ClassVar[bool] = False
    of_one_image: ClassVar[bool] = False

    fit: bool = Field(default=True, description="whether its numbers are fitted")

    @classmethod
    def neutral(cls) -> Self:
        """Return the instance that changes nothing; candidates are judged by derivatives at it."""
        return cls()

    def reach(self, share: float) -> float:
        """Return the distance (um) beyond which it adds less than ``share`` of the light."""
        return 0.0

    def hides_reach(self) -> bool:
        """Whether it hides how far the image of a surface itself reaches."""
        return False

    # ------------------------------------------------------------------------------- numbers

    def values(self) -> tuple[Value, ...]:
        """Return every number with name and unit."""
        found = []
        for field, bounds in self.bounds.items():
            held = getattr(self, field)
            if isinstance(held, tuple):
                names = self.names_of(field)
                found += [Value(n, bounds.unit, v) for n, v in zip(names, held, strict=True)]
            else:
                found.append(Value(field, bounds.unit, held))
        return tuple(found)

    def names_of(self, field: str) -> tuple[str, ...]:
        """Return the names of the numbers of a field that holds several."""
        return tuple(f"{field}[{k}]" for k in range(len(getattr(self, field))))

    def parameters(self) -> Tensor:
        """Return (P,) its numbers in units of their scale."""
        return torch.tensor(
            [v.value / b.scale for v, b in zip(self.values(), self._each(), strict=True)],
            dtype=torch.float64,
        )

    def with_parameters(self, parameters: Tensor) -> Self:
        """Return the effect with other values of :meth:`parameters`, clamped to their bounds."""
        bounds = self._each()
        numbers = [
            float(np.clip(float(p) * b.scale, b.low, b.high))
            for p, b in zip(parameters, bounds, strict=True)
        ]
        changed: dict[str, Any] = {}
        for field in self.bounds:
            held = getattr(self, field)
            if isinstance(held, tuple):
                changed[field] = tuple(numbers[: len(held)])
                numbers = numbers[len(held) :]
            else:
                changed[field] = numbers.pop(0)
        return self.model_copy(update=changed)

    def at_bounds(self) -> tuple[Tensor, Tensor]:
        """Return (P,), (P,) bool: which of its numbers are at their lower and upper bounds."""
        low = [v.value <= b.low for v, b in zip(self.values(), self._each(), strict=True)]
        high = [v.value >= b.high for v, b in zip(self.values(), self._each(), strict=True)]
        return torch.tensor(low, dtype=torch.bool), torch.tensor(high, dtype=torch.bool)

    def _each(self) -> list[Bounds]:
        """Return the bounds of every number."""
        found = []
        for field, bounds in self.bounds.items():
            held = getattr(self, field)
            found += [bounds] * (len(held) if isinstance(held, tuple) else 1)
        return found


class FaceEffect(Effect):
    """An effect on the faces before they are summed, which costs nothing."""

    where: ClassVar[Where] = "object"

    def face_weights(self, centroids: Tensor, frame: Grid) -> Tensor:
        """Return (F,) factors on the brightness of faces, from their centroids (F, 3) um."""
        raise NotImplementedError


class DepthEffect(Effect):
    """An effect by which the PSF changes with depth, from that of the first slice to the last's."""

    where: ClassVar[Where] = "object"

    def depths(self, centroids: Tensor, frame: Grid) -> Tensor:
        """Return (F,) relative depths: 0 up to the first slice, 1 from the last on."""
        raise NotImplementedError

    def transfers(self, axes: Axes) -> tuple[Tensor, Tensor]:
        """Return factors on the OTF in the first and in the last slice."""
        raise NotImplementedError


class TransferEffect(Effect):
    """An effect on the OTF."""

    where: ClassVar[Where] = "fourier"

    def transfer(self, axes: Axes, frame: Grid) -> Tensor:
        """Return a factor on the OTF at wavevector components that broadcast over a box, rad/um."""
        raise NotImplementedError

    @property
    def spread(self) -> float:
        """Distance (um) from the surface's own image within which voxels count because of it."""
        return 0.0


class GainEffect(Effect):
    """An effect that multiplies the image."""

    where: ClassVar[Where] = "image"
    cost: ClassVar[Cost] = Cost(voxels=1)

    def gain(self, grid: Grid, frame: Grid) -> Tensor:
        """Return a factor on the image, broadcastable to the shape of the grid."""
        raise NotImplementedError


class OffsetEffect(Effect):
    """An effect that adds to the image, in its unit; a fit subtracts it from the measured image.

    What it adds is linear in its numbers.
    """

    where: ClassVar[Where] = "image"

    def offset(self, grid: Grid, frame: Grid) -> Tensor:
        """Return what is added to the image, broadcastable to the shape of the grid."""
        raise NotImplementedError

    def summed(self, image: Tensor, grid: Grid, frame: Grid) -> Tensor:
        """Return (P,) sums over an image (Z, Y, X) times what one unit of each number adds."""
        raise NotImplementedError


@dataclass(frozen=True)
class Detection:
    """What an image shows about its detection.

    gain, offset, read_noise : as in a camera.
    saturation : intensity of saturated voxels; None if there are none.
    failed : slices that hold no image.
    """

    gain: float
    offset: float
    read_noise: float
    saturation: float | None
    failed: tuple[int, ...]


class VoxelEffect(Effect):
    """An effect on the likelihood alone: which voxels tell nothing, how noisy the others are."""

    where: ClassVar[Where] = "likelihood"
    fit: bool = Field(default=False, description="nothing of it is fitted with the shape")

    of_one_image: ClassVar[bool] = True

    def missing(self, image: np.ndarray) -> np.ndarray:
        """Return (Z, Y, X) bool: voxels that tell nothing."""
        return np.zeros(image.shape, bool)

    def spoil(self, image: np.ndarray) -> None:
        """Write into a simulated image (Z, Y, X) what such voxels hold."""

    def about_missing(self) -> str:
        """Say in a few words what such voxels are."""
        return "voxels tell nothing"

    @classmethod
    def seen(cls, detection: Detection) -> Self | None:
        """Return the effect if the image itself shows it; else None."""
        return None


class DetectorEffect(VoxelEffect):
    """The detector that made the image: ``variance = gain (image - offset) + read noise^2``."""

    gain: float
    offset: float
    read_noise: float
    saturation: float | None


class ViewEffect(Effect):
    """A further image of the same scene, seen through a Gaussian PSF of its own."""

    where: ClassVar[Where] = "image"
    needs_data: ClassVar[bool] = True

    sigma: tuple[float, float, float]
    image: str


def relative(grid: Grid, frame: Grid, axis: int) -> Tensor:
    """Return positions of the voxels along an axis, -1 at the first and 1 at the last of the frame.

    They are shaped to broadcast over the image.
    """
    n = frame.shape[axis]
    half = max((n - 1) * frame.voxel_size[axis] / 2, 1e-12)
    middle = frame.origin[axis] + half
    at = grid.origin[axis] + grid.voxel_size[axis] * torch.arange(
        grid.shape[axis], dtype=torch.float64
    )
    shape = [1, 1, 1]
    shape[axis] = -1
    return ((at - middle) / half).reshape(shape)


def middle(frame: Grid) -> np.ndarray:
    """Return the middle of the image, (3,) um."""
    first, last = frame.extent
    return (first + last) / 2
