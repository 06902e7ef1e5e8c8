"""What a figure is made of: options, rows, timings, and the scenes that several figures share."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from napari_deltamic import GaussianPSF, Grid, Mesh, load_mesh
from napari_deltamic.fourier import Band
from napari_deltamic.geometry import sphere


def default_data_folder() -> Path:
    """Where real images and meshes lie, if anywhere; DELTAMIC_DATA overrides the default."""
    default = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    return Path(os.environ.get("DELTAMIC_DATA", default))


@dataclass(frozen=True)
class Options:
    """How the figures are to be measured."""

    quick: bool = False  # fewer repeats, smaller problems
    data: Path = field(default_factory=default_data_folder)
    pictures: Path | None = None  # where those that draw put their pictures

    @property
    def repeats(self) -> int:
        """Of a timing; the median counts."""
        return 3 if self.quick else 7


@dataclass(frozen=True)
class Row:
    """One measured number and what was asked of it."""

    figure: str
    asked: str
    measured: float
    unit: str
    passed: bool | None  # None: nothing was asked, or it could not be measured
    note: str = ""


Figure = Callable[[Options], list[Row]]


class MissingData(Exception):
    """A figure needs a file that is not there."""


def at_least(figure: str, bar: float, measured: float, unit: str, note: str = "") -> Row:
    """A row that passes from the bar up."""
    return Row(figure, f">= {bar:g}", measured, unit, bool(measured >= bar), note)


def at_most(figure: str, bar: float, measured: float, unit: str, note: str = "") -> Row:
    """A row that passes up to the bar."""
    return Row(figure, f"<= {bar:g}", measured, unit, bool(measured <= bar), note)


# ----------------------------------------------------------------------------------- timings


@dataclass
class Timing:
    """Seconds of each repeat, by the clock on the wall and summed over the cores."""

    wall_each: list[float] = field(default_factory=list)
    cpu_each: list[float] = field(default_factory=list)

    @property
    def wall(self) -> float:
        """Median, s."""
        return median(self.wall_each)

    @property
    def cpu(self) -> float:
        """Median of the time on all cores, s: what other people's jobs change least."""
        return median(self.cpu_each)

    def note(self) -> str:
        """Spread and cores in words."""
        return f"best {1e3 * min(self.wall_each):.3g} ms, CPU {1e3 * self.cpu:.3g} ms"


def timed(function: Callable[[], object], repeats: int) -> Timing:
    """Times a function after one call to warm up."""
    return timed_together([function], repeats)[0]


def timed_together(functions: list[Callable[[], object]], repeats: int) -> list[Timing]:
    """Times functions in turn, so that a busy moment of the machine meets all of them alike."""
    timings = [Timing() for _ in functions]
    for function in functions:
        function()
    for _ in range(repeats):
        for function, timing in zip(functions, timings, strict=True):
            wall, cpu = time.perf_counter(), time.process_time()
            function()
            timing.wall_each.append(time.perf_counter() - wall)
            timing.cpu_each.append(time.process_time() - cpu)
    return timings


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Exponent of growth: the slope of log y over log x."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


# ------------------------------------------------------------------------------------ scenes

ICOSAHEDRON_EDGE = 1.0514622242382672  # for a circumscribed radius of 1
SIGMA = 1.5  # voxels: the width of the PSF in every figure
VOXELS = 100  # along each axis
NARROW = 0.01  # |OTF| at the edge of the band that the paper keeps


def scene(voxels: int = VOXELS) -> tuple[Grid, GaussianPSF]:
    """A cube of voxels of 1 um and the PSF."""
    return Grid((voxels,) * 3, (1.0,) * 3), GaussianPSF(SIGMA)


def narrow_band(voxels: int = VOXELS) -> Band:
    """The wavevectors where |OTF| > 1 %."""
    radius = float(np.sqrt(2 * np.log(1 / NARROW)) / SIGMA)
    return Band.within((voxels,) * 3, (1.0,) * 3, (radius,) * 3)


def wavevectors(band: Band) -> NDArray[np.float64]:
    """(K, 3) rad/um: those of the band, row by row."""
    rows = band.rows.numpy().astype(np.int64)
    length = rows[:, 2]
    first = np.repeat(np.cumsum(length) - length, length)
    index = np.column_stack(
        [np.repeat(rows[:, 0], length), np.repeat(rows[:, 1], length), np.arange(length.sum())]
    )
    index[:, 2] -= first
    return index * np.asarray(band.spacing)


def target(data: Path, name: str, grid: Grid, length: float) -> Mesh:
    """A mesh of the paper, ``length`` um long, in the middle of a grid.

    Raises MissingData where the mesh is not at hand.
    """
    path = data / "meshes" / f"{name}.obj"
    if not path.is_file():
        raise MissingData(f"no {path.name} in {path.parent} (DELTAMIC_DATA names the folder)")
    mesh = load_mesh(path)
    v = mesh.vertices_numpy()
    v = v - (v.min(0) + v.max(0)) / 2
    middle = np.mean(grid.extent, axis=0)
    return mesh.with_vertices(v * length / np.ptp(v, axis=0).max() + middle)


def cow(options: Options, voxels: int = VOXELS) -> Mesh:
    """The paper's cow, 5856 faces, over 70 % of the cube of :func:`scene`, in its middle."""
    return target(options.data, "cow", scene(voxels)[0], 0.7 * voxels)


def small_sphere(voxels: int = VOXELS, radius: float = 14.0) -> Mesh:
    """An icosphere with edges below 0.66 sigma: every pair on the narrow band is a small one."""
    n = 8
    while True:
        n += 1
        mesh = sphere(((voxels - 1) / 2,) * 3, radius, edge_length=ICOSAHEDRON_EDGE * radius / n)
        if longest_edge(mesh) < 0.66 * SIGMA:
            return mesh


def sphere_of(faces: int, voxels: int, radius: float) -> Mesh:
    """An icosphere of about so many faces."""
    n = round((faces / 20) ** 0.5)
    edge = ICOSAHEDRON_EDGE * radius / (n - 0.5)
    return sphere(((voxels - 1) / 2,) * 3, radius, edge_length=edge)


def tensors(mesh: Mesh) -> tuple[Tensor, Tensor]:
    """Vertices and faces."""
    return torch.from_numpy(mesh.vertices_numpy().copy()), torch.as_tensor(mesh.faces)


def longest_edge(mesh: Mesh) -> float:
    """um."""
    corners = mesh.vertices_numpy()[mesh.faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
