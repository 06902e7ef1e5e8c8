"""The screenshots in the README, taken of a real window.

``xvfb-run -s "-screen 0 1500x1000x24" python -m benchmarks.screenshots``

A user's way through the widget: seeds in the foam of eight cells with their preview; a real embryo
(C. elegans, LimeSeg, CC0), its cells found, corrected by clicks and fitted, in 2D and 3D.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from .clusters.embryo import read_clicks
from .figure import MissingData, default_data_folder

os.environ.setdefault("QT_QPA_PLATFORM", "xcb")
FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
SIZE = (1320, 820)
LONGEST = 1800.0  # s that anything may take


def wait(until: Callable[[], bool], rest: float = 0.5) -> None:
    """Let events happen until something is true, and a little longer."""
    from qtpy.QtWidgets import QApplication

    end, app = time.monotonic() + LONGEST, QApplication.instance()
    assert app is not None
    while not until() and time.monotonic() < end:
        app.processEvents()
        time.sleep(0.005)
    assert until(), "it took too long"
    end = time.monotonic() + rest
    while time.monotonic() < end:
        app.processEvents()
        time.sleep(0.005)


def opened() -> tuple[Any, Any]:
    """A viewer with the widget in its dock."""
    import napari

    from napari_deltamic.gui.fit_widget import FitWidget

    viewer = napari.Viewer(show=True)
    viewer.theme = "dark"
    viewer.window.resize(*SIZE)
    widget = FitWidget(viewer)
    viewer.window.add_dock_widget(widget, name="deltaMic")
    return viewer, widget


def shot(viewer: Any, name: str) -> None:
    """Save what the window shows, without notifications that lie over it."""
    from qtpy.QtWidgets import QApplication

    for part in QApplication.allWidgets():
        if type(part).__name__ == "NapariQtNotification":
            part.close()
    wait(lambda: True, 1.5)
    viewer.window.screenshot(str(FOLDER / name), canvas_only=False, flash=False)
    print(FOLDER / name)


def seeds() -> None:
    """Points in the foam, and the surfaces that a fit would start from."""
    from napari_deltamic.scene.samples import foam_sample

    sample, (viewer, widget) = foam_sample(), opened()
    viewer.add_image(
        sample.image, name="foam of 8 cells", scale=sample.grid.voxel_size, units=("um",) * 3
    )
    widget.seeds.place.click()
    layer = next(x for x in viewer.layers if x.name == "seeds")
    for center in sample.centers:
        layer.add(center)
    viewer.dims.set_point(0, float(np.median(sample.centers[:, 0])))
    wait(lambda: any("start" in x.name for x in viewer.layers), 1.0)
    viewer.reset_view()  # once the dock has its width
    shot(viewer, "seeds.png")
    viewer.close()


def embryo() -> None:
    """The embryo: find cells, correct them, run, look."""
    from napari_deltamic.images.stacks import read_image

    path = default_data_folder() / "images" / "celegans_tp33half_bgsub.tif"
    if not path.is_file():
        raise MissingData(f"no {path.name} at {path.parent}")
    viewer, widget = opened()
    image = read_image(path)[0]
    layer = viewer.add_image(image, name="embryo", scale=(4, 1, 1), units=("um",) * 3)
    layer.contrast_limits = (0, float(np.percentile(image, 99.8)))
    viewer.dims.set_point(0, 17 * 4.0)
    widget.seeds.find_cells.click()
    wait(lambda: any(x.name == "found cells" for x in viewer.layers))
    correcting = widget.seeds.corrections
    for click in read_clicks():
        correcting.bar.use({"cell": "split"}.get(click.action, click.action))
        correcting.click(np.array(click.place))
        wait(lambda: not correcting.busy, 0)
    correcting.bar.use("split")
    viewer.reset_view()
    shot(viewer, "correct.png")
    widget.settings.density.setCurrentText("smooth")
    widget.doc.look("image")
    widget.start()
    wait(lambda: widget.doc.run is not None and not widget.doc.run.running, 2.0)
    wait(lambda: not widget.judging.background.busy)
    viewer.reset_view()
    shot(viewer, "widget.png")
    viewer.dims.ndisplay = 3
    layer.visible = False
    viewer.reset_view()
    getattr(viewer, "scene", viewer).camera.angles = (10, 30, 60)
    shot(viewer, "cells.png")
    viewer.close()


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        os.environ["DELTAMIC_CACHE"] = folder  # times as on a machine that is new to the window
        seeds()
        embryo()
