"""A window for random actions, and what must not be lost in it; see ``window``."""

from __future__ import annotations

import faulthandler
import gc
import importlib
import json
import logging
import random
import sys
import time
import traceback
import weakref
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

SIZE, SHAPE, CENTER = (0.3, 0.2, 0.2), (20, 24, 24), (2.9, 2.3, 2.3)
PLACE = {"scale": SIZE, "units": ("um",) * 3}
Action = tuple[str, Callable[[], Any]]


def cell_image() -> NDArray[np.float32]:
    """A noisy image of one cell."""
    import napari_deltamic as nd
    from napari_deltamic.geometry import sphere

    truth = sphere(CENTER, (1.2, 1.1, 1.1), edge_length=0.3)
    image = nd.render(truth, nd.Grid(SHAPE, SIZE), nd.GaussianPSF((0.36, 0.24, 0.24))).numpy()
    noisy = np.random.default_rng(0).poisson(100 + 400 * image / image.max())
    return np.asarray(noisy, np.float32)


class Session:
    """A window, what is done in it, and what must not be lost.

    Attributes
    ----------
    viewer, widget : of napari, and ours.
    rng : decides all.
    did : what came to something, counted.
    """

    def __init__(self, seed: int, folder: Path, *, offscreen: bool) -> None:
        self.folder, self.offscreen, self.rng = folder, offscreen, random.Random(seed)
        self.did: Counter[str] = Counter()
        self._name, self._said = "start", set[str]()
        if offscreen:
            _without_gl()
        import napari
        from qtpy.QtGui import QDesktopServices
        from qtpy.QtWidgets import QApplication, QFileDialog, QMessageBox

        self.app: Any = QApplication.instance() or QApplication([])
        self.viewer: Any = napari.Viewer(show=not offscreen)
        sys.excepthook = self._raised
        logging.getLogger("napari_deltamic").addHandler(_Handler(self._logged))
        for name in ("getOpenFileName", "getSaveFileName"):
            setattr(QFileDialog, name, lambda *a, **k: ("", ""))
        QFileDialog.getOpenFileNames = lambda *a, **k: ([], "")  # type: ignore[method-assign]
        QFileDialog.getExistingDirectory = lambda *a, **k: ""  # type: ignore[method-assign]
        QMessageBox.exec = lambda *a: 0  # type: ignore[method-assign]
        QDesktopServices.openUrl = lambda *a: True  # type: ignore[method-assign]
        self.pixels = cell_image()
        self.viewer.add_image(self.pixels, name="cell", **PLACE)
        self.dock()
        self.had_result = False

    def dock(self) -> None:
        """Put the widget into the window."""
        from napari_deltamic.gui.fit_widget import FitWidget

        self.widget = FitWidget(self.viewer)
        self.viewer.window.add_dock_widget(self.widget, name="deltaMic")
        self.had_result = False

    def spin(self, seconds: float = 0.005, until: Callable[[], bool] = lambda: False) -> None:
        """Let events happen."""
        end = time.monotonic() + seconds
        while True:
            self.app.processEvents()
            if time.monotonic() >= end or until():
                return
            time.sleep(0.002)

    @property
    def running(self) -> bool:
        """Whether a fit is."""
        run = self.widget.doc.run
        return run is not None and run.running

    def play(self, chosen: Sequence[Action], count: int, longest: float) -> None:
        """So many actions, by lot; none may take longer than so many seconds."""
        for number in range(count):
            self._name, action = self.rng.choice(chosen)
            print(f"{number} {self._name}", flush=True)
            began, computed = time.monotonic(), time.process_time()
            faulthandler.dump_traceback_later(longest)  # what it is at, to stderr
            try:
                action()
                self.spin()
                self._nothing_lost()
            except Exception:
                self._raised(*sys.exc_info())
            took = time.monotonic() - began
            faulthandler.cancel_dump_traceback_later()
            # A machine that others use takes its time too; what waits for nothing computes nothing.
            busy = time.process_time() - computed > 0.5 * longest
            if took > longest and (busy or took > 5 * longest):
                self.wrong(f"{self._name} took {took:.0f} s")
        self.widget.stop()
        self.spin(60, lambda: not self.running)
        if self.running:
            self.wrong("a fit that was stopped goes on")

    def open_and_close(self, cycles: int) -> None:
        """The dock, so many times; nothing of it may be left behind."""
        self._name = "open and close"
        before: list[int] = []
        for _ in range(cycles):
            gone = weakref.ref(self.widget)
            self.viewer.window.remove_dock_widget(self.widget)
            self.widget = None
            self.spin(0.05)
            gc.collect()
            if gone() is not None:
                self.wrong("a widget that was closed is still there")
            left = [len(self.viewer.mouse_drag_callbacks), len(self.viewer.keymap)]
            left += [len(e.callbacks) for e in self.viewer.layers.events.emitters.values()]
            left += [len(e.callbacks) for e in self.viewer.dims.events.emitters.values()]
            before = before or left
            if left != before:
                self.wrong(f"connections are left behind: {left}, at first {before}")
            self.dock()
            self.spin(0.05)
            self.did["opened and closed"] += 1

    def said(self, what: str) -> None:
        """What an action has turned out to be."""
        self._name = f"{self._name.partition(':')[0]}: {what}"
        print(f"  {what!r}", flush=True)

    def wrong(self, what: str) -> None:
        """Note what went wrong; the same is said once."""
        if what not in self._said:
            self._said.add(what)
            print("wrong " + json.dumps(f"{self._name}: {what}"), flush=True)

    # ----------------------------------------------------------------------------------- inside

    def _nothing_lost(self) -> None:
        layers = {layer.name: layer for layer in self.viewer.layers}
        if "cell" not in layers:
            self.wrong("the image is gone")
        elif not np.array_equal(layers["cell"].data, self.pixels):
            self.wrong("the pixels of the image were changed")
        records = self.widget.doc.records.values()
        last = next((one for one in records if one.state is not None), None)
        if last is None and self.had_result:
            self.wrong("the result of the last fit is gone")
        if last is not None:
            self.had_result = True
            if not np.isfinite(last.state.mesh.vertices_numpy()).all():
                self.wrong("the result is not finite")

    def _raised(self, kind: Any, error: Any, trace: Any) -> None:
        self.wrong("".join(traceback.format_exception(kind, error, trace)))

    def _logged(self, record: logging.LogRecord) -> None:
        if record.exc_info and record.exc_info[1] is not None:
            self._raised(*record.exc_info)


class _Handler(logging.Handler):
    """Hands on what the widget logs: what it takes for a bug of its own."""

    def __init__(self, tell: Callable[[logging.LogRecord], None]) -> None:
        super().__init__(logging.ERROR)
        self._tell = tell

    def emit(self, record: logging.LogRecord) -> None:
        self._tell(record)


def _without_gl() -> None:
    """Image layers ask GL for its limits, which crashes without a display. Private names."""
    for module, name, value in (
        ("napari._vispy.layers.image", "get_gl_extensions", ""),
        ("napari._vispy.canvas", "get_max_texture_sizes", (2048, 2048)),
        ("napari._vispy.layers.base", "get_max_texture_sizes", (2048, 2048)),
        ("napari._vispy.layers.image", "get_max_texture_sizes", (2048, 2048)),
        ("napari._vispy.layers.labels", "get_max_texture_sizes", (2048, 2048)),
    ):
        found = importlib.import_module(module)
        if hasattr(found, name):
            setattr(found, name, lambda value=value: value)
