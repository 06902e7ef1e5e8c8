"""Figures of the closed form: precision and rates, the paper's scheme beside it."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from napari_deltamic import Mesh, fourier
from napari_deltamic.fourier.closed_form import band_ft

from . import paper_scheme
from .figure import (
    Figure,
    Options,
    Row,
    at_least,
    at_most,
    cow,
    narrow_band,
    small_sphere,
    sphere_of,
    tensors,
    timed_together,
    wavevectors,
)

# --------------------------------------------------------------------------------- precision


def adversarial_triangles(options: Options) -> list[Row]:
    """Worst errors of mesh_ft on triangles that break formulas: those that the tests measure."""
    folder = Path(__file__).resolve().parents[1] / "tests"
    path = folder / "stability" / "triangle_errors.py"
    beside = [str(folder), str(path.parent)]  # for the modules that it imports
    sys.path[:0] = beside
    try:
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    except (ImportError, OSError) as missing:
        return [Row("adversarial triangles", "", float("nan"), "", None, str(missing))]
    finally:
        for each in beside:
            sys.path.remove(each)
    table = module.worst_errors()
    rows = []
    for kind, bar in module.BAR.items():
        paths = [path for path in table if path.endswith(kind)]
        for quantity in module.QUANTITIES:
            path = max(paths, key=lambda p: table[p][quantity])
            figure = f"adversarial triangles, worst {quantity}, {kind}"
            note = f"of {len(paths)} paths: {path.removesuffix(f', {kind}')}"
            rows.append(at_most(figure, bar, table[path][quantity], "relative", note))
    return rows


def gradient_precision(options: Options) -> list[Row]:
    """Vertex gradients of whole meshes in f32 against f64, the paper's scheme beside ours."""
    rows: list[Row] = []
    band = narrow_band()
    generator = torch.Generator().manual_seed(1)
    every = torch.from_numpy(wavevectors(band))
    some = torch.randperm(len(every), generator=generator)[: 300 if options.quick else 1500]
    xi = every[some]
    meshes = {"cow": cow(options), "icosphere": sphere_of(1280, 100, 30.0)}
    for name, mesh in meshes.items():
        v, f = tensors(mesh)
        v = v - v.mean(0)  # what single precision likes best
        grad = torch.randn(len(xi), dtype=torch.complex128, generator=generator)
        exact = torch.ops.deltamic.mesh_ft_backward(grad, v, f, _ones(f), xi, False)[0]
        ours = torch.ops.deltamic.mesh_ft_backward(grad, v, f, _ones(f), xi, True)[0]
        theirs = paper_scheme.gradient(v, f, xi, grad, 16).to(torch.float64)
        theirs_double = paper_scheme.gradient(v, f, xi, grad, 16, torch.float64)
        on_band = torch.randn(band.count, dtype=torch.complex128, generator=generator)
        backward = torch.ops.deltamic.band_ft_backward
        single, double = (
            backward(on_band, v, f, _ones(f), band.rows, band.spacing, s)[0] for s in (True, False)
        )
        what = f"vertex gradient f32 vs f64, {name}, {len(f)} faces"
        rows += _compared(f"{what}: ours, {len(xi)} wavevectors", ours, exact, asked=True)
        rows += _compared(f"{what}: ours, 1 % band", single, double, asked=True)
        rows += _compared(f"{what}: the paper's scheme", theirs, exact, asked=False)
        rows += _compared(f"{what}: the paper's in f64", theirs_double, exact, asked=False)[:1]
    return rows


def _compared(figure: str, a: Tensor, b: Tensor, asked: bool) -> list[Row]:
    relative = float((a - b).norm() / b.norm())
    cosine = float((a * b).sum() / (a.norm() * b.norm()))
    if asked:
        return [
            at_most(f"{figure}, relative", 1e-5, relative, "relative"),
            at_least(f"{figure}, cosine", 0.999995, cosine, ""),
        ]
    return [
        Row(f"{figure}, relative", "", relative, "relative", None),
        Row(f"{figure}, cosine", "", cosine, "", None),
    ]


# ------------------------------------------------------------------------------------- rates


def small_triangle_rate(options: Options) -> list[Row]:
    """Closed form with every edge below 0.66 sigma, and its ratio to the paper's scheme."""
    mesh, band = small_sphere(), narrow_band()
    v, f = tensors(mesh)
    order = torch.randperm(band.count, generator=torch.Generator().manual_seed(1))
    xi = torch.from_numpy(wavevectors(band))[order]
    # Unlike ours, their f32 phases come from coordinates, so these are given about the centre.
    centred = v - v.mean(0)
    chunks = [paper_scheme.best_chunk(centred, f, xi, 2.0, select=s) for s in (False, True)]
    count = 256 if options.quick else 1024

    def paper(select: bool) -> Callable[[], object]:
        chunk = chunks[select]
        return lambda: paper_scheme.transform(centred, f, xi[:count], chunk, select=select)

    ours, patched, selected = timed_together(
        [_forward(mesh), paper(False), paper(True)], options.repeats
    )
    pairs, theirs = band.count * len(f), count * len(f)
    note = f"{len(f)} faces, {band.count} wavevectors; {ours.note()}"
    what = "closed form, small triangles, forward"
    rows = [
        at_least(what, 2e9, pairs / ours.wall, "pairs/s", note),
        Row(f"{what}, per core", "", pairs / ours.cpu, "pairs/s", None, "of CPU time"),
    ]
    for name, timing, chunk, asked in (
        ("", patched, chunks[0], True),
        (", special cases by selection", selected, chunks[1], False),
    ):
        rate = theirs / timing.wall
        ratio = pairs / ours.wall / rate
        in_cpu = pairs / ours.cpu / (theirs / timing.cpu)
        note = f"chunk {chunk}, f32; {timing.note()}"
        rows.append(Row(f"paper's scheme{name}, forward", "", rate, "pairs/s", None, note))
        name, note = f"closed form over paper's scheme{name}", f"{in_cpu:.0f} in CPU time"
        bar = at_least(name, 300, ratio, "x", note)
        rows.append(bar if asked else replace(bar, asked="", passed=None))
    return rows


def mixed_triangle_rate(options: Options) -> list[Row]:
    """Closed form on triangles of all sizes, forward and backward."""
    mesh, band = cow(options), narrow_band()
    forward, backward = timed_together([_forward(mesh), _backward(mesh)], options.repeats)
    pairs = band.count * len(mesh.faces)
    size = f"{len(mesh.faces)} faces, {band.count} wavevectors"
    return [
        at_least(
            "closed form, mixed sizes, forward",
            5e8,
            pairs / forward.wall,
            "pairs/s",
            f"{size}; {forward.note()}",
        ),
        Row(
            "closed form, mixed sizes, backward",
            "",
            pairs / backward.wall,
            "pairs/s",
            None,
            backward.note(),
        ),
        at_most(
            "closed form, mixed sizes, backward over forward",
            3,
            backward.wall / forward.wall,
            "x",
            f"{backward.cpu / forward.cpu:.2f} in CPU time",
        ),
    ]


def simd_levels(options: Options) -> list[Row]:
    """Rate of the closed form with each instruction set."""
    module = fourier.native()
    if module is None:
        return [Row("SIMD levels", "", float("nan"), "pairs/s", None, "no compiled extension")]
    rows = []
    band, small, mixed = narrow_band(), small_sphere(), cow(options)
    for level in module.simd_levels():
        with _environment("DELTAMIC_SIMD", level):
            for name, mesh in (("small triangles", small), ("mixed sizes", mixed)):
                forward, backward = timed_together([_forward(mesh), _backward(mesh)], 3)
                pairs = band.count * len(mesh.faces)
                for way, timing in (("forward", forward), ("backward", backward)):
                    figure, note = f"{level}, {name}, {way}", f"{pairs / timing.cpu:.3g} per core"
                    rows.append(Row(figure, "", pairs / timing.wall, "pairs/s", None, note))
    return rows


def _forward(mesh: Mesh) -> Callable[[], Tensor]:
    v, f = tensors(mesh)
    band, ones = narrow_band(), _ones(f)
    return lambda: band_ft(v, f, ones, band.rows, band.spacing, True)


def _backward(mesh: Mesh) -> Callable[[], object]:
    v, f = tensors(mesh)
    band, ones = narrow_band(), _ones(f)
    generator = torch.Generator().manual_seed(1)
    grad = torch.randn(band.count, dtype=torch.complex64, generator=generator)
    backward = torch.ops.deltamic.band_ft_backward
    return lambda: backward(grad, v, f, ones, band.rows, band.spacing, True)


# ------------------------------------------------------------------------------------ helpers


def _ones(faces: Tensor) -> Tensor:
    return torch.ones(len(faces), dtype=torch.float64)


@contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


FIGURES: dict[str, Figure] = {
    "adversarial-triangles": adversarial_triangles,
    "gradient-precision": gradient_precision,
    "small-triangle-rate": small_triangle_rate,
    "mixed-triangle-rate": mixed_triangle_rate,
    "simd-levels": simd_levels,
}
