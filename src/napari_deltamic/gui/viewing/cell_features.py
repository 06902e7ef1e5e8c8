"""Measurements of cells on layers: features of Labels and Surface layers, cells as labels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from napari.layers import Labels
from numpy.typing import NDArray

from ...results.features import features_of
from .colours import label_colormap
from .frame import OWN, Frame

_AXES = ("z", "y", "x")


def labels_layer(
    labels: NDArray[Any], rows: Iterable[Mapping[str, Any]], frame: Frame, name: str
) -> Labels:
    """Cells as a Labels layer with their measurements."""
    layer = Labels(labels, **labels_options(rows, frame, name))
    layer.colormap = label_colormap(labels)
    return layer


def labels_options(rows: Iterable[Mapping[str, Any]], frame: Frame, name: str) -> dict[str, Any]:
    """How such a layer is made."""
    return {
        **frame.image_options(),
        "axis_labels": _AXES,
        "name": name,
        "opacity": 0.4,
        "features": features_of(rows),
        "metadata": {OWN: {"fit": True}},
    }
