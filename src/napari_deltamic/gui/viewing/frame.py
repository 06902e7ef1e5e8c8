"""Where an image layer lies: between the viewer's world and the um of the engine."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pint
from napari.layers import Image
from numpy.typing import ArrayLike, NDArray

from ...common.triple import Triple, triple
from ...errors import InputError
from ...images.missing import finite_or_nan
from ...images.padding import without_padding
from ...scene import Grid

OWN = "deltamic"  # key in the metadata of layers: what this plugin knows of them
MADE_BY_FIT = {"fit": True}  # under it: of layers that show a fit
# Under it: of a layer of a mesh file, where in the world the file's coordinates count from; None
# for one that has not been put into the frame of an image yet.
ORIGIN = "origin"
TRUTH = "truth"  # under it: whether the layer shows what is true of a simulated image
FOUND = "found"  # under it: of a layer of found cells, in which image, and what was said of them
FloatArray = NDArray[np.float64]
Box = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]  # voxels, Z, Y, X: first, and end


@dataclass(frozen=True)
class Frame:
    """The engine's coordinates for an image layer: um from the centre of its first voxel.

    voxel_size : um, Z, Y, X.
    um : um in one unit of the viewer's world, along each axis.
    translate : where the centre of the first voxel lies in the world.
    units : of the layer, for the layers that a fit adds.
    box : the region of the layer that is fitted; None for all of it.
    """

    voxel_size: Triple
    um: Triple
    translate: Triple
    units: tuple[str, ...]
    box: Box | None = None

    @classmethod
    def of(cls, layer: Any) -> Frame:
        """The frame of an image layer, by its last three axes. InputError if it is rotated."""
        _check_straight(layer)
        um = um_per_unit(layer) or (1.0, 1.0, 1.0)
        size = np.asarray(layer.scale, float)[-3:] * um
        if not (size > 0).all():
            raise InputError(
                f"layer '{layer.name}' is mirrored (its scale is negative): flip its data instead, "
                "or give it a positive scale"
            )
        return cls(
            triple(size), um, triple(layer.translate[-3:]), tuple(str(u) for u in layer.units[-3:])
        )

    def within(self, box: Box) -> Frame:
        """The frame of a region of the image."""
        first = np.array([low for low, _ in box]) * self.voxel_size
        return replace(self, translate=triple(self.to_world(first)), box=box)

    def region(self, layer: Any, shape: tuple[int, ...]) -> tuple[slice, ...] | None:
        """The slices of this region in a layer of the whole image, or of the region alone.

        None where the layer lies on other voxels.
        """
        scale, shift = self.data_to_um(layer)
        size = np.asarray(self.voxel_size)
        if not np.allclose(scale, size, rtol=1e-3):
            return None
        alike = self.box is None or shape == self.shape
        if alike and (np.abs(shift) <= 0.01 * size).all():
            return (slice(None),) * 3
        if self.box is None:
            return None
        first = np.array([low for low, _ in self.box])
        same = (np.abs(shift + first * size) <= 0.01 * size).all()
        return tuple(slice(a, b) for a, b in self.box) if same else None

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Shape of the region; None for the whole image."""
        return None if self.box is None else tuple(b - a for a, b in self.box)

    @property
    def length(self) -> str:
        """The unit of lengths: "voxels" if the voxel size is not known, else "µm"."""
        unknown = set(self.units) == {"pixel"} and set(self.voxel_size) == {1.0}
        return "voxels" if unknown else "µm"

    @property
    def size_in_words(self) -> str:
        """The voxel size in words."""
        if self.length == "voxels":
            return "voxels of unknown size"
        return "voxels of " + " x ".join(f"{d:.4g}" for d in self.voxel_size) + f" {self.length}"

    def has_size_of(self, layer: Any) -> bool:
        """Whether an image layer has this voxel size, to the digits that fields show."""
        return bool(np.allclose(voxel_size(layer), self.voxel_size, rtol=1e-3, atol=0))

    def lies_on(self, layer: Any) -> bool:
        """Whether an image layer has the voxel size and the place that it had."""
        return self.has_size_of(layer) and self.has_place_of(layer)

    def has_place_of(self, layer: Any) -> bool:
        """Whether an image layer with this voxel size still lies where it did."""
        try:
            shift = self.data_to_um(layer)[1]
        except InputError:  # it was turned
            return False
        first = np.zeros(3) if self.box is None else np.array([low for low, _ in self.box])
        size = np.asarray(self.voxel_size)
        return bool((np.abs(shift + first * size) <= 0.01 * size).all())

    def grid(self, shape: tuple[int, ...]) -> Grid:
        """The grid of an image of a shape."""
        return Grid((shape[0], shape[1], shape[2]), self.voxel_size)

    def to_um(self, world: ArrayLike) -> FloatArray:
        """Positions (n, 3) in um from world coordinates."""
        return (np.asarray(world, np.float64) - self.translate) * self.um

    def to_world(self, um: ArrayLike) -> FloatArray:
        """Positions (n, 3) in world coordinates from um."""
        return np.asarray(um, np.float64) / self.um + np.asarray(self.translate)

    def place_of(self, event: Any) -> FloatArray:
        """Position of a mouse event, (3,) um."""
        return self.to_um(np.asarray(event.position, float)[-3:])

    def direction_of(self, event: Any) -> FloatArray:
        """Viewing direction at a mouse event, (3,), not normalised."""
        # The axes lie along those of the world, if of another length.
        return np.asarray(event.view_direction, float)[-3:] * self.um

    def data_to_um(self, layer: Any) -> tuple[FloatArray, FloatArray]:
        """Scale and shift that take the last three coordinates of a layer's data to um."""
        _check_straight(layer)
        # A layer without units is drawn in those of the others.
        own = np.asarray(um_per_unit(layer) or self.um)
        scale = np.asarray(layer.scale, float)[-3:] * own
        shift = np.asarray(layer.translate, float)[-3:] * own - np.asarray(self.translate) * self.um
        return scale, shift

    def layer_options(self) -> dict[str, Any]:
        """Options of a layer whose data are um in this frame."""
        return {
            "scale": tuple(1 / u for u in self.um),
            "translate": self.translate,
            "units": self.units,
        }

    def image_options(self) -> dict[str, Any]:
        """Options of an image layer that covers the same voxels."""
        size = tuple(d / u for d, u in zip(self.voxel_size, self.um, strict=True))
        return {"scale": size, "translate": self.translate, "units": self.units}


# Of what lies in no image.
WORLD = Frame((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), ("um",) * 3)


def unwrapped(viewer: Any) -> Any:
    """The viewer itself, where napari hands over a ``PublicOnlyProxy`` of it.

    It does so for docks that ``napari -w`` or ``add_plugin_dock_widget`` open. Whatever is asked of
    such a proxy is wrapped anew: no layer *is* the one that was found a moment ago, and none is of
    the type that it seems to be.
    """
    return getattr(viewer, "__wrapped__", viewer)


def camera_of(viewer: Any) -> Any:
    """The camera of a viewer or its model; napari 0.9 has moved it."""
    return getattr(viewer, "scene", viewer).camera


def go_to(viewer: Any, world: ArrayLike) -> None:
    """Move the sliders of the last axes to a place."""
    places, n = np.asarray(world, float).tolist(), viewer.dims.ndim
    viewer.dims.set_point(range(n - len(places), n), places)


def chosen_of(viewer: Any, layers: list[Any]) -> Any:
    """The layer among these that is selected, else the highest; None if there are none."""
    active = viewer.layers.selection.active
    return active if active in layers else layers[-1] if layers else None


def um_per_unit(layer: Any) -> Triple | None:
    """Size of the units of a layer's last three axes, um; None if not lengths (pixels)."""
    found = [in_units(unit, "micrometer") for unit in layer.units[-3:]]
    return None if None in found else triple(found)


def in_units(unit: Any, other: str) -> float | None:
    """The factor from a unit to another one; None if they are of different kinds."""
    try:
        return float((1 * unit).to(other).magnitude)
    except (pint.DimensionalityError, pint.UndefinedUnitError):
        return None


def voxel_size(layer: Any) -> Triple:
    """Voxel size of an image layer, um, whatever the direction of its axes."""
    return triple(np.abs(np.asarray(layer.scale, float)[-3:]) * (um_per_unit(layer) or (1.0,) * 3))


def rescale(viewer: Any, layer: Any, scale: ArrayLike, others: Iterable[Any] = ()) -> None:
    """Give a layer another scale, keeping the slice and the part that fills the canvas.

    others : layers on its voxels, which stay on them.
    """
    old, new = np.array(layer.scale, float), np.array(scale, float)
    others = list(others)
    dims, camera = viewer.dims, camera_of(viewer)
    if dims.ndim < layer.ndim or layer not in viewer.layers:
        _scale_all(layer, new, others)
        return
    first = dims.ndim - layer.ndim  # axis of the viewer that is the layer's first
    ratio, fixed = np.ones(dims.ndim), np.zeros(dims.ndim)
    ratio[first:], fixed[first:] = new / old, layer.translate
    point = fixed + (np.array(dims.point, float) - fixed) * ratio
    shown = list(dims.displayed)
    center, zoom = np.array(camera.center, float), float(camera.zoom)
    at = slice(len(center) - len(shown), None)
    center[at] = fixed[shown] + (center[at] - fixed[shown]) * ratio[shown]
    _scale_all(layer, new, others)
    # After all of them: where the finest step changes, napari keeps the number of the step.
    dims.set_point(range(dims.ndim), point.tolist())
    camera.center = tuple(center.tolist())
    # Lengths may change differently along the axes: the middle of what each asks for.
    camera.zoom = zoom / float(np.exp(np.log(np.abs(ratio[shown])).mean()))


def _scale_all(layer: Any, new: FloatArray, others: Sequence[Any]) -> None:
    """Give a layer another scale along Z, Y, X, and with it the others on its voxels."""
    ratio, first = (new / layer.scale)[-3:], layer.translate[-3:]
    layer.scale = new
    for other in others:
        moved = first + (other.translate[-3:] - first) * ratio
        other.translate = (*other.translate[:-3], *moved)
        other.scale = (*other.scale[:-3], *(other.scale[-3:] * ratio))


def made_by_fit(layer: Any) -> bool:
    """Whether a layer shows a fit, or the truth of a simulation, and so is no input by default."""
    own = layer.metadata.get(OWN, {})
    return bool(own.get("fit") or own.get(TRUTH))


def is_stack(layer: Any) -> bool:
    """Whether a layer is an image that can be fitted: 3D or a series of 3D, one channel."""
    if not isinstance(layer, Image) or layer.rgb or made_by_fit(layer):
        return False
    return int(layer.ndim) in (3, 4)


def data_of(layer: Any) -> Any:
    """The voxels of a layer at its finest resolution; not read if they are lazy."""
    return layer.data[0] if getattr(layer, "multiscale", False) else layer.data


def stack_of(layer: Any, step: tuple[int, ...]) -> NDArray[Any]:
    """The 3D image of a layer, at the viewer's step along any axis before Z, Y, X."""
    return np.asarray(unread_stack_of(layer, step))


def unread_stack_of(layer: Any, step: tuple[int, ...]) -> Any:
    """The same before it is read; it becomes an array by ``np.asarray``, in any thread."""
    data = data_of(layer)
    if layer.ndim == 4:
        data = data[min(step[-4] if len(step) >= 4 else 0, len(data) - 1)]
    return data


def finite(data: Any) -> NDArray[Any]:
    """An array with NaN for all that is not finite, and for padding."""
    return finite_or_nan(without_padding(np.asarray(data))[0])


def shape_of(layer: Any) -> tuple[int, ...]:
    """The shape of what ``stack_of`` gives, without reading it."""
    return tuple(data_of(layer).shape[-3:])


def _check_straight(layer: Any) -> None:
    rotate = np.asarray(layer.rotate, float)
    turned = not np.allclose(rotate, np.eye(len(rotate)), atol=1e-9)
    moved = not np.allclose(layer.affine.affine_matrix, np.eye(layer.ndim + 1), atol=1e-9)
    if turned or moved or np.any(np.asarray(layer.shear, float) != 0):
        raise InputError(
            f"layer '{layer.name}' is rotated, sheared or has an affine transform: reset that, or "
            "resample the image along its axes first, as only scale and translation can be used"
        )
