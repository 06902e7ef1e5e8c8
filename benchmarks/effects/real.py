"""Which effects real stacks call for: what was recommended, the evidence, what it changed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import FitState, GaussianPSF, Grid, Mesh, fit
from napari_deltamic.evidence import Recommendation, analyse_residual, recommend
from napari_deltamic.evidence.camera import camera_from_image
from napari_deltamic.evidence.estimate import Finding
from napari_deltamic.evidence.first_sigma import first_sigma
from napari_deltamic.evidence.slices import drift
from napari_deltamic.fitting import counted_voxels
from napari_deltamic.geometry import (
    find_cells,
    mesh_from_labels,
    read_points_csv,
    seeds_from_points,
    sphere,
)
from napari_deltamic.images.stacks import read_image
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import NEAR_LEVELS, FitSettings

from ..figure import MissingData

CENTRES = Path(__file__).parents[1] / "data_points" / "vesicles_GUV.csv"
GLANDS = ("gland_WT_2017-12-04_1a", "gland_WT_2018-04-10_2a")
_CELLS = 3  # of a cluster
_CELL, _EDGE, _GAP = 55.0, 5.0, 4.0  # voxels: of the embryo
_SETTINGS = FitSettings(fit_psf=True, density="smooth", levels=NEAR_LEVELS, max_iterations=250)
_NEAR = _SETTINGS.model_copy(update={"levels": (1.0,), "max_iterations": 120})
_HEADINGS = (
    "stack",
    "from the image alone",
    "recommended: score, predicted bias",
    "price, ms an iteration",
    "seen besides",
    "shape changed by",
    "unexplained",
    "CPU s of check, of all",
)


class Stack(NamedTuple):
    """A real image, a piece of it, and where to start.

    ``scaled`` tells whether the voxel size is known in um.
    """

    name: str
    whole: NDArray[np.float32]
    image: NDArray[np.float32]
    grid: Grid
    mesh: Mesh
    optics: GaussianPSF
    counted: NDArray[np.bool_] | None
    scaled: bool


Size = tuple[float, float, float]
Start = Callable[[NDArray[np.float32], Grid, Path], tuple[Mesh, Grid]]


def stacks(data: Path, only: str = "") -> Iterator[Stack]:
    """The real images that there are seeds for, whose names hold a text."""
    folder = data / "images"
    if not folder.is_dir():
        raise MissingData(f"no images at {folder}")
    known: list[tuple[str, Size, Size, Start, bool]] = [
        ("vesicles_GUV", (0.34, 0.133, 0.133), (0.41, 0.16, 0.16), _from_points, True),
        # Their sides are relative: the slices are as far apart as half a voxel is wide.
        *((name, (0.5, 1.0, 1.0), (1.2, 1.2, 1.2), _from_labels, False) for name in GLANDS),
        ("celegans_tp33half_bgsub", (4.0, 1.0, 1.0), (4.0, 1.4, 1.4), _found, False),
        ("bead2.5um_EPFL_25pct", (0.64, 0.258, 0.258), (0.77, 0.31, 0.31), _bead, True),
    ]
    for name, size, sigma, start, scaled in known:
        if only not in name:
            continue
        path = folder / f"{name}.tif"
        if not path.is_file():
            raise MissingData(f"no {path.name} at {folder}")
        whole = read_image(path)[0].astype(np.float32)
        mesh, grid = start(whole, Grid(whole.shape, size), path)
        image, optics = whole[_box(grid)], GaussianPSF(sigma)
        counted = None if start is _bead else counted_voxels(image, grid, mesh, optics)
        yield Stack(name, whole, image, grid, mesh, optics, counted, scaled)


def _box(grid: Grid) -> tuple[slice, ...]:
    """Voxels of the whole image, whose origin is 0, that a piece is."""
    first = np.rint(np.asarray(grid.origin) / np.asarray(grid.voxel_size)).astype(int)
    return tuple(slice(a, a + n) for a, n in zip(first, grid.shape, strict=True))


def _from_points(image: NDArray[np.float32], grid: Grid, path: Path) -> tuple[Mesh, Grid]:
    points, radii = read_points_csv(CENTRES)
    return seeds_from_points(image, grid.voxel_size, points, radii, grid.origin), grid


def _from_labels(image: NDArray[np.float32], grid: Grid, path: Path) -> tuple[Mesh, Grid]:
    return _piece(read_image(path.with_name(f"{path.stem}_labels.tif"))[0], grid)


def _found(image: NDArray[np.float32], grid: Grid, path: Path) -> tuple[Mesh, Grid]:
    labels = find_cells(image, grid.voxel_size, _CELL)
    return _piece(labels, grid, edge_length=_EDGE, gap=_GAP)


def _piece(labels: NDArray[np.integer], grid: Grid, **options: float) -> tuple[Mesh, Grid]:
    """The piece around a few cells in the middle, and whole meshes of all that reach into it."""
    size = np.asarray(grid.voxel_size)
    numbers = np.unique(labels[labels > 0])
    middles = np.array([np.argwhere(labels == k).mean(0) * size for k in numbers])
    start = middles[((middles - middles.mean(0)) ** 2).sum(1).argmin()]
    nearest = numbers[((middles - start) ** 2).sum(1).argsort()[:_CELLS]]
    at = np.argwhere(np.isin(labels, nearest))
    pad = np.ceil(3 / size).astype(int)
    first = np.maximum(at.min(0) - pad, 0)
    last = np.minimum(at.max(0) + 1 + pad, labels.shape)
    box = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
    seen = np.where(np.isin(labels, np.unique(labels[box])), labels, 0)
    mesh = mesh_from_labels(seen, grid.voxel_size, **options)
    z, y, x = (int(n) for n in last - first)
    return mesh, Grid((z, y, x), grid.voxel_size, tuple(float(c) for c in first * size))


def _bead(image: NDArray[np.float32], grid: Grid, path: Path) -> tuple[Mesh, Grid]:
    weight = np.clip(image - np.percentile(image, 99.5), 0, None)
    place = np.indices(image.shape).reshape(3, -1)
    middle = (place * weight.reshape(-1)).sum(1) / weight.sum() * grid.voxel_size
    return sphere(middle, 1.25, subdivisions=3), grid


def judged(stack: Stack) -> dict[str, str]:
    """A line of the table."""
    began = time.process_time()
    given = stack.image, stack.grid, stack.mesh, stack.optics
    *_, before = fit(*given, settings=_SETTINGS, counted=stack.counted)
    at = time.process_time()
    found = recommend(*given, _SETTINGS, counted=stack.counted, fitted=before)
    seconds = time.process_time() - at
    # Both go on from the first fit, so that nothing but the effects tells them apart.
    without = after = before
    if found.recommended:
        on = stack.image, stack.grid, before.mesh, before.optics.detach()
        *_, without = fit(*on, settings=_NEAR, counted=stack.counted)
        *_, after = fit(*on, settings=_NEAR, counted=stack.counted, effects=found.effects)
    taken = [e for e in found.evidence if e.recommended]
    shape = "x".join(map(str, stack.grid.shape))
    piece = "" if stack.image.shape == stack.whole.shape else f", {shape} voxels of it"
    return {
        "stack": f"{stack.name}{piece}",
        "from the image alone": alone(stack),
        "recommended: score, predicted bias": "; ".join(
            f"{e.name} {e.score:.1f}, {_length(e.bias_nm / 1e3, stack)}" for e in taken
        )
        or "none",
        "price, ms an iteration": ", ".join(f"{e.cost_ms:.0f}" for e in taken) or "-",
        "seen besides": besides(found),
        "shape changed by": _moved(without, after, stack),
        "unexplained": " -> ".join(_left(stack, s) for s in _different(without, after)),
        "CPU s of check, of all": f"{seconds:.0f}, {time.process_time() - began:.0f}",
    }


def alone(stack: Stack) -> str:
    """Gain, offset, saturation, drift and first width, without any fit."""
    camera, size = camera_from_image(stack.whole), stack.grid.voxel_size
    width = first_sigma(stack.whole, size)
    lean, jitter = drift(stack.whole, size)
    unit = " um" if stack.scaled else ""
    lines = [
        ("gain", camera.gain, ""),
        ("offset", camera.offset, ""),
        ("saturation", camera.saturation, ""),
        ("lean", lean, ""),
        ("jitter", jitter, unit),
        ("sigma z", width.z, unit),
        ("sigma yx", width.yx, unit),
    ]
    return ", ".join(f"{name} {_shown(f)}{u if f.known else ''}" for name, f, u in lines)


def _shown(finding: Finding) -> str:
    return "-" if finding.value is None else f"{finding.value:.2g}"


def besides(found: Recommendation) -> str:
    """What else was seen, and what a reader should know."""
    seen = [e for e in found.evidence if not e.recommended and abs(e.score) > found.threshold]
    shown = [f"{e.name} {e.score:.1f}, {e.bias_voxels:.3f} voxel" for e in seen]
    return "; ".join([*shown, *found.remarks]) or "-"


def _length(um: float, stack: Stack) -> str:
    voxels = f"{um / min(stack.grid.voxel_size[1:]):.2f} voxel"
    return f"{1e3 * um:.0f} nm ({voxels})" if stack.scaled else voxels


def _moved(before: FitState, after: FitState, stack: Stack) -> str:
    """Mean distance between the surfaces."""
    if after is before:
        return "-"
    return _length(surface_distance(before.mesh, after.mesh, 20_000).mean, stack)


def _different(before: FitState, after: FitState) -> tuple[FitState, ...]:
    return (before,) if after is before else (before, after)


def _left(stack: Stack, state: FitState) -> str:
    """Share of what varies beyond noise that a fit does not explain."""
    left = analyse_residual(stack.image, stack.grid, state, counted=stack.counted)
    return "-" if left.explained is None else f"{1 - left.explained:.1%}"


def real_table(data: Path, only: str = "") -> str:
    """The table, as Markdown."""
    lines = ["| " + " | ".join(_HEADINGS) + " |", "|" + "---|" * len(_HEADINGS)]
    for stack in stacks(data, only):
        row = judged(stack)
        lines.append("| " + " | ".join(row[h] for h in _HEADINGS) + " |")
        print(lines[-1], flush=True)
    note = (
        "Clusters by a piece around three cells in the middle; lengths are in voxels where the "
        "size of a voxel is not known. What accepting the effects changes is between two fits "
        "that go on from the first one, with them and without."
    )
    return "\n".join([*lines, "", note])
