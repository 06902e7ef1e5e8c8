"""Layers of a viewer converted to what a session file holds, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from napari.layers import Image, Labels, Layer, Points, Surface
from napari.utils import Colormap
from napari.utils.colormaps import AVAILABLE_COLORMAPS
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry import Mesh
from ...results.colouring import colour_indices
from ...results.session_parts import SavedImage, SavedLayer, SavedTracks
from ..cell_source import at_time, seed_kind, shown_surface
from ..viewing import own_layers
from ..viewing.cell_layers import FILE
from ..viewing.colours import side_values, surface_look
from ..viewing.frame import FOUND, ORIGIN, OWN, TRUTH, Frame, stack_of
from ..viewing.walls import COPIES, Apart

_SHOWN = ("opacity", "blending", "visible")
_IMAGE = (*_SHOWN, "gamma", "rendering", "interpolation2d", "interpolation3d")
_OTHERS: dict[type, tuple[str, ...]] = {
    Points: (*_SHOWN, "projection_mode", "shading"),
    Labels: _SHOWN,
    Surface: (*_SHOWN, "shading", "gamma"),
}
_OF_POINTS = ("size", "face_color", "border_color")
_NOTED = (FILE, ORIGIN, TRUTH, FOUND)  # under OWN: what is still so when it is opened


def save_image(layer: Any, pixels: NDArray[Any], frame: Frame) -> SavedImage:
    """An image layer; the pixels are those of the 3D image that is fitted."""
    return SavedImage(
        name=layer.name,
        pixels=pixels,
        voxel_size=frame.voxel_size,
        display=_shown(layer, _IMAGE),
        **{**_place(layer), "translate": frame.translate},
    )


def image_layer(saved: SavedImage, tracks: SavedTracks | None = None) -> Image:
    """The layer again; it shares the pixels. With tracks, the layer of their series."""
    options = _options(saved, saved.display)
    if tracks is None:
        return Image(saved.pixels, metadata={OWN: {}}, **options)
    for name, first in zip(("scale", "translate", "units"), tracks.time, strict=True):
        options[name] = (first, *options[name])
    if "axis_labels" in options:
        options["axis_labels"] = ("t", *options["axis_labels"])
    return Image(tracks.pixels, metadata={OWN: {}}, **options)


def save_layer(
    layer: Any, step: tuple[int, ...], point: tuple[float, ...], frame: Frame | None = None
) -> SavedLayer:
    """A Points, Labels or Surface layer; of a series, what lies at the viewer's dims.

    Of labels, the region of the image that is fitted.
    """
    of, found, place = seed_kind(layer), _arrays(layer, step, point), _place(layer)
    if of is Labels and frame is not None and frame.box is not None:
        region = frame.region(layer, found["data"].shape)
        if region is not None and found["data"].shape != frame.shape:
            found = {"data": found["data"][region]}
            place["translate"] = frame.translate
    known = {k: v for k, v in layer.metadata.get(OWN, {}).items() if k in _NOTED}
    return SavedLayer(
        kind=of.__name__.lower(),
        name=layer.name,
        arrays={name: np.array(array) for name, array in found.items()},
        options={**_shown(layer, _OTHERS[of]), "known": known},
        **place,
    )


def seed_layer(saved: SavedLayer) -> Layer:
    """A layer from a session. InputError if its kind is unknown."""
    options, arrays = dict(saved.options), saved.arrays
    own = dict(options.pop("known", {}))
    options = _options(saved, options)
    if saved.kind == "points":
        more = {name: arrays[name] for name in _OF_POINTS}
        options = own_layers.known_here(options)
        return own_layers.Points(arrays["data"], metadata={OWN: own}, **more, **options)
    if saved.kind == "labels":
        return Labels(arrays["data"], metadata={OWN: own}, **options)
    if saved.kind != "surface":
        raise InputError(f"a layer of an unknown kind: {saved.kind}")
    if "regions" in arrays:
        own["regions"] = arrays["regions"]
    data = tuple(arrays[name] for name in ("vertices", "faces", "values"))
    return own_layers.Surface(data, metadata={OWN: own}, **options)


def mesh_layer(mesh: Mesh, name: str, frame: Frame) -> Surface:
    """The surface of a result, in a frame."""
    apart = Apart.of(mesh)
    return Surface(
        (apart.vertices(mesh), apart.faces, side_values(apart.sides, (), colour_indices(mesh))),
        name=name,
        **surface_look(),
        metadata={OWN: {"regions": mesh.regions, COPIES: apart.copies, "fit": True}},
        **frame.layer_options(),
    )


def _arrays(layer: Any, step: tuple[int, ...], point: tuple[float, ...]) -> dict[str, NDArray[Any]]:
    """The arrays of a layer at the time that the viewer shows."""
    if isinstance(layer, Labels):
        return {"data": stack_of(layer, step)}
    if isinstance(layer, Points):
        data = np.asarray(layer.data)
        shown = at_time(layer, data, point)
        arrays = {name: np.asarray(getattr(layer, name))[shown] for name in _OF_POINTS}
        return {"data": data[shown, -3:], **arrays}
    vertices, faces, regions, used = shown_surface(layer, point)
    arrays = {"vertices": vertices, "faces": faces, "values": np.asarray(layer.data[2])[used]}
    return arrays if regions is None else {**arrays, "regions": regions}


def _place(layer: Any) -> dict[str, Any]:
    z, y, x = (str(unit) for unit in layer.units[-3:])
    return {
        "scale": tuple(float(s) for s in layer.scale[-3:]),
        "translate": tuple(float(t) for t in layer.translate[-3:]),
        "units": (z, y, x),
    }


def _options(saved: SavedImage | SavedLayer, shown: dict[str, Any]) -> dict[str, Any]:
    options = {
        **shown,
        "name": saved.name,
        "scale": saved.scale,
        "translate": saved.translate,
        "units": saved.units,
    }
    if "colormap" in options:
        options["colormap"] = _colormap(options["colormap"])
    return options


def _shown(layer: Any, names: tuple[str, ...]) -> dict[str, Any]:
    """How a layer looks: these options, and its colours where it has such."""
    shown = {name: _plain(getattr(layer, name)) for name in names}
    if isinstance(layer, Image | Surface):
        shown["contrast_limits"] = [float(limit) for limit in layer.contrast_limits]
        shown["colormap"] = _save_colormap(layer.colormap)
    labels = [str(label) for label in layer.axis_labels[-3:]]
    if labels != ["-3", "-2", "-1"]:  # napari's names of axes that nobody has named
        shown["axis_labels"] = labels
    return shown


def _save_colormap(colormap: Any) -> dict[str, Any]:
    return {
        "name": str(colormap.name),
        "colors": np.asarray(colormap.colors, float).tolist(),
        "controls": np.asarray(colormap.controls, float).tolist(),
        "interpolation": str(getattr(colormap.interpolation, "value", colormap.interpolation)),
    }


def _colormap(saved: dict[str, Any]) -> Any:
    """napari's own colormap of that name if it is the same, else one with these colours."""
    known = AVAILABLE_COLORMAPS.get(saved["name"])
    if known is not None and _save_colormap(known) == saved:
        return saved["name"]
    return Colormap(**saved)


def _plain(value: Any) -> Any:
    """A number, or the name of one of napari's choices."""
    return value if isinstance(value, (bool, int, float)) else str(getattr(value, "value", value))
