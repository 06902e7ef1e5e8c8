"""Times what is called on the main thread while the widget is at work."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np


class Watch:
    """Times what Qt and napari call of the widget's code, and the gaps between two beats."""

    def __init__(self) -> None:
        self.longest: dict[str, float] = {}
        self.collecting: dict[str, float] = {}  # s of the longest: collections of garbage
        self.collections: list[tuple[int, float]] = []  # generation, s: in whatever thread
        self._collecting = self._began = 0.0  # s of all of them; when the present one began
        gc.callbacks.append(self._collected)
        self.computing: dict[str, float] = {}  # s: the same, while the processor was at it
        self.napari = 0.0  # s: the longest that napari took for what is left out
        self._left_out = np.zeros(2)  # s, in what is timed, and of the processor
        self.gaps: list[float] = []
        self._depth = 0
        self._last = 0.0

    def over(self, owner: type, *names: str) -> None:
        """Time methods of a class; one that another one calls counts as part of that."""
        for name in names:
            setattr(owner, name, self._timed(getattr(owner, name), f"{owner.__name__}.{name}"))

    def leave_out(self, owner: type, name: str) -> None:
        """Time what napari does once by itself."""
        method = getattr(owner, name)

        @wraps(method)
        def timed(*args: Any, **options: Any) -> None:
            start = _now()
            method(*args, **options)
            taken = _now() - start
            self._left_out += taken
            self.napari = max(self.napari, taken[0])

        setattr(owner, name, timed)

    def slots(self) -> tuple[list[tuple[str, float]], float, float]:
        """The longest, ms, by name; the most of the processor; and collecting in the longest.

        They are forgotten.
        """
        found = sorted(((n, 1e3 * s) for n, s in self.longest.items()), key=lambda x: -x[1])
        computing = 1e3 * max(self.computing.values())
        collecting = 1e3 * self.collecting[found[0][0]]
        self.longest, self.computing, self.collecting = {}, {}, {}
        return found[:4], computing, collecting

    def beat(self) -> None:
        """The timer's slot."""
        now = time.perf_counter()
        if self._last:
            self.gaps.append(now - self._last)
        self._last = now

    def _collected(self, phase: str, info: dict[str, int]) -> None:
        """Called by Python, before and after it collects garbage; no thread runs meanwhile."""
        if phase == "start":
            self._began = time.perf_counter()
        else:
            taken = time.perf_counter() - self._began
            self._collecting += taken
            self.collections.append((info["generation"], taken))

    def _timed(self, method: Callable[..., Any], name: str) -> Callable[..., Any]:
        @wraps(method)
        def timed(*args: Any, **options: Any) -> Any:
            start, collecting = _now(), self._collecting
            self._left_out *= bool(self._depth)
            self._depth += 1
            try:
                return method(*args, **options)
            finally:
                self._depth -= 1
                if not self._depth:
                    taken = _now() - start - self._left_out
                    if taken[0] > self.longest.get(name, 0.0):
                        self.collecting[name] = self._collecting - collecting
                    for longest, s in zip((self.longest, self.computing), taken, strict=True):
                        longest[name] = max(longest.get(name, 0.0), float(s))

        return timed


def _now() -> np.ndarray:
    """s: by the clock, and of the processor in this thread."""
    return np.array([time.perf_counter(), time.thread_time()])


def watched() -> Watch:
    """A watch over everything that is called on the main thread while a fit runs."""
    from napari.components import LayerList
    from napari.utils import progress
    from qtpy import API_NAME
    from vispy.app import use_app

    from napari_deltamic.gui.results.more_actions import SessionBar
    from napari_deltamic.gui.running.edits import Edits
    from napari_deltamic.gui.running.history_bar import HistoryBar
    from napari_deltamic.gui.running.run_control import RunControl
    from napari_deltamic.gui.seeding.seeds_panel import SeedsPanel
    from napari_deltamic.gui.settings.settings_panel import SettingsPanel
    from napari_deltamic.gui.viewing.viewer_link import ViewerLink
    from napari_deltamic.gui.work import Background, Work

    watch = Watch()
    watch.leave_out(LayerList, "insert")
    watch.leave_out(progress, "__init__")
    canvas = use_app(API_NAME.lower()).backend_module.CanvasBackend
    watch.leave_out(canvas, "paintGL")  # Qt may ask for it at any time
    watch.over(Work, "_tick", "start", "stop")
    watch.over(Background, "_look", "_waited")
    watch.over(RunControl, "start")
    watch.over(SeedsPanel, "_look")
    watch.over(SessionBar, "_go_on")
    watch.over(SettingsPanel, "_edited")
    watch.over(ViewerLink, "slice_changed")
    watch.over(HistoryBar, "_slid")
    watch.over(Edits, "shift")
    return watch
