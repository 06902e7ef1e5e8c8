"""All that a GPU is asked for, in one table: ``python -m benchmarks.gpu``.

Runs the GPU tests, then measures: rates of the closed form and its share of the chip's peak, an
iteration of a fit, a whole fit. Without a GPU it says what is missing and ends.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from napari_deltamic import Mesh, fit, render
from napari_deltamic.fourier import Band
from napari_deltamic.fourier.closed_form import band_ft
from napari_deltamic.fourier.cuda import compiler, missing
from napari_deltamic.fourier.cuda.points import cufinufft
from napari_deltamic.fourier.cuda.transform import SINGLE
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.settings import FitSettings

from .__main__ import as_table, measure
from .figure import (
    Figure,
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
# Of a small triangle at one wavevector, multiplications and additions: those of small_value in
# csrc/triangle_ft.h, two to place it on its line, and eight and six for the exponential's part.
FLOPS_PER_PAIR = 46
LANES = 128  # float units of a multiprocessor since compute capability 8.6, and of 9.0
FEWER_LANES = {(7, 5): 64, (8, 0): 64}


def seconds(function: Callable[[], object], repeats: int) -> float:
    """Median by the device's own clock, after two calls to warm up."""
    for _ in range(2):
        function()
    found = []
    for _ in range(repeats):
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()  # type: ignore[no-untyped-call]
        function()
        end.record()  # type: ignore[no-untyped-call]
        end.synchronize()
        found.append(start.elapsed_time(end) / 1e3)
    return sorted(found)[len(found) // 2]


# ------------------------------------------------------------------------------------- tests


def tests(options: Options) -> list[Row]:
    """The GPU tests, the stability bars among them: how many failed."""
    command = [sys.executable, "-m", "pytest", "-q", str(ROOT / "tests" / "gpu")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
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


def _closed_form(mesh: Mesh, band: Band, single: bool) -> tuple[Callable[[], Tensor], ...]:
    v, f = (t.cuda() for t in tensors(mesh))
    ones = torch.ones(len(f), dtype=torch.float64, device="cuda")
    arguments = v, f, ones, band.rows, band.spacing, single
    grad = band_ft(*arguments)
    backward = torch.ops.deltamic.band_ft_backward
    return lambda: band_ft(*arguments), lambda: backward(grad, *arguments)


def rates(options: Options) -> list[Row]:
    """Pairs of a face and a wavevector per second; forward and backward, both types."""
    rows = []
    band = narrow_band(200)
    scenes = {"small triangles": small_sphere(200, 28.0), "mixed sizes": cow(options, 200)}
    for name, mesh in scenes.items():
        for single in (True, False):
            forward, backward = (
                seconds(f, options.repeats) for f in _closed_form(mesh, band, single)
            )
            pairs = band.count * len(mesh.faces)
            what = f"closed form, {name}, {'f32' if single else 'f64'}"
            note = f"{len(mesh.faces)} faces, {band.count} wavevectors, {1e3 * forward:.3g} ms"
            rate, ratio = pairs / forward, backward / forward
            if name == "small triangles" and single:
                rows.append(at_least(f"{what}, forward", 5e11, rate, "pairs/s", note))
                share, counted = 100 * rate * FLOPS_PER_PAIR / peak(), f"{FLOPS_PER_PAIR} a pair"
                rows.append(at_least(f"{what}, of the f32 peak", 30, share, "%", counted))
                rows.append(at_most(f"{what}, backward over forward", 2, ratio, "x"))
            else:
                rows.append(Row(f"{what}, forward", "", rate, "pairs/s", None, note))
                rows.append(Row(f"{what}, backward over forward", "", ratio, "x", None))
    return rows


def first_use(options: Options) -> list[Row]:
    """How long the kernels take to compile."""
    target = compiler.architecture(torch.cuda.get_device_capability())
    begun = time.perf_counter()
    compiler.compile_kernels(SINGLE, target)
    note = f"{target}, NVRTC {'.'.join(map(str, compiler.version()))}; once, then from disk"
    return [
        Row("compiling the kernels of one type", "", time.perf_counter() - begun, "s", None, note)
    ]


# ---------------------------------------------------------------------------------------- fits


def _iteration(mesh: Mesh, voxels: int, accuracy: float, iterations: int) -> tuple[float, str]:
    """Seconds of an iteration of the last level on the GPU, the plan made; and the method."""
    grid, optics = scene(voxels)
    placed = mesh.with_vertices(torch.tensor(mesh.vertices_numpy(), device="cuda"))
    with torch.no_grad():
        image = render(placed, grid, optics, accuracy).cpu()
    start = mesh.with_vertices(mesh.vertices_numpy() + 0.3)
    settings = FitSettings(
        device="cuda",
        accuracy=accuracy,
        levels=(1.0,),
        remesh=False,
        collisions=False,
        max_iterations=iterations,
    )
    states = fit(image, grid, start, optics, settings=settings)
    next(states)
    each = []
    for _ in range(iterations - 1):
        torch.cuda.synchronize()
        begun = time.perf_counter()
        next(states)
        torch.cuda.synchronize()
        each.append(time.perf_counter() - begun)
    return sorted(each)[len(each) // 2], "cufinufft" if cufinufft() else "closed form"


def iterations(options: Options) -> list[Row]:
    """One iteration of a fit, at two sizes."""
    count = 10 if options.quick else 40
    small, how = _iteration(cow(options, 200), 200, 1e-3, count)
    rows = [at_most("cow, 200^3, 1e-3, one iteration of a fit", 10, 1e3 * small, "ms", how)]
    large, how = _iteration(sphere_of(20_000, 500, 150.0), 500, 1e-3, count)
    rows.append(at_most("500^3, 20,000 faces, an iteration", 100, 1e3 * large, "ms", how))
    used = torch.cuda.max_memory_allocated() / 1e9
    rows.append(Row("its peak memory, torch's own", "", used, "GB", None))
    return rows


def sphere_to_cow(options: Options) -> list[Row]:
    """A whole fit, until it is within 0.05 voxel."""
    voxels = 200
    truth, (grid, optics) = cow(options, voxels), scene(voxels)
    image = render(truth, grid, optics, 1e-3)
    middle = (voxels - 1) / 2
    start = sphere((middle,) * 3, 0.25 * voxels, edge_length=0.02 * voxels)
    settings = FitSettings(device="cuda", accuracy=1e-3, collisions=False)
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


FIGURES: dict[str, Figure] = {
    "tests": tests,
    "first-use": first_use,
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
    parser.add_argument("--markdown", type=Path, help=f"put the table into this page ({PAGE.name})")
    given = parser.parse_args(arguments)
    if reason := missing():
        print(f"nothing to measure: {reason}", file=sys.stderr)
        return 2
    options = Options(given.quick, given.data) if given.data else Options(given.quick)
    rows: list[Row] = []
    for name in given.only or FIGURES:
        print(f"{name} ...", file=sys.stderr)
        rows += measure(FIGURES[name], name, options)
    p = torch.cuda.get_device_properties()
    said = f"{p.name}, {p.multi_processor_count} multiprocessors, torch {torch.__version__}"
    print(f"{said}\n{as_table(rows)}")
    if given.markdown:
        put_between(given.markdown, MARK, f"{said}\n\n{table(rows)}")
    return int(any(row.passed is False for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
