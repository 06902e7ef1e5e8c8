"""How near the time that the window says comes to what a fit takes, on a machine that is new to it.

Eleven fits one after the other, of several samples and settings, in windows without a display;
nothing is known before the first. Counted are the ten after it: what stood beside the dial when
*Fit* was pressed, over what the fit took.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from .figure import Figure, MissingData, Options, Row, at_least

NEAR = 1.5  # a prediction is good within this factor
GOOD = 9  # so many of ten
LONGEST = 600.0  # s that anything may take
# Name, sample or (cells, seed) of a simulated one, and what is chosen otherwise than by default.
FITS: tuple[tuple[str, Any, dict[str, str]], ...] = (
    ("foam of 8", "foam", {}),
    ("two cells", "two_cell", {}),
    ("vesicle", "vesicle", {}),
    ("dividing cell", "dividing_cell", {}),
    ("two cells, quick", "two_cell", {"accuracy": "quick"}),
    ("foam of 8, uniform", "foam", {"density": "uniform"}),
    ("foam of 5", ("foam", 5, 1), {}),
    ("vesicles, 3", ("vesicles", 3, 2), {}),
    ("dividing cell, careful", "dividing_cell", {"accuracy": "careful"}),
    ("foam of 12", ("foam", 12, 3), {}),
    ("foam of 8, found", "foam", {"cells": "found"}),
)


def eta(options: Options) -> list[Row]:
    """How many of ten predictions were within a factor."""
    with TemporaryDirectory() as folder:
        environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen", "DELTAMIC_CACHE": folder}
        done = subprocess.run(
            [sys.executable, "-m", f"{__package__}.eta"],
            env=environment,
            cwd=Path(__file__).resolve().parents[1],
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
    if done.returncode:
        raise MissingData(f"ended with {done.returncode}")
    found = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    later = found[1:]
    near = sum(_is_near(one["said"] / one["took"]) for one in later)
    # The same for any load of the machine, which the time of an iteration is not.
    counted = sum(_is_near(one["expected_iterations"] / one["iterations"]) for one in later)
    told = "; ".join(f"{one['name']}: {one['said']:.1f} s, {one['took']:.1f} s" for one in found)
    bar = GOOD * len(later) / 10
    note = f"numbers of iterations alone: {counted}; said, and took: {told}"
    return [at_least(f"predictions within {NEAR} times", bar, near, "", note)]


def _is_near(ratio: float) -> bool:
    return 1 / NEAR <= ratio <= NEAR


FIGURES: dict[str, Figure] = {"eta": eta}


def measure(name: str, of: Any, chosen: dict[str, str]) -> dict[str, Any]:
    """What is said before a fit, and what it takes."""
    from napari.components import ViewerModel

    from napari_deltamic.accuracy.outlook import outlook
    from napari_deltamic.gui.fit_widget import FitWidget
    from napari_deltamic.gui.settings.accuracy_forecast import scene_now

    viewer = ViewerModel()
    widget = FitWidget(viewer)
    image, grid, places = _scene(of)
    viewer.add_image(image, scale=grid.voxel_size, units=("um",) * 3, name=name)
    if chosen.get("cells") == "found":
        widget.seeds.find_cells.start()
        _wait(lambda: not widget.seeds.find_cells.background.busy, 0.5)
    else:
        widget.seeds.place.click()
        viewer.layers["seeds"].add(places)
        _wait(lambda: widget.seeds.preview.mesh is not None)  # as a user sees it
    if "accuracy" in chosen:
        widget.doc.settings.show_accuracy(chosen["accuracy"])
    if "density" in chosen:
        widget.settings.density.setCurrentText(chosen["density"])
    _wait(lambda: not widget.settings.forecast.background.busy, 1.0)
    expected = outlook(scene_now(widget.doc)).forecast
    said = expected.after(widget.doc.learned.about(expected.kind)).seconds
    widget.start()
    _wait(lambda: not widget.doc.run.running)
    run = widget.doc.run
    found = {
        "name": name,
        "kind": expected.kind,
        "unlearned": expected.seconds,
        "unlearned_iterations": expected.iterations,
        "said": said,
        "at_start": run.forecast.seconds,
        "took": run.seconds,
        "iterations": len(run.history.loss),
        "expected_iterations": run.forecast.iterations,
        "verdict": widget.doc.record.words,
    }
    _wait(lambda: not widget.judging.background.busy)
    widget.close_links()
    return found


def _scene(of: Any) -> tuple[Any, Any, Any]:
    """Image, grid and a place in each cell."""
    import numpy as np

    from napari_deltamic.measure import measure_cells
    from napari_deltamic.optics import GaussianPSF
    from napari_deltamic.scene import Grid, Scene, random_cells, samples, simulate
    from napari_deltamic.scene.structures import membranes_and_insides

    if isinstance(of, str):
        sample = getattr(samples, f"{of}_sample")()
        return sample.image, sample.grid, np.asarray(sample.centers)
    kind, cells, seed = of
    grid = Grid((44, 72, 72), (0.3, 0.2, 0.2))
    mesh = random_cells(cells, grid, kind, seed)
    scene = Scene(membranes_and_insides(mesh, 0.0), GaussianPSF((0.42, 0.24, 0.24)))
    made = simulate(scene, grid, photons=80, background=10, seed=seed)
    rows = measure_cells(mesh)
    return made.image, grid, np.array([[r[f"centroid_{a}_um"] for a in "zyx"] for r in rows])


def _wait(until: Callable[[], bool], rest: float = 0.1) -> None:
    """Let events happen until something is true, and a little (s) longer."""
    from qtpy.QtWidgets import QApplication

    app: Any = QApplication.instance()
    end, last = 0.0, time.monotonic() + LONGEST
    while not end or time.monotonic() < end:
        app.processEvents()
        time.sleep(0.001)
        if not end and until():
            end = time.monotonic() + rest
        if time.monotonic() > last:
            raise SystemExit("it took too long")


if __name__ == "__main__":
    from qtpy.QtWidgets import QApplication

    application = QApplication([])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for fit in FITS:
            print(json.dumps(measure(*fit)), flush=True)
    os._exit(0)  # what napari and Qt do while they are taken down is no part of this
