"""Which effects real stacks call for: what was recommended, the evidence, what it changed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import GaussianPSF, Grid, Mesh, fit
from napari_deltamic.geometry import mesh_from_labels, read_points_csv, seeds_from_points, sphere
from napari_deltamic.images import read_image
from napari_deltamic.inference import counted_voxels
from napari_deltamic.inference.evidence import Recommendation, analyse_residual, recommend
from napari_deltamic.measure import surface_distance
from napari_deltamic.settings import NEAR_LEVELS, FitSettings

from ..figure import MissingData

CENTRES = Path(__file__).parents[1] / "data_points" / "vesicles_GUV.csv"
GLANDS = ("gland_WT_2017-12-04_1a", "gland_WT_2018-04-10_2a")
_HEADINGS = ("stack", "recommended", "evidence", "loss", "unexplained", "shape moved", "seconds")


Start = Callable[[NDArray[np.float32], Grid, Path], tuple[Mesh, bool]]


class Stack(NamedTuple):
    """A real image and where to start."""

    name: str
    image: NDArray[np.float32]
    grid: Grid
    mesh: Mesh
    optics: GaussianPSF
    counted: NDArray[np.bool_] | None


def stacks(data: Path, only: str = "") -> Iterator[Stack]:
    """The real images that there are seeds for, whose names hold a text."""
    folder = data / "images"
    if not folder.is_dir():
        raise MissingData(f"no images at {folder}")
    known: list[tuple[str, tuple[float, float, float], Start]] = [
        ("vesicles_GUV", (0.34, 0.133, 0.133), _from_points),
        # Their sides are relative: the slices are as far apart as half a voxel is wide.
        *((name, (0.5, 1.0, 1.0), _from_labels) for name in GLANDS),
        ("bead2.5um_EPFL_25pct", (0.64, 0.258, 0.258), _bead),
    ]
    for name, size, start in known:
        if only in name:
            yield _stack(name, folder, size, start)


def _stack(name: str, folder: Path, size: tuple[float, float, float], start: Start) -> Stack:
    path = folder / f"{name}.tif"
    if not path.is_file():
        raise MissingData(f"no {path.name} at {folder}")
    image = read_image(path)[0].astype(np.float32)
    grid = Grid(image.shape, size)
    mesh, counts = start(image, grid, path)
    optics = GaussianPSF([1.2 * d for d in size])
    counted = counted_voxels(image, grid, mesh, optics) if counts else None
    return Stack(name, image, grid, mesh, optics, counted)


def _from_points(image: NDArray[np.float32], grid: Grid, path: Path) -> tuple[Mesh, bool]:
    points, radii = read_points_csv(CENTRES)
    return seeds_from_points(image, grid.voxel_size, points, radii, grid.origin), True


def _from_labels(image: NDArray[np.float32], grid: Grid, path: Path) -> tuple[Mesh, bool]:
    labels = read_image(path.with_name(f"{path.stem}_labels.tif"))[0]
    return mesh_from_labels(labels, grid.voxel_size), True


def _bead(image: NDArray[np.float32], grid: Grid, path: Path) -> tuple[Mesh, bool]:
    weight = np.clip(image - np.percentile(image, 99.5), 0, None)
    place = np.indices(image.shape).reshape(3, -1)
    middle = (place * weight.reshape(-1)).sum(1) / weight.sum() * grid.voxel_size
    return sphere(middle, 1.25, subdivisions=3), False


def judged(stack: Stack) -> dict[str, str]:
    """A line of the table."""
    began = time.perf_counter()
    settings = FitSettings(fit_psf=True, density="smooth", levels=NEAR_LEVELS)
    given = stack.image, stack.grid, stack.mesh, stack.optics
    *_, before = fit(*given, settings=settings, counted=stack.counted)
    at = time.perf_counter()
    found = recommend(*given, settings, counted=stack.counted, fitted=before)
    seconds = time.perf_counter() - at
    after = before
    if found.recommended:
        *_, after = fit(*given, settings=settings, counted=stack.counted, effects=found.effects)
    left = [
        analyse_residual(stack.image, stack.grid, s, counted=stack.counted) for s in (before, after)
    ]
    return {
        "stack": stack.name,
        "recommended": ", ".join(found.recommended) or "none",
        "evidence": evidence(found),
        "loss": f"{before.loss:.4f} -> {after.loss:.4f}",
        "unexplained": " -> ".join(f"{1 - (r.explained or 0):.1%}" for r in left),
        "shape moved": _moved(before.mesh, after.mesh, stack.grid),
        "seconds": f"{seconds:.0f} of {time.perf_counter() - began:.0f}",
    }


def evidence(found: Recommendation) -> str:
    """Score and bias of what is recommended, then what else was seen."""
    seen = [e for e in found.evidence if e.recommended or abs(e.score) > found.threshold]
    shown = [f"{e.name} z {e.score:.0f}, {e.bias_voxels:.2f} voxel" for e in seen]
    return "; ".join([*shown, *found.remarks])


def _moved(before: Mesh, after: Mesh, grid: Grid) -> str:
    """Mean distance between the surfaces."""
    if after is before:
        return "-"
    return f"{surface_distance(before, after, 20000).mean / min(grid.voxel_size):.2f} voxel"


def real_table(data: Path, only: str = "") -> str:
    """The table, as Markdown."""
    lines = ["| " + " | ".join(_HEADINGS) + " |", "|" + "---|" * len(_HEADINGS)]
    for stack in stacks(data, only):
        row = judged(stack)
        lines.append("| " + " | ".join(row[h] for h in _HEADINGS) + " |")
    return "\n".join(lines)
