"""What every effect is: a small object that says where it acts, what it costs and its numbers."""

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
    """What one rendering takes on top of a plain one.

    Attributes
    ----------
    transforms
        Further transforms of the mesh, each as dear as the plain one with its gradient.
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
    """One number of an effect, as it is told to a user."""

    name: str
    unit: str
    value: float


class Effect(BaseModel):
    """An optional part of image formation; where it is absent it is not computed.

    Subclasses name their numbers in ``bounds``; what they do is the one method of the side that
    they act on. There, ``frame`` is the grid of the whole image, to which positions are relative,
    also where only every other voxel of it is rendered.

    Attributes
    ----------
    name
        Of its field in :class:`Effects`.
    where
        The side it acts on, which fixes what it costs.
    help
        What it is, and what leaving it out does to the shape.
    cost
        What it adds to a rendering.
    contradicts
        Names of effects that the image cannot tell from this one: only one of them can be fitted.
    bounds
        Field -> bounds of its numbers; a field may hold several.
    tried_widths
        Field -> values, in widths of the PSF in the plane, that are tried when the effect is
        judged. Such a number says how far the effect reaches and nothing of how much there is of
        it, so that the derivative in it is zero where the effect changes nothing.
    needs_data
        Whether it is data: no single image can say that it is called for.
    of_one_image
        Whether it belongs to one image alone: a further view of the scene has its own, or none.
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
        """The instance that changes nothing: a candidate is judged by its derivative there."""
        return cls()

    def reach(self, share: float) -> float:
        """um beyond which it brings less than ``share`` of the light anywhere."""
        return 0.0

    def hides_reach(self) -> bool:
        """Whether it hides how far from a surface the surface's own image reaches."""
        return False

    # ------------------------------------------------------------------------------- numbers

    def values(self) -> tuple[Value, ...]:
        """Every number with name and unit."""
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
        """Names of the numbers of a field that holds several."""
        return tuple(f"{field}[{k}]" for k in range(len(getattr(self, field))))

    def parameters(self) -> Tensor:
        """(P,) its numbers in units of their scale; any value is allowed back."""
        return torch.tensor(
            [v.value / b.scale for v, b in zip(self.values(), self._each(), strict=True)],
            dtype=torch.float64,
        )

    def with_parameters(self, parameters: Tensor) -> Self:
        """The effect with other values of :meth:`parameters`; those out of bounds are clamped."""
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
        """(P,) and (P,) bool: which of its numbers are at their lower and upper bound."""
        low = [v.value <= b.low for v, b in zip(self.values(), self._each(), strict=True)]
        high = [v.value >= b.high for v, b in zip(self.values(), self._each(), strict=True)]
        return torch.tensor(low, dtype=torch.bool), torch.tensor(high, dtype=torch.bool)

    def _each(self) -> list[Bounds]:
        """The bounds of every number."""
        found = []
        for field, bounds in self.bounds.items():
            held = getattr(self, field)
            found += [bounds] * (len(held) if isinstance(held, tuple) else 1)
        return found


class FaceEffect(Effect):
    """Acts on the faces before they are summed: free."""

    where: ClassVar[Where] = "object"

    def face_weights(self, centroids: Tensor, frame: Grid) -> Tensor:
        """(F,) factors on the brightness of faces, from their centroids (F, 3) um."""
        raise NotImplementedError


class DepthEffect(Effect):
    """Has the PSF change with depth: between that of the first and that of the last slice."""

    where: ClassVar[Where] = "object"

    def depths(self, centroids: Tensor, frame: Grid) -> Tensor:
        """(F,) relative depth: 0 in the first slice and before, 1 in the last and beyond."""
        raise NotImplementedError

    def transfers(self, axes: Axes) -> tuple[Tensor, Tensor]:
        """Factors on the OTF in the first and in the last slice."""
        raise NotImplementedError


class TransferEffect(Effect):
    """Acts on the OTF."""

    where: ClassVar[Where] = "fourier"

    def transfer(self, axes: Axes, frame: Grid) -> Tensor:
        """Factor on the OTF at wavevector components that broadcast over a box (rad/um)."""
        raise NotImplementedError

    @property
    def spread(self) -> float:
        """um: how far from the surface's own image voxels count because of it."""
        return 0.0


class GainEffect(Effect):
    """Multiplies the image."""

    where: ClassVar[Where] = "image"
    cost: ClassVar[Cost] = Cost(voxels=1)

    def gain(self, grid: Grid, frame: Grid) -> Tensor:
        """Factor on the image, broadcastable to the shape of the grid."""
        raise NotImplementedError


class OffsetEffect(Effect):
    """Adds to the image, in the image's unit: a fit takes it from the measured image once.

    What it adds is linear in its numbers.
    """

    where: ClassVar[Where] = "image"

    def offset(self, grid: Grid, frame: Grid) -> Tensor:
        """What is added to the image, broadcastable to the shape of the grid."""
        raise NotImplementedError

    def summed(self, image: Tensor, grid: Grid, frame: Grid) -> Tensor:
        """(P,) an image (Z, Y, X) times what each number adds for 1, summed over the voxels."""
        raise NotImplementedError


@dataclass(frozen=True)
class Detection:
    """What an image shows of its detection.

    gain, offset, read_noise : as of a detector.
    saturation : intensity of full voxels; None where none is full.
    failed : slices that hold no image.
    """

    gain: float
    offset: float
    read_noise: float
    saturation: float | None
    failed: tuple[int, ...]


class VoxelEffect(Effect):
    """Says which voxels tell nothing, and how noisy the others are; no image is rendered."""

    where: ClassVar[Where] = "likelihood"
    fit: bool = Field(default=False, description="nothing of it is fitted with the shape")

    of_one_image: ClassVar[bool] = True

    def missing(self, image: np.ndarray) -> np.ndarray:
        """(Z, Y, X) bool: voxels that tell nothing."""
        return np.zeros(image.shape, bool)

    def spoil(self, image: np.ndarray) -> None:
        """Write into a simulated image (Z, Y, X) what such voxels hold."""

    def about_missing(self) -> str:
        """What such voxels are, in a few words."""
        return "voxels tell nothing"

    @classmethod
    def seen(cls, detection: Detection) -> Self | None:
        """What the image itself shows of it; None where it shows nothing."""
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
    """Positions of the voxels along an axis, -1 at the first and 1 at the last of the frame.

    Shaped to broadcast over the image.
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
    """(3,) um: the middle of the image."""
    first, last = frame.extent
    return (first + last) / 2
