"""Mesh files as Surface layers, and session files as the layers that they hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from napari import current_viewer
from napari.utils.notifications import show_info, show_warning

from .geometry.formats import MESH_FILES
from .gui.menu import fit_widget
from .gui.results.session_layers import image_layer, mesh_layer, seed_layer
from .gui.viewing.cell_layers import load_meshes, surface_layer
from .gui.viewing.frame import ORIGIN, OWN, WORLD, Frame
from .results.session_file import EXTENSION, load_session

LayerData = tuple[Any, dict[str, Any], str]
_NO_LAYERS: Any = (None,)  # napari's sign that a file was read, and no layer is to be added


def get_reader(path: str | Sequence[str]) -> Callable[..., list[LayerData]] | None:
    """The reader of a mesh file or a session, or of several; None for other files."""
    kinds = {Path(p).suffix.lower() for p in _paths(path)}
    if kinds == {EXTENSION}:
        return read_sessions
    return read_meshes if kinds and kinds <= set(MESH_FILES) else None


def read_meshes(path: str | Sequence[str]) -> list[LayerData]:
    """One Surface layer for each file, um, with a colour for each region.

    A mesh file counts from the centre of the first voxel, which here is put at the viewer's
    origin. Where the image lies elsewhere, the widget moves the layer there.

    Raises
    ------
    InputError
        Naming the file and what is wrong with it.
    """
    found = []
    for loaded in load_meshes(_paths(path)):
        for remark in loaded.remarks:
            show_warning(remark)
        layer = surface_layer(loaded, WORLD)
        layer.opacity = 1.0
        layer.metadata[OWN][ORIGIN] = None
        found.append(layer.as_layer_data_tuple())
    return found


def read_sessions(path: str | Sequence[str]) -> list[LayerData]:
    """Opens a session whole, in the widget; of several, image, seeds and meshes as layers.

    Also where there is no window for the widget, as in a script, they are layers.

    Raises
    ------
    InputError
        Naming the file and what is wrong with it.
    """
    paths, found = _paths(path), []
    viewer = current_viewer()
    if len(paths) == 1 and getattr(viewer, "window", None) is not None:
        fit_widget(viewer).sessions.open(paths[0])
        return [_NO_LAYERS]
    for one in paths:
        session = load_session(one)
        image = image_layer(session.image)
        layers = [image, *(seed_layer(seed) for seed in session.seeds)]
        if session.result is not None:
            name = f"{image.name}: surfaces"
            layers.append(mesh_layer(session.result.state.mesh, name, Frame.of(image)))
        found += [layer.as_layer_data_tuple() for layer in layers]
    show_info("one session at a time also restores settings, table and history")
    return found


def _paths(path: str | Sequence[str]) -> list[str]:
    return [path] if isinstance(path, str) else list(path)
