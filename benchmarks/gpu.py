"""All that a GPU is asked for, in one table: ``python -m benchmarks.gpu``.

Runs the GPU tests and measures: rates of the closed form and its share of the chip's peak, images
with their gradients, iterations of a fit, a whole fit. Each figure is printed, and put into the
page, as soon as it is there. Without a GPU it says what is missing and ends; ``--dry`` goes through
all of it on the CPU, with problems so small that the numbers mean nothing, to find out whether the
script runs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import torch
from torch import Tensor

from napari_deltamic import Mesh, fit, render
from napari_deltamic.fourier import Band
from napari_deltamic.fourier.closed_form import band_ft
from napari_deltamic.fourier.cuda import compiler, missing
from napari_deltamic.fourier.cuda.build import CLOSED_FORM, POINTS
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer, Scene

from .__main__ import as_table, measure
from .figure import (
    Options,
    Row,
    at_least,
    at_most,
    cow,
    narrow_band,
    scene,
    small_sphere,
    sphere_of,
    tensors,
)
from .page import put_between, table

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "benchmarks.md"
MARK = "gpu"
# Of a small triangle at one wavevector, multiplications and additions as the compiler leaves them:
# those of small_value in csrc/triangle_ft.h, two to place it on its line, and eight and six for the
# exponential's part.
FLOPS_PER_PAIR = 43
LANES = 128  # float units of a multiprocessor since compute capability 8.6, and of 9.0
# Voxels along an axis, and faces (None: the cow); bars of an image with its gradient and of an
# iteration, ms.
SIZES: tuple[tuple[int, int | None, int | None, int | None], ...] = (
    (40, 1280, None, None),
    (64, 1280, None, None),
    (64, 20_480, None, None),
    (128, 5120, None, None),
    (200, None, 3, 10),
    (500, 20_480, None, 100),
)
FEWER_LANES = {(7, 5): 64, (8, 0): 64}


@dataclass(frozen=True)
class Place(Options):
    """Where it is measured."""

    dry: bool = False
    cpu: bool = False

    @property
    def here(self) -> bool:
        """Whether on the CPU."""
        return self.dry or self.cpu

    @property
    def device(self) -> str:
        """Of torch."""
        return "cpu" if self.here else "cuda"

    def size(self, voxels: int) -> int:
        """Voxels along an axis."""
        return max(24, voxels // 16) if self.dry else voxels

    def now(self) -> float:
        """Seconds, once the device has done all that it was told to."""
        if not self.here:
            torch.cuda.synchronize()
        return time.perf_counter()


def seconds(function: Callable[[], object], place: Place) -> float:
    """Median by the device's own clock, after two calls to warm up."""
    for _ in range(2):
        function()
    found = []
    for _ in range(place.repeats):
        if place.here:
            begun = place.now()
            function()
            found.append(place.now() - begun)
            continue
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()  # type: ignore[no-untyped-call]
        function()
        end.record()  # type: ignore[no-untyped-call]
        end.synchronize()
        found.append(start.elapsed_time(end) / 1e3)
    return sorted(found)[len(found) // 2]


# ------------------------------------------------------------------------------------- tests


def tests(place: Place) -> list[Row]:
    """The GPU tests, the stability bars among them: how many failed."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", str(ROOT / "tests" / "gpu")]
    if not place.dry:
        command.remove("-x")
    stand_in = {"DELTAMIC_STAND_IN": "1"} if place.dry else {}
    environment = {**os.environ, **stand_in}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    lines = done.stdout.strip().splitlines() or [done.stderr.strip()]
    failed = sum(line.startswith(("FAILED", "ERROR")) for line in lines)
    if done.returncode:
        print(done.stdout[-4000:], file=sys.stderr)
    return [
        at_most("GPU tests that fail", 0, max(failed, int(done.returncode != 0)), "", lines[-1])
    ]


# --------------------------------------------------------------------------------- closed form


def peak() -> float:
    """Float operations per second of the chip, at its highest clock."""
    p = torch.cuda.get_device_properties()
    lanes = FEWER_LANES.get((p.major, p.minor), LANES)
    return 2.0 * p.multi_processor_count * lanes * _highest_clock()


def _highest_clock() -> float:
    """Hz, as the driver tells."""
    ask = ["nvidia-smi", "--query-gpu=clocks.max.sm", "--format=csv,noheader,nounits"]
    return 1e6 * float(subprocess.run(ask, capture_output=True, text=True).stdout.split()[0])


def _closed_form(
    mesh: Mesh, band: Band, single: bool, device: str
) -> tuple[Callable[[], Tensor], ...]:
    v, f = (t.to(device) for t in tensors(mesh))
    ones = torch.ones(len(f), dtype=torch.float64, device=device)
    arguments = v, f, ones, band.rows, band.spacing, single
    grad = band_ft(*arguments)
    backward = torch.ops.deltamic.band_ft_backward
    return lambda: band_ft(*arguments), lambda: backward(grad, *arguments)


def rates(place: Place) -> list[Row]:
    """Pairs of a face and a wavevector per second; forward and backward, both types."""
    rows: list[Row] = []
    n = place.size(200)
    band = narrow_band(n)
    scenes = {"small triangles": small_sphere(n, 0.14 * n), "mixed sizes": _cow(place, n)}
    for name, mesh in scenes.items():
        for single in (True, False):
            forward, backward = (
                seconds(f, place) for f in _closed_form(mesh, band, single, place.device)
            )
            pairs = band.count * len(mesh.faces)
            what = f"closed form, {name}, {'f32' if single else 'f64'}"
            note = f"{len(mesh.faces)} faces, {band.count} wavevectors, {1e3 * forward:.3g} ms"
            rate, ratio = pairs / forward, backward / forward
            if name == "small triangles" and single:
                rows.append(at_least(f"{what}, forward", 5e11, rate, "pairs/s", note))
                most = 1e11 if place.dry else peak()
                share, counted = 100 * rate * FLOPS_PER_PAIR / most, f"{FLOPS_PER_PAIR} a pair"
                rows.append(at_least(f"{what}, of the f32 peak", 30, share, "%", counted))
                rows.append(at_most(f"{what}, backward over forward", 2, ratio, "x"))
            else:
                rows.append(Row(f"{what}, forward", "", rate, "pairs/s", None, note))
                rows.append(Row(f"{what}, backward over forward", "", ratio, "x", None))
    return rows


def _cow(place: Place, voxels: int) -> Mesh:
    return sphere_of(600, voxels, 0.3 * voxels) if place.dry else cow(place, voxels)


def first_use(place: Place) -> list[Row]:
    """How long the kernels take to compile."""
    capability = (9, 0) if place.dry else torch.cuda.get_device_capability()
    target = compiler.architecture(capability)
    rows = []
    for name, build in (("the closed form", CLOSED_FORM[True]), ("points", POINTS[True])):
        begun = time.perf_counter()
        compiler.compile_kernels(build, target)
        note = f"{target}, NVRTC {'.'.join(map(str, compiler.version()))}; once, then from disk"
        what = f"compiling {name}, f32"
        rows.append(Row(what, "", time.perf_counter() - begun, "s", None, note))
    return rows


# ---------------------------------------------------------------------------------------- fits


def _evaluation(place: Place, mesh: Mesh, voxels: int) -> tuple[float, str]:
    """Seconds of an image and its gradient by the vertices; and how they are computed."""
    grid, optics = scene(voxels)
    renderer = Renderer(Scene.of(mesh, optics), grid, 1e-3, device=place.device)
    v = torch.tensor(mesh.vertices_numpy(), device=place.device, requires_grad=True)
    otf = renderer.otf(optics)
    with torch.no_grad():
        weights = renderer.image(renderer.transform(v), otf)

    def once() -> object:
        image = renderer.image(renderer.transform(v), otf)
        return torch.autograd.grad(image, v, weights)

    return seconds(once, place), f"{renderer.plan.method}, {renderer.plan.points} points"


def _iteration(
    place: Place, mesh: Mesh, voxels: int, iterations: int, guard: bool = False
) -> tuple[float, str]:
    """Seconds of an iteration of the last level, the plan made; and the method.

    The median of all but the first three: some iterations look at the fit, and renew its plan.
    """
    grid, optics = scene(voxels)
    accuracy = 1e-3
    placed = mesh.with_vertices(torch.tensor(mesh.vertices_numpy(), device=place.device))
    with torch.no_grad():
        image = render(placed, grid, optics, accuracy).cpu()
    start = mesh.with_vertices(mesh.vertices_numpy() + 0.3)
    settings = FitSettings(
        device=place.device,
        accuracy=accuracy,
        levels=(1.0,),
        remesh=False,
        collisions=guard,
        tolerance=1e-12,
        max_iterations=iterations,
    )
    states = fit(image, grid, start, optics, settings=settings)
    spent = []
    for _ in range(iterations):
        begun = place.now()
        next(states)
        spent.append(place.now() - begun)
    each = median(spent[3:])
    return each, Renderer(Scene.of(start, optics), grid, accuracy, device=place.device).plan.method


def iterations(place: Place) -> list[Row]:
    """Images and iterations of a fit by size; with the guard against collisions as well."""
    count = 10 if place.quick else 41
    rows = []
    for voxels, faces, image_bar, bar in SIZES[-2:] if place.dry else SIZES:
        n = place.size(voxels)
        mesh = _cow(place, n) if faces is None else _ball(place, faces, n)
        name = f"{voxels}^3, {len(mesh.faces):,} faces"
        rows.append(
            _asked(f"{name}, an image and its gradient", image_bar, *_evaluation(place, mesh, n))
        )
        what = f"{name}, an iteration of a fit"
        rows.append(_asked(what, bar, *_iteration(place, mesh, n, count)))
        if bar is not None and not place.cpu:
            spent = _iteration(place, mesh, n, count, guard=True)
            rows.append(_asked(f"{what}, with the guard", None, *spent))
    used = 0.0 if place.here else torch.cuda.max_memory_allocated() / 1e9
    rows.append(Row("peak memory of all these, torch's own", "", used, "GB", None))
    return rows


def _asked(name: str, bar: float | None, spent: float, note: str) -> Row:
    """In ms, with a bar or without."""
    if bar is None:
        return Row(name, "", 1e3 * spent, "ms", None, note)
    return at_most(name, bar, 1e3 * spent, "ms", note)


def _ball(place: Place, faces: int, voxels: int) -> Mesh:
    return sphere_of(600 if place.dry else faces, voxels, 0.3 * voxels)


def sphere_to_cow(place: Place) -> list[Row]:
    """A whole fit, until it is within 0.05 voxel."""
    voxels = place.size(200)
    truth, (grid, optics) = _cow(place, voxels), scene(voxels)
    image = render(truth, grid, optics, 1e-3)
    middle = (voxels - 1) / 2
    start = sphere((middle,) * 3, 0.25 * voxels, edge_length=0.02 * voxels)
    settings = FitSettings(device=place.device, accuracy=1e-3, collisions=False)
    if place.dry:
        settings = settings.model_copy(update={"max_iterations": 60})
    begun, looked, when, distance = time.perf_counter(), 0.0, float("nan"), float("nan")
    count = 0
    for state in fit(image, grid, start, optics, settings=settings):
        count = state.iteration
        if state.level == state.levels and count % 10 == 0:
            look = time.perf_counter()
            distance = surface_distance(state.mesh, truth).mean
            if when != when and distance <= 0.05:
                when = look - begun - looked
            looked += time.perf_counter() - look
    whole = time.perf_counter() - begun - looked
    note = f"{count} iterations, {whole:.2f} s until it ends by itself"
    return [
        at_most("sphere -> cow, 200^3, until 0.05 voxel", 5, when, "s", note),
        at_most("sphere -> cow, 200^3, mean distance at the end", 0.05, distance, "voxel"),
    ]


FIGURES: dict[str, Callable[[Place], list[Row]]] = {
    "first-use": first_use,
    "tests": tests,
    "rates": rates,
    "iterations": iterations,
    "sphere-to-cow": sphere_to_cow,
}


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; 1 where a bar is missed, 2 where there is no GPU."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=FIGURES, help="some figures")
    parser.add_argument("--quick", action="store_true", help="fewer repeats")
    parser.add_argument("--data", type=Path, help="folder of meshes (DELTAMIC_DATA)")
    parser.add_argument("--page", type=Path, help=f"put the table into this page ({PAGE.name})")
    parser.add_argument("--cpu", action="store_true", help="images and iterations, on the CPU")
    parser.add_argument("--dry", action="store_true", help="on the CPU, to see whether it runs")
    given = parser.parse_args(arguments)
    if given.cpu and (given.only or given.page):
        parser.error("--cpu measures images and iterations, and writes no page")
    if not (given.dry or given.cpu) and (reason := missing()):
        print(f"nothing to measure: {reason}", file=sys.stderr)
        return 2
    place = Place(given.quick or given.dry, dry=given.dry, cpu=given.cpu)
    place = replace(place, data=given.data) if given.data else place
    said = "a dry run on the CPU" if given.dry else "on the CPU" if given.cpu else _device()
    rows: list[Row] = []
    for name in ["iterations"] if given.cpu else given.only or FIGURES:
        begun = time.perf_counter()
        figure = FIGURES[name]
        found = measure(lambda _, figure=figure: figure(place), name, place)
        if place.here:  # where the bars of a GPU do not hold
            found = [replace(row, passed=None) for row in found]
        rows += found
        print(f"{name}: {time.perf_counter() - begun:.0f} s\n{as_table(found)}\n", flush=True)
        if given.page and not place.here:
            put_between(given.page, MARK, f"{said}\n\n{table(rows)}")
    print(f"{said}\n{as_table(rows)}")
    return int(any(row.passed is False for row in rows))


def _device() -> str:
    p = torch.cuda.get_device_properties()
    return f"{p.name}, {p.multi_processor_count} multiprocessors, torch {torch.__version__}"


if __name__ == "__main__":
    raise SystemExit(main())
