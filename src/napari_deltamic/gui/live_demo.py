"""The demonstration in a window: the widget fits a sample, through the same worker and link."""

from __future__ import annotations

import napari

from ..geometry import Mesh
from ..runs.settings import RunSettings
from ..scene.samples import Sample
from .fit_widget import FitWidget
from .viewing.colours import surface_look, vertex_values


def show(sample: Sample, start: Mesh, settings: RunSettings) -> None:
    """Open napari, start the fit, and return when the window is closed."""
    viewer = napari.Viewer(title="napari-deltamic")
    open_demo(viewer, sample, start, settings)
    napari.run()


def open_demo(
    viewer: napari.Viewer, sample: Sample, start: Mesh, settings: RunSettings
) -> FitWidget:
    """Put the sample and the widget in a viewer, and start."""
    um = {"units": ("um",) * 3, "axis_labels": ("z", "y", "x")}
    image = viewer.add_image(sample.image, name=sample.name, scale=sample.grid.voxel_size, **um)
    image.contrast_limits = (float(sample.image.min()), float(sample.image.max()))
    widget = FitWidget(viewer)
    viewer.window.add_dock_widget(widget, name="deltaMic")
    seeds = viewer.add_surface(
        (start.vertices_numpy(), start.faces, vertex_values(start)),
        name="start",
        visible=False,
        **surface_look(),
        **um,
    )
    widget.doc.cells.choose(seeds)
    widget.doc.settings.show_scene(settings.scene)
    widget.doc.settings.show_fit(settings.fit)
    viewer.dims.ndisplay = 3
    viewer.reset_view()
    getattr(viewer, "scene", viewer).camera.angles = (15, 25, 65)
    widget.start()
    return widget
