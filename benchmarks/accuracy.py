"""What accuracy costs in time and in shape: ``python -m benchmarks.accuracy``.

Measures the samples that come with the plugin and the two growth curves of the paper, and writes
tables and pictures into ``docs/accuracy.md``. A quarter of an hour on two cores.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from napari_deltamic import GaussianPSF, Grid, Mesh, fit, render
from napari_deltamic.accuracy.accuracy_chart import (
    shape_answer,
    shape_chart,
    shape_facts,
    short,
    way_facts,
    ways_chart,
)
from napari_deltamic.accuracy.calibration import calibrate
from napari_deltamic.accuracy.forecast import forecast
from napari_deltamic.accuracy.log_chart import Chart
from napari_deltamic.accuracy.shape_error import DRAWS, photons_for, shape_errors
from napari_deltamic.accuracy.tradeoff import Way, measure_ways, with_front
from napari_deltamic.common.words import duration
from napari_deltamic.fitting.model.default_accuracy import accuracy_for_image, image_noise
from napari_deltamic.fourier.cost import Costs
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import NEAR_LEVELS, FitSettings
from napari_deltamic.scene import samples

from .figure import SIGMA, MissingData, Options, cow, default_data_folder
from .growth_curves import by_size, by_triangles
from .page import put_between
from .tree import measured_on

PAGE = Path(__file__).resolve().parents[1] / "docs" / "accuracy.md"
SAMPLES = (samples.vesicle_sample, samples.two_cell_sample, samples.dividing_cell_sample)


@dataclass(frozen=True)
class Setting:
    """How much is measured, and where the pictures go."""

    quick: bool
    images: Path
    data: Path

    def picture(self, name: str, chart: Chart) -> str:
        """Write a picture; the markdown that shows it."""
        self.images.mkdir(parents=True, exist_ok=True)
        (self.images / f"{name}.png").write_bytes(chart.png())
        return f"![{chart.title}](images/{name}.png)"


# ------------------------------------------------------------------------------------ samples


def scenes(setting: Setting, costs: Costs, facts: dict[str, Any]) -> str:
    """Every way to render each sample: a picture, and the ways on the front."""
    parts = []
    for make in SAMPLES[:1] if setting.quick else SAMPLES:
        sample = make()
        used = accuracy_for_image(sample.image)
        budget = 0.3 if setting.quick else 10.0
        grid, optics = sample.grid, sample.optics
        ways = with_front(
            measure_ways(sample.truth, grid, optics, used, budget=budget, costs=costs)
        )
        facts[sample.name] = [way_facts(way) for way in ways]
        size = " x ".join(map(str, sample.grid.shape))
        title = f"{sample.name}: {size} voxels, {len(sample.truth.faces)} faces"
        name = f"accuracy_{sample.name.replace(' ', '_')}"
        parts += [f"### {title}", "", setting.picture(name, ways_chart(ways, title)), ""]
        parts += [front_table(ways), ""]
    return "\n".join(parts)


def front_table(ways: Sequence[Way]) -> str:
    """The ways on the front, the one in use and the reference, as markdown."""
    lines = [
        "| way | image | with gradient | memory | image error | gradient error | |",
        "|---|---:|---:|---:|---:|---:|---|",
    ]
    for way in sorted(ways, key=lambda w: w.gradient or w.expected):
        if not (way.on_front or way.in_use or way.reference):
            continue
        marks = [t for t, on in (("in use", way.in_use), ("reference", way.reference)) if on]
        memory = "-" if way.memory is None else f"{way.memory / 1e6:.0f} MB"
        errors = [
            "-" if e is None or way.reference else f"{e:.1e}"
            for e in (way.error, way.gradient_error)
        ]
        asked = f", asked {short(way.accuracy)}" if way.accuracy else ""
        times = [duration(t) if t else "-" for t in (way.forward, way.gradient)]
        name = way.name.replace("|", "\\|") + asked
        lines.append("| " + " | ".join([name, *times, memory, *errors, ", ".join(marks)]) + " |")
    return "\n".join(lines)


def shapes(setting: Setting, facts: dict[str, Any]) -> str:
    """The error of surfaces fitted to each sample, at its noise: a picture and the answer."""
    parts = []
    for make in SAMPLES[:1] if setting.quick else SAMPLES:
        sample = make()
        noise = image_noise(sample.image)
        photons = photons_for(noise, sample.truth, sample.grid, sample.optics)
        some: dict[str, Any] = {"draws": DRAWS}
        if setting.quick:
            short_fit = FitSettings(levels=NEAR_LEVELS, max_iterations=40)
            some = {"draws": 1, "choices": ("quick", "normal"), "settings": short_fit}
        found = list(shape_errors(sample.truth, sample.grid, sample.optics, photons, **some))
        voxel = min(sample.grid.voxel_size)
        facts[sample.name] = {"noise": noise, **shape_facts(found, voxel)}
        title = f"{sample.name}: error of the fitted surface"
        name = f"accuracy_shape_{sample.name.replace(' ', '_')}"
        parts += [f"### {title}", "", setting.picture(name, shape_chart(found, title)), ""]
        default = short(accuracy_for_image(sample.image))
        parts += [
            f"{shape_answer(found)} Noise of a voxel: {noise:.3f} of the range of the image; "
            f"the default for it is {default}.",
            "",
            "| choice | predicted | surface error | in voxels | spread | edges | time of a fit |",
            "|---|---:|---:|---:|---:|---:|---:|",
        ]
        parts += [
            f"| {e.choice} | {1e3 * e.dialled.predicted:.3g} nm | {1e3 * e.mean:.3g} nm "
            f"| {e.mean / voxel:.3f} | {1e3 * e.spread:.2g} nm | {e.dialled.edge:.2g} um "
            f"| {duration(e.seconds)} |"
            for e in found
        ]
        parts.append("")
    return "\n".join(parts)


# ------------------------------------------------------------------------------------ forecasts


def forecasts(setting: Setting, costs: Costs, facts: dict[str, Any]) -> str:
    """What was forecast of fits, and what they took."""
    lines = [
        "| fit | accuracy | ms an iteration: forecast | measured | ratio "
        "| s in all: forecast | measured | ratio |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    rows = []
    for name, image, grid, mesh, optics in _fits(setting):
        for accuracy in (1e-2,) if setting.quick else (1e-2, 1e-3):
            settings = FitSettings(accuracy=accuracy, max_iterations=60 if setting.quick else 3000)
            promise = forecast(image, grid, mesh, optics, settings, costs=costs)
            began = last = time.perf_counter()
            at_last: list[float] = []
            for state in fit(image, grid, mesh, optics, settings=settings):
                now = time.perf_counter()
                if state.level == promise.levels[-1].number:
                    at_last.append(now - last)
                last = now
            each = 1e3 * float(np.mean(at_last or [np.nan]))
            expected, whole = 1e3 * promise.seconds_per_iteration, last - began
            lines.append(
                f"| {name} | {short(accuracy)} | {expected:.3g} | {each:.3g} "
                f"| {expected / each:.2f} | {promise.seconds:.2g} | {whole:.2g} "
                f"| {promise.seconds / whole:.2f} |"
            )
            rows.append([name, accuracy, expected, each, promise.seconds, whole])
    facts["rows"] = rows
    return "\n".join(lines)


def _fits(setting: Setting) -> list[tuple[str, np.ndarray, Grid, Mesh, GaussianPSF]]:
    found = []
    for make in SAMPLES[:1] if setting.quick else SAMPLES:
        s = make()
        start = Mesh.merge([sphere(c, 2.0, edge_length=0.35) for c in s.centers])
        found.append((f"{s.name}, from a ball in each cell", s.image, s.grid, start, s.optics))
    if setting.quick:
        return found
    try:
        truth = cow(Options(data=setting.data))
    except MissingData:
        return found
    grid, optics = Grid((100,) * 3, (1.0,) * 3), GaussianPSF(SIGMA)
    image = render(truth, grid, optics, 1e-5).float().numpy()
    start = sphere((49.5,) * 3, 25.0, subdivisions=5)
    return [*found, ("cow, 100^3, from a sphere", image, grid, start, optics)]


# ------------------------------------------------------------------------------------- the page


def main(argv: Sequence[str]) -> int:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a little of everything")
    parser.add_argument("--page", type=Path, default=PAGE, help="the page; pictures in images/")
    parser.add_argument("--data", type=Path, default=default_data_folder())
    parser.add_argument("--json", type=Path, metavar="FILE")
    chosen = parser.parse_args(argv)
    setting = Setting(chosen.quick, chosen.page.parent / "images", chosen.data)
    facts: dict[str, Any] = {}
    text: dict[str, str] = {}
    costs = calibrate()
    parts: dict[str, Callable[[dict[str, Any]], str]] = {
        "scenes": lambda found: scenes(setting, costs, found),
        "shapes": lambda found: shapes(setting, found),
        "forecasts": lambda found: forecasts(setting, costs, found),
        "image-size": lambda found: by_size(setting.quick, setting.picture, found),
        "triangles": lambda found: by_triangles(setting.quick, setting.picture, found),
    }
    for name, part in parts.items():
        began = time.perf_counter()
        facts[name] = {}
        text[name] = part(facts[name])
        print(f"{name}: {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
    for name, found in text.items():
        put_between(chosen.page, name, found)
    if chosen.json:
        chosen.json.write_text(json.dumps({"where": measured_on(), **facts}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
