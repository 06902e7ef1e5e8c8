"""How long the widget keeps the event loop from its work while a fit runs, and how often it shows.

Each scene runs in a process of its own, once without a display (Qt's offscreen platform, the
viewer's model) and once in a window under Xvfb, where the pictures are drawn in software. While the
fit goes on, a user moves through the slices, looks back and nudges the surface. Then what it
reached is saved, and opened in another window. What napari takes to draw, to add a layer, and to
begin a row of its activity dock, which paints the window, is told apart.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from .event_loop_watch import watched
from .figure import Figure, MissingData, Options, Row, at_least, at_most

BLOCK = 50.0  # ms: the longest that code of ours may take at a time while a fit runs
SESSION = 100.0  # ms: the same while a session is opened
UPDATES = 10.0  # a second, where the fit is that fast
BEAT = 5  # ms between two beats of the timer that is watched
SCENES = ("two cells", "10,000 vertices")
PLATFORMS = ("offscreen", "xvfb")


def event_loop(options: Options) -> list[Row]:
    """Longest block of our slots and updates a second, of each scene on each platform."""
    seconds = 4 if options.quick else 12
    rows: list[Row] = []
    for platform in PLATFORMS:
        for scene in SCENES:
            rows += _rows(scene, platform, seconds)
    return rows


FIGURES: dict[str, Figure] = {"event-loop": event_loop}


def _rows(scene: str, platform: str, seconds: float) -> list[Row]:
    name = f"event loop, {scene}, {platform}"
    try:
        found = _in_process(scene, platform, seconds)
    except MissingData as missing:
        return [Row(name, "", math.nan, "", None, str(missing))]
    slots, session = (
        ", ".join(f"{n} {ms:.0f}" for n, ms in found[f"{of}slots_ms"])
        + f"; processor at most {found[f'{of}computing_ms']:.0f} ms; of the longest, "
        f"{found[f'{of}collecting_ms']:.0f} ms are garbage collection"
        for of in ("", "session_")
    )
    rate = found["iterations_per_second"]
    # A fit that is slower than that cannot be shown more often.
    bar = min(UPDATES, 0.8 * rate)
    wanted = f"{rate:.0f} iterations a second"
    return [
        at_most(f"{name}: longest block of our code", BLOCK, found["block_ms"], "ms", slots),
        at_most(
            f"{name}: longest block while a session is opened",
            SESSION,
            found["session_ms"],
            "ms",
            session,
        ),
        at_least(f"{name}: updates", round(bar, 2), found["updates_per_second"], "1/s", wanted),
        Row(
            f"{name}: longest gap of a {BEAT} ms timer",
            "",
            found["gap_ms"],
            "ms",
            None,
            f"99 % of gaps below {found['gap_99_ms']:.0f} ms; drawing and napari included",
        ),
        Row(
            f"{name}: longest collection of Python's garbage",
            "",
            found["collection_ms"],
            "ms",
            None,
            found["collections"],
        ),
        Row(
            f"{name}: longest that napari takes to draw, or to add a layer or a progress",
            "",
            found["napari_ms"],
            "ms",
            None,
            "not counted above",
        ),
    ]


def _in_process(scene: str, platform: str, seconds: float) -> dict[str, Any]:
    words = [sys.executable, "-X", "faulthandler", "-m", f"{__package__}.event_loop"]
    words += [scene, str(seconds)]
    environment = dict(os.environ)
    if platform == "offscreen":
        environment["QT_QPA_PLATFORM"] = "offscreen"
        environment.pop("DISPLAY", None)
    else:
        if shutil.which("xvfb-run") is None:
            raise MissingData("no xvfb-run")
        environment["QT_QPA_PLATFORM"] = "xcb"
        words = ["xvfb-run", "-a", "-s", "-screen 0 1400x1000x24", *words]
    done = subprocess.run(
        words,
        env=environment,
        cwd=Path(__file__).resolve().parents[1],
        capture_output=True,
        text=True,
        timeout=20 * seconds + 300,
        check=False,
    )
    if done.returncode:
        print(done.stderr, file=sys.stderr)  # with the stack, where it crashed
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise MissingData(f"ended with {done.returncode}: {last}")
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


# ------------------------------------------------------------------------------- in the process


def _note(times: list[float], snapshot: Any) -> None:
    times.append(time.perf_counter())


def measure(scene: str, seconds: float) -> dict[str, Any]:
    """Run the widget on a scene, and watch."""
    from qtpy.QtCore import Qt, QTimer
    from qtpy.QtWidgets import QApplication

    app = QApplication.instance() or QApplication([])
    watch = watched()
    viewer, widget = _opened(scene)
    snapshots: list[float] = []
    noted = partial(_note, snapshots)
    widget.doc.shown.connect(noted)
    timer = QTimer()
    timer.setTimerType(Qt.TimerType.PreciseTimer)
    timer.timeout.connect(watch.beat)
    widget.start()
    while widget.doc.run.running and not snapshots:
        app.processEvents()
    timer.start(BEAT)
    n, start = len(widget.doc.run.history.loss), time.perf_counter()
    user, next_step = _user(viewer, widget), start
    while widget.doc.run.running and time.perf_counter() - start < seconds:
        app.processEvents()
        time.sleep(0.0005)  # an idle event loop sleeps
        if time.perf_counter() > next_step:
            next(user)
            next_step += 0.15
    taken = time.perf_counter() - start
    iterations, shown = len(widget.doc.run.history.loss) - n, sum(t > start for t in snapshots)
    widget.stop()
    while widget.doc.run.running:
        app.processEvents()
    timer.stop()
    slots, computing, collecting = watch.slots()
    result = {
        "block_ms": slots[0][1],
        "collecting_ms": collecting,
        "computing_ms": computing,
        "slots_ms": slots,
        "updates_per_second": shown / taken,
        "iterations_per_second": iterations / taken,
        "gap_ms": 1e3 * max(watch.gaps),
        "gap_99_ms": 1e3 * float(np.quantile(watch.gaps, 0.99)),
        "vertices": len(widget.doc.link.mesh.vertices),
    }
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.deltamic"
        _wait(lambda: not widget.judging.background.busy)
        widget.sessions.save(str(path))
        _wait(lambda: not widget.sessions.busy)
        widget.close_links()
        watch.slots()
        _, widget = _window()
        widget.sessions.open(str(path))
        _wait(lambda: widget.doc.result is not None and not widget.judging.background.busy)
        _wait(lambda: not widget.settings.forecast.background.busy, 0.5)
        widget.close_links()
    session, computing, collecting = watch.slots()
    full = sorted(1e3 * s for generation, s in watch.collections if generation == 2)
    return {
        **result,
        "session_ms": session[0][1],
        "session_computing_ms": computing,
        "session_slots_ms": session,
        "session_collecting_ms": collecting,
        "collection_ms": 1e3 * max((s for _, s in watch.collections), default=0.0),
        "collections": f"{len(watch.collections)}, {len(full)} of them of all there is: "
        + (f"{full[0]:.0f} to {full[-1]:.0f} ms each" if full else "none"),
        "napari_ms": 1e3 * watch.napari,
    }


def _wait(until: Callable[[], bool], rest: float = 0.1) -> None:
    """Let events happen until something is true, and a little (s) longer."""
    from qtpy.QtWidgets import QApplication

    app: Any = QApplication.instance()
    end = math.inf
    while time.perf_counter() < end:
        app.processEvents()
        time.sleep(0.0005)
        if end == math.inf and until():
            end = time.perf_counter() + rest


def _window() -> tuple[Any, Any]:
    """A viewer and the widget in it."""
    import napari
    from napari.components import ViewerModel

    from napari_deltamic.gui.fit_widget import FitWidget

    shown = os.environ.get("QT_QPA_PLATFORM") != "offscreen"
    viewer = napari.Viewer(show=True) if shown else ViewerModel()
    widget = FitWidget(viewer)
    if shown:
        viewer.window.add_dock_widget(widget, name="deltaMic")
    return viewer, widget


def _opened(scene: str) -> tuple[Any, Any]:
    """A viewer with the scene, and the widget, ready to start."""
    from napari_deltamic.geometry import sphere
    from napari_deltamic.scene import samples

    viewer, widget = _window()
    sample = samples.two_cell_sample() if scene == SCENES[0] else samples.vesicle_sample()
    units = ("um",) * 3
    viewer.add_image(sample.image, scale=sample.grid.voxel_size, units=units, name="image")
    if scene == SCENES[0]:
        widget.seeds.place.click()
        viewer.layers["seeds"].add(sample.centers)
    else:
        start = sphere(sample.centers[0], 2.6, edge_length=0.088)
        mesh = (start.vertices_numpy(), start.faces)
        widget.seeds.cells.choose(viewer.add_surface(mesh, units=units, name="start"))
        widget.settings.fields["remesh"].setChecked(False)  # to so many
    # A fit that does not end while it is watched.
    widget.settings.max_iterations.setValue(100_000)
    viewer.dims.set_point(0, float(sample.centers[0][0]))
    return viewer, widget


def _user(viewer: Any, widget: Any) -> Any:
    """What someone does meanwhile, a step at a time."""
    history, random = widget.running.history, np.random.default_rng(0)
    middle = viewer.dims.point[0]
    while True:
        for step in range(8):
            viewer.dims.set_point(0, middle + 0.3 * (step - 4))
            yield
        for share in (0.1, 0.5, 0.8, 1.0):
            history.slider.setValue(int(share * history.slider.maximum()))
            yield
        if widget.doc.present() is not None:
            mesh = widget.doc.link.mesh  # the fit may be ahead of it
            shift = np.zeros((len(mesh.vertices), 3))
            shift[: len(shift) // 10] = random.normal(scale=0.1, size=3)
            widget.edits.shift(shift, "nudge", mesh)
        yield
        viewer.dims.ndisplay = 3
        for _ in range(8):
            yield
        viewer.dims.ndisplay = 2
        widget.doc.look("image" if widget.doc.view == "rendered" else "rendered")
        yield


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        print(json.dumps(measure(sys.argv[1], float(sys.argv[2]))), flush=True)
        os._exit(0)  # what napari and Qt do while they are taken down is no part of this
