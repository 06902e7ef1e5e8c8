"""The image that is fitted: its layer, channel and region, its voxel size; and its second view."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from napari.layers import Image, Labels, Points, Shapes
from numpy.typing import ArrayLike, NDArray
from psygnal import Signal

from ..common.triple import Triple, triple
from ..errors import InputError
from ..runs.scene_settings import SIGMA_IN_VOXELS
from ..scene.effects import ViewEffect, kind_of
from .layer_channels import (
    Choice,
    channel_layer,
    file_of,
    is_one_channel,
    noted_size,
    origin_of,
    why_unusable,
)
from .layer_choice import LayerChoice
from .viewing.frame import (
    ORIGIN,
    OWN,
    Box,
    Frame,
    chosen_of,
    data_of,
    finite,
    is_stack,
    made_by_fit,
    rescale,
    shape_of,
    um_per_unit,
    unread_stack_of,
    voxel_size,
)
from .viewing.listening import Connections
from .viewing.own_layers import Points as Clicks

_SMALLEST = 4  # voxels along each side of a region
_COVERING = ("opaque", "translucent", "translucent_no_depth")  # ways of napari to draw an image


class ImageSource(LayerChoice):
    """Choice of an image layer, its region and voxel size."""

    changed = Signal()  # the layer, its region or voxel size is another
    replaced = Signal()  # another layer is chosen: comes before ``changed``
    looked = Signal()  # the layers are others: channels may be, and what is missing
    stayed = Signal(str)  # the region did not follow its rectangle, and why

    def __init__(self, viewer: Any) -> None:
        self.box: Box | None = None  # the region of the layer that is fitted; None: all of it
        # Files, and channels in them, that were asked for their voxel size.
        self._asked: set[tuple[str, str | None]] = set()
        # Layers that were made of a channel, and what of.
        self._taken: WeakKeyDictionary[Any, tuple[weakref.ref[Any], Choice]] = WeakKeyDictionary()
        self._of_layer, self._of_region = Connections(), Connections()
        super().__init__(viewer, is_one_channel)
        events = viewer.layers.events
        self._connections.connect(events.inserted, self._place_meshes)
        for emitter in (events.inserted, events.removed):
            self._connections.connect(emitter, self._look, position="last")

    def frame(self) -> Frame:
        """The frame of what is fitted. InputError if there is no image, or it is rotated."""
        if self.layer is None:
            raise InputError(self.missing())
        frame = Frame.of(self.layer)
        return frame if self.box is None else frame.within(self.box)

    @property
    def known_frame(self) -> Frame | None:
        """The same; None where there is no image that can be used, as its panel explains."""
        try:
            return self.frame()
        except InputError:
            return None

    def under(self, layer: Any) -> tuple[Frame, Callable[[], NDArray[Any]]]:
        """Frame and voxels of the image under a layer of the region, or of the whole image."""
        if self.box is not None and tuple(layer.data.shape[-3:]) == self.shape():
            return self.frame(), self.reader()
        whole = unread_stack_of(self.layer, tuple(self._viewer.dims.current_step))
        return Frame.of(self.layer), partial(finite, whole)

    def missing(self) -> str:
        """Why there is no image to fit, in a sentence that says what to do."""
        reasons = [why_unusable(layer) for layer in self._viewer.layers]
        return next((reason for reason in reversed(reasons) if reason), "open a 3D image first")

    @property
    def time(self) -> tuple[int, ...]:
        """The steps shown along the layer's axes before Z, Y, X; () if it has none."""
        layer = self.layer
        if layer is None or layer.ndim < 4:
            return ()
        return tuple(int(step) for step in self._viewer.dims.current_step[-layer.ndim : -3])

    def key(self) -> tuple[Any, ...]:
        """A key that is equal as long as the voxels are the same; () without an image."""
        if self.layer is None:
            return ()
        return weakref.ref(self.layer), id(self.layer.data), self.time, self.box

    def shape(self) -> tuple[int, ...]:
        """Shape of ``stack``, without reading it."""
        shape = shape_of(self.layer)
        return shape if self.box is None else tuple(b - a for a, b in self.box)

    def stack(self, layer: Any = None) -> NDArray[Any]:
        """The 3D image chosen (the present time point of a 4D one), float if it has gaps.

        layer : another one, of which the same is wanted.
        """
        return self.reader(layer)()

    def reader(self, layer: Any = None) -> Callable[[], NDArray[Any]]:
        """A function that reads ``stack`` in any thread. InputError if there is no image."""
        chosen = self.layer if layer is None else layer
        if chosen is None:
            raise InputError(self.missing())
        return partial(finite, self.unread(chosen))

    def unread(self, layer: Any) -> Any:
        """The fitted region of a layer on the image's voxels, before it is read."""
        whole = unread_stack_of(layer, tuple(self._viewer.dims.current_step))
        return whole if self.box is None else whole[tuple(slice(a, b) for a, b in self.box)]

    def file(self) -> tuple[str, str | None]:
        """The file that holds this image, or "", and its channel there if it has several."""
        known = self.layer is not None and self.box is None
        return file_of(self.layer) if known else ("", None)

    # ---- what is chosen of the layer ----------------------------------------------------------

    def take_channel(self, whole: Any, choice: Choice) -> None:
        """Show one channel of a layer as its own layer, instead of all channels or another one."""
        of = weakref.ref(whole), choice
        known = (layer for layer in self._viewer.layers if self._taken.get(layer) == of)
        layer = next(known, None)
        other = None if self.taken_channel is None else self.layer
        (whole if other is None else other).visible = False
        if layer is None:
            layer = channel_layer(whole, choice)
            if other is not None and other.ndim == layer.ndim:  # its size may be known by now
                layer.scale, layer.translate, layer.units = (
                    other.scale,
                    other.translate,
                    other.units,
                )
            self._taken[layer] = of
            self._viewer.add_layer(layer)
        layer.visible = True
        self.choose(layer)

    @property
    def taken_channel(self) -> Choice | None:
        """The choice that makes this layer one channel of :meth:`with_channels`; else None."""
        of = None if self.layer is None else self._taken.get(self.layer)
        return of[1] if of is not None and of[0]() in self._viewer.layers else None

    def with_channels(self) -> Any:
        """The layer whose channels may be chosen: this one, or the one that it is a channel of; one
        that cannot be fitted, if there is none."""
        if self.taken_channel is not None:
            return self._taken[self.layer][0]()
        others = [other for other in self._viewer.layers if why_unusable(other)]
        return self.layer if self.layer is not None or not others else others[-1]

    def take_region(self, box: Box | None) -> None:
        """Fit only a region of the layer; None: all of it. InputError if it is too small."""
        wanted = None if box is None else _large_enough(box)
        self._of_region.undo()
        self._take_box(wanted)

    def _take_box(self, box: Box | None) -> None:
        if box != self.box:
            self.box = box
            self.changed.emit()

    def show(self) -> None:
        """Make the layer visible, and hide other images that would cover it."""
        layer, layers = self.layer, list(self._viewer.layers)
        if layer not in layers:
            return
        layer.visible = True
        for other in layers[layers.index(layer) + 1 :]:
            if other in self.layers and str(other.blending) in _COVERING:
                other.visible = False

    def follow_drawn(self) -> None:
        """Fit the region of the rectangle drawn, and follow when it is moved or drawn anew.

        InputError where there is none, or it is too small.
        """
        shapes = [x for x in self._viewer.layers if isinstance(x, Shapes) and len(x.data)]
        layer = chosen_of(self._viewer, shapes)
        if layer is None:
            raise InputError("draw a rectangle around the cells in a Shapes layer first")
        self.take_region(self._box_of(layer))
        self._of_region.connect(layer.events.data, self._redrawn)

    def _redrawn(self, event: Any) -> None:
        """Follow a rectangle that was moved or drawn anew; if it was removed, the region stays."""
        action = getattr(event, "action", "changed")
        moved = str(getattr(action, "value", action)) in ("added", "changed")
        if not moved or not len(event.source.data):
            return  # or it is only being moved
        try:
            self._take_box(_large_enough(self._box_of(event.source)))
        except InputError as error:
            self.stayed.emit(f"{error}: it stays where it was")
        else:
            self.looked.emit()  # why it stayed holds no more

    def _box_of(self, layer: Any) -> Box:
        """The box of the rectangle selected, or else drawn last, over all slices across it."""
        chosen = sorted(layer.selected_data) or [len(layer.data) - 1]
        corners = np.concatenate([np.asarray(layer.data[k], float) for k in chosen])
        dims = len(layer.scale)
        corners = corners * layer.scale + layer.translate
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        low[-dims:], high[-dims:] = corners.min(axis=0)[-3:], corners.max(axis=0)[-3:]
        flat = high - low < 1e-9 * np.maximum(np.abs(high), 1)
        low[flat], high[flat] = -np.inf, np.inf  # a rectangle lies in one slice, and means all
        return self._box_between(low, high)

    def _box_between(self, low: ArrayLike, high: ArrayLike) -> Box:
        """The box between two corners in world coordinates, cut to the image."""
        layer, shape = self.layer, np.array(data_of(self.layer).shape[-3:])
        ends = [(np.asarray(x) - layer.translate[-3:]) / layer.scale[-3:] for x in (low, high)]
        first = np.clip(np.ceil(ends[0] - 0.5), 0, shape)
        last = np.clip(np.floor(ends[1] + 0.5) + 1, 0, shape)
        z, y, x = ((int(a), int(b)) for a, b in zip(first, last, strict=True))
        return z, y, x

    def rescale(self, size: ArrayLike) -> None:
        """Give the layer another voxel size, um."""
        layer = self.layer
        if layer is not None:
            self._rescale(np.asarray(size) / np.asarray(um_per_unit(layer) or (1.0, 1.0, 1.0)))
            self.changed.emit()

    def close_links(self) -> None:
        """Listen to the viewer no more, and let its layers go."""
        super().close_links()
        self._of_layer.undo()
        self._of_region.undo()

    # ---- what follows from it -----------------------------------------------------------------

    def _layer_changed(self) -> None:
        layer, self.box = self.layer, None
        self._of_layer.undo()
        self._of_region.undo()
        if layer is not None:
            for name in ("scale", "translate", "rotate", "shear", "affine", "units", "data"):
                self._of_layer.connect(getattr(layer.events, name), self._look)
            self._take_size_of_file(layer)
            self._place_meshes()
        self.replaced.emit()
        self.looked.emit()
        self.changed.emit()

    def _look(self, event: Any = None) -> None:
        self.looked.emit()

    def _place_meshes(self, event: Any = None) -> None:
        """Put layers of mesh files, and labels without a scale, into the image's frame."""
        frame = self.known_frame
        if frame is None:
            return
        whole = Frame.of(self.layer).image_options()
        for layer in self._viewer.layers:
            own, options = layer.metadata.get(OWN, {}), {}
            if self._has_no_place(layer):
                options = whole
            elif ORIGIN in own and own[ORIGIN] is None and layer.ndim == 3:
                own[ORIGIN] = frame.translate
                if _unmoved(layer):  # by the user, who knows better
                    options = frame.layer_options()
            for name, value in options.items():
                setattr(layer, name, value)

    def _has_no_place(self, layer: Any) -> bool:
        """Whether a layer holds labels of the image's shape that do not say where they lie."""
        return (
            isinstance(layer, Labels)
            and layer.ndim == 3
            and shape_of(layer) == shape_of(self.layer)
            and um_per_unit(layer) is None
            and _unmoved(layer)
        )

    def _take_size_of_file(self, layer: Any) -> None:
        """Take the voxel size from the layer's TIFF file if the layer has none."""
        asked = origin_of(layer)
        unscaled = np.allclose(layer.scale[-3:], 1) and um_per_unit(layer) is None
        if unscaled and asked not in self._asked:
            self._asked.add(asked)
            size = noted_size(layer)
            if size is not None:
                self._rescale(size)

    def _rescale(self, scale: ArrayLike) -> None:
        """Give the layer another scale along Z, Y, X; layers on its voxels stay on them."""
        layer, others = self.layer, [x for x in self._viewer.layers if self._goes_along(x)]
        if um_per_unit(layer) is None:  # someone has now said how large its voxels are
            made = [x for x in self._viewer.layers if OWN in x.metadata]
            for one in (layer, *others, *made):
                _in_um(one)
        rescale(self._viewer, layer, (*layer.scale[:-3], *np.asarray(scale, float)), others)

    def _goes_along(self, other: Any) -> bool:
        """Whether a layer of the user is on the image's voxels: clicked there, or lying like it."""
        layer = self.layer
        if other is layer or other.ndim < 3 or made_by_fit(other):
            return False
        if isinstance(other, Clicks):
            return True
        known = isinstance(other, Points | Shapes) or (
            isinstance(other, Image | Labels) and shape_of(other) == shape_of(layer)
        )
        return known and all(
            np.array_equal(getattr(other, name)[-3:], getattr(layer, name)[-3:])
            for name in ("scale", "translate", "units")
        )


class SecondSource(LayerChoice):
    """Choice of a second view of an image; none but by the user.

    sigma : widths of its PSF, um: as wide as those of most images, until someone says more.
    """

    optional = True
    edited = Signal()  # by the user
    shown = Signal()  # it, or the image, is another one

    def __init__(self, viewer: Any, image: ImageSource) -> None:
        self._image = image
        self.sigma: Triple = (1.0, 1.0, 1.0)
        self._given = self._quiet = False
        super().__init__(viewer, lambda layer: is_stack(layer) and layer is not image.layer)
        image.changed.connect(self._image_changed)

    def view(self) -> ViewEffect | None:
        """The effect, or None for no second view. InputError if the layer lies on other voxels."""
        layer, image = self.layer, self._image.layer
        if layer is None or image is None:
            return None
        _check_on_voxels(layer, image)
        path, channel = file_of(layer)
        # The file of a second view holds nothing else, and more than a region.
        whole = not channel and self._image.box is None
        return kind_of(ViewEffect)(sigma=self.sigma, image=path if whole else "")

    def pixels(self) -> NDArray[Any] | None:
        """The voxels (Z, Y, X) of the layer at the time shown; None without a second view."""
        return None if self.layer is None else self._image.stack(self.layer)

    def show(self, layer: Any, sigma: Triple | None = None) -> None:
        """Show a layer as chosen, which does not count as an edit; None for no second view."""
        self._quiet = True
        if sigma is not None:
            self.sigma, self._given = sigma, True
        self.choose(layer)
        self._quiet = False
        self.shown.emit()

    def resize(self, sigma: Triple) -> None:
        """Take the widths of its PSF from the user."""
        self.sigma, self._given = sigma, True
        self.edited.emit()

    def both(self) -> list[Any]:
        """The image and its second view; [] if one is missing."""
        layers = [self.layer, self._image.layer]
        return layers if None not in layers else []

    def _image_changed(self) -> None:
        self.refresh()
        layer = self._image.layer
        if not self._given and layer is not None:
            self.sigma = triple(SIGMA_IN_VOXELS * d for d in voxel_size(layer))
        self.shown.emit()

    def _layer_changed(self) -> None:
        self.shown.emit()
        if not self._quiet:
            self.edited.emit()


def _large_enough(box: Box) -> Box:
    """The region itself. InputError if it is too small to be fitted."""
    if min(b - a for a, b in box) < _SMALLEST:
        raise InputError(f"the region must be {_SMALLEST} voxels wide along each axis")
    return box


def _in_um(layer: Any) -> None:
    """Give a layer without units um: napari draws no layers if only some have units."""
    if layer.ndim >= 3 and um_per_unit(layer) is None:
        layer.units = (*layer.units[:-3], *(("um",) * 3))


def _unmoved(layer: Any) -> bool:
    return bool(np.all(layer.scale == 1) and np.all(layer.translate == 0))


def _check_on_voxels(layer: Any, image: Any) -> None:
    """Raise InputError, with what to do, unless both layers have the same voxels."""
    advice = "register it to the image and resample it on the image's voxels first"
    shape, of_image = shape_of(layer), shape_of(image)
    if shape != of_image:
        mine, theirs = (" x ".join(map(str, s)) for s in (shape, of_image))
        raise InputError(
            f"second view: '{layer.name}' has {mine} voxels, the image {theirs}: {advice}"
        )
    try:
        Frame.of(layer)
        region = Frame.of(image).region(layer, shape)
    except InputError as error:
        raise InputError(f"second view: {error}: {advice}") from None
    if region is None:
        raise InputError(
            f"second view: '{layer.name}' does not lie on the voxels of the image: {advice}, "
            "then give both layers the same scale and translation"
        )
