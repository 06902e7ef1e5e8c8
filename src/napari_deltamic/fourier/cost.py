"""What computing costs: work counted beforehand, times rates measured on this machine.

A rendering is a handful of kinds of work (pairs of a face and a wavevector, points, cells of a
kernel, cells of an FFT, pixels). `calibrate` times a few small renderings in less than a second and
solves for the seconds that each kind takes. The rates are kept on disk, so that a machine is
measured once; nothing but a forecast depends on them.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from dataclasses import asdict, astuple, dataclass, fields
from functools import cache
from math import log2, prod
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..common.writing import write_atomically
from ..errors import InputError
from .band import Band
from .native import native, simd_level, threads
from .quadrature import Rule
from .spreading import NODE, POINT, ROW, Spreading

_FORMAT = 2  # of the file; a change of what is measured raises it
# rad: below 2 a triangle takes the series (csrc/triangle_ft.h), but a block of wavevectors with
# phases on either side takes both branches.
_SMALL_PHASE = 1.2
CACHE_VARIABLE = "DELTAMIC_CACHE"


@dataclass(frozen=True)
class Work:
    """What there is to compute, by kind.

    lines : of a face and a row of wavevectors, for the closed form.
    small_pairs, large_pairs : of a face and a wavevector, by the branch of the closed form.
    points : of the quadrature.
    kernel : points x rows of nodes that each is spread over.
    cells : nodes of the grid of the particle-mesh, x log2 of their number.
    pixels : of the FFTs along each axis from the band to the image, x log2 of their length.
    """

    lines: float = 0.0
    small_pairs: float = 0.0
    large_pairs: float = 0.0
    points: float = 0.0
    kernel: float = 0.0
    cells: float = 0.0
    pixels: float = 0.0


@dataclass(frozen=True)
class Rates:
    """Seconds for a call and for each unit of :class:`Work`."""

    call: float
    lines: float
    small_pairs: float
    large_pairs: float
    points: float
    kernel: float
    cells: float
    pixels: float

    def seconds(self, work: Work) -> float:
        """Of one call that does this work."""
        return self.call + float(np.dot(astuple(self)[1:], astuple(work)))


@dataclass(frozen=True)
class Costs:
    """Seconds that each kind of work takes, per thread setting of a machine.

    Attributes
    ----------
    single, double
        Rates by precision, each forward and with the gradient.
    vertex
        Of one solve of the preconditioner with three columns, per vertex.
    voxel
        Of the loss and its gradient, per voxel that counts.
    face
        Of planning, per face.
    tap
        Of blurring, per voxel and coefficient of the filter.
    measured
        Whether they were measured on this machine.
    """

    single_forward: Rates
    single_gradient: Rates
    double_forward: Rates
    double_gradient: Rates
    vertex: float
    voxel: float
    face: float
    tap: float
    measured: bool = False

    def rates(self, single: bool, gradient: bool) -> Rates:
        """For a precision, forward only or with the gradient."""
        if single:
            return self.single_gradient if gradient else self.single_forward
        return self.double_gradient if gradient else self.double_forward

    def seconds(self, work: Work, single: bool, gradient: bool = True) -> float:
        """Of one rendering, with its gradient or without."""
        return self.rates(single, gradient).seconds(work)


# ----------------------------------------------------------------------------------- counting


def count_work(
    method: Literal["closed form", "particle-mesh"],
    band: Band,
    faces: int,
    phases: np.ndarray,
    rules: list[tuple[Rule, np.ndarray]],
    spreading: Spreading | None,
    shape: tuple[int, int, int] | None = None,
) -> Work:
    """The work of one rendering.

    Parameters
    ----------
    band, rules, spreading
        Of the plan.
    phases
        (F,) largest phase along an edge of each face in the band (any number of faces' will do: it
        is a mean that counts).
    shape
        Of the image; by default that of the periodic grid.
    """
    pixels = _image_pixels(band, shape or band.fft_shape)
    if method == "closed form":
        pairs = float(band.count) * faces
        # The phase along an edge, over a ball of wavevectors, is that at its rim times the radius
        # times the cosine of an angle: the share of the ball below the limit.
        x = np.minimum(1.0, _SMALL_PHASE / np.maximum(phases, 1e-300))
        small = float((1.5 * x - 0.5 * x**3).mean()) if len(phases) else 1.0
        lines = float(len(band.rows)) * faces
        return Work(lines, small * pairs, (1 - small) * pairs, pixels=pixels)
    points = sum(len(r.weights) * len(where) for r, where in rules)
    if not points or spreading is None:
        return Work(pixels=pixels)
    nodes = prod(spreading.shape)
    return Work(
        points=points,
        kernel=points * spreading.rows,
        cells=nodes * log2(nodes + 1),
        pixels=pixels,
    )


def _image_pixels(band: Band, shape: tuple[int, int, int]) -> float:
    """Of the three passes of `Band.to_image`."""
    n, (_, ny, nx) = band.fft_shape, band.box_shape
    passes = (
        (n[0] * ny * nx, n[0]),
        (shape[0] * n[1] * nx, n[1]),
        (shape[0] * shape[1] * n[2] / 2, n[2]),
    )
    return float(sum(size * log2(length + 1) for size, length in passes))


# ------------------------------------------------------------------------------ kept on disk

_known: dict[tuple[str, int], Costs] = {}  # in this process, by file and threads


def costs(measure: bool = False, again: bool = False) -> Costs:
    """The costs of this machine: those kept from an earlier measurement, if there are any.

    Parameters
    ----------
    measure
        Whether to measure (:func:`calibrate`) where nothing is kept, or what is kept belongs to
        another machine or version; otherwise ``BUILT_IN`` is taken. Rendering and fitting never
        measure: they take the same time and the same choices whether or not it was done.
    again
        Whether to measure although something is kept, which may be from a busy moment.
    """
    path = cache_file()
    key = (str(path), threads())
    if key in _known and not again and (_known[key].measured or not measure):
        return _known[key]
    found = None if again else _read(path)
    if again or (found is None and measure):
        from .calibration import calibrate

        found = calibrate()
        _write(path, found)
    _known[key] = found or BUILT_IN
    return _known[key]


def cache_file() -> Path:
    """Where the costs are kept; the environment variable DELTAMIC_CACHE names another folder."""
    folder = os.environ.get(CACHE_VARIABLE)
    if folder:
        return Path(folder) / f"costs-{threads()}.json"
    home = os.path.expanduser("~")  # unlike Path.home it never fails
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or os.path.join(home, "AppData", "Local")
    elif sys.platform == "darwin":
        base = os.path.join(home, "Library", "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache")
    return Path(base) / "napari-deltamic" / f"costs-{threads()}.json"


@cache
def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("napari-deltamic")
    except PackageNotFoundError:
        return "unknown"


def _whose() -> dict[str, Any]:
    """What costs depend on: they are stale where one of these has changed."""
    try:
        level = simd_level() if native() is not None else "none"
    except InputError:
        level = "unknown"
    return {
        "format": _FORMAT,
        "version": _version(),
        "machine": f"{platform.system()} {platform.machine()}, {processor()}",
        "cores": os.cpu_count(),
        "threads": threads(),
        "instructions": level,
    }


@cache
def processor() -> str:
    """Name of the processor, as well as the system tells it."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine() or "unknown"


def _read(path: Path) -> Costs | None:
    """The costs in a file; None where there are none, or of another machine, or damaged ones."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["of"] != _whose():
            return None
        return _from_plain(kept["costs"])
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _from_plain(plain: dict[str, Any]) -> Costs:
    """Raises ValueError, TypeError or KeyError where these are no costs."""
    values: dict[str, Any] = {}
    for f in fields(Costs):
        value = plain[f.name]
        if isinstance(value, dict):
            value = Rates(**{r.name: _cost(value[r.name]) for r in fields(Rates)})
        elif f.name != "measured":
            value = _cost(value)
        values[f.name] = value
    return Costs(**values)


def _cost(value: Any) -> float:
    if not 0 <= float(value) < 1:  # seconds for a unit of anything
        raise ValueError(f"{value} is no cost")
    return float(value)


def _write(path: Path, found: Costs) -> None:
    """Keep for the next time; a folder that cannot be written to is no reason to fail."""
    text = json.dumps({"of": _whose(), "costs": asdict(found)}, indent=1) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode())
    except (OSError, InputError):
        pass


# One core of 2024, measured with `calibrate`. The choice between the methods is always made with
# these: the same settings then give the same image on every machine, measured or not.
BUILT_IN = Costs(
    single_forward=Rates(2.5e-4, 1e-8, 1e-10, 3e-9, 3e-8, 6e-10, 9e-11, 1.9e-10),
    single_gradient=Rates(6e-4, 3.8e-8, 5e-10, 6.1e-9, POINT, ROW, NODE, 3.5e-10),
    double_forward=Rates(2.5e-4, 2.4e-8, 2e-10, 4.4e-9, 3.5e-8, 1.2e-9, 2.2e-10, 4e-10),
    double_gradient=Rates(6e-4, 5.6e-8, 1.9e-9, 1.2e-8, 7e-8, 3e-9, 4.4e-10, 8e-10),
    vertex=7.8e-8,
    voxel=1.2e-8,
    face=3.8e-7,
    tap=3.4e-10,
)
# A data-centre GPU: estimates from the instructions that the kernels take and from what is written
# of cuFFT, not measured.
_BUILT_IN_CUDA = Costs(
    single_forward=Rates(1e-4, 0.0, 2e-12, 8e-12, 1e-9, 5e-11, 4e-13, 4e-13),
    single_gradient=Rates(4e-4, 0.0, 6e-12, 2.4e-11, 3e-9, 3e-10, 2e-12, 8e-13),
    double_forward=Rates(1e-4, 0.0, 1.2e-11, 3e-11, 1e-9, 1.5e-10, 1e-12, 1e-12),
    double_gradient=Rates(4e-4, 0.0, 3.6e-11, 9e-11, 3e-9, 9e-10, 5e-12, 2e-12),
    vertex=7.8e-8,
    voxel=1e-10,
    face=3.8e-7,
    tap=3.4e-10,
)


def built_in(device: str) -> Costs:
    """The costs that choices are made with, for a type of device."""
    return _BUILT_IN_CUDA if device == "cuda" else BUILT_IN
