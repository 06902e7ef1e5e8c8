"""The time that a rendering takes: amounts of work, times the seconds that each kind takes.

A rendering is a handful of kinds of work (pairs of a face and a wavevector, points, cells of a
kernel, cells of an FFT, pixels). Nothing is timed here: the choice between the methods uses
built-in costs; those of a machine are measured by :mod:`napari_deltamic.accuracy.calibration`.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from math import log2, prod
from typing import Literal

import numpy as np

from .band import Band
from .quadrature import Rule
from .spreading import NODE, POINT, ROW, Spreading

# rad: below 2 a triangle takes the series (csrc/triangle_ft.h), but a block of wavevectors with
# phases on either side takes both branches.
_SMALL_PHASE = 1.2


@dataclass(frozen=True)
class Work:
    """The amount of work of each kind.

    lines : pairs of a face and a row of wavevectors, for the closed form.
    small_pairs, large_pairs : pairs of a face and a wavevector, by the closed form's branch.
    points : quadrature points.
    kernel : points x rows of nodes that each point is spread over.
    cells : nodes of the particle-mesh's grid x log2 of their number.
    pixels : of the FFTs along each axis from the band to the image x log2 of their length.
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
        """Return the seconds of one call that does this work."""
        return self.call + float(np.dot(astuple(self)[1:], astuple(work)))


@dataclass(frozen=True)
class Costs:
    """Seconds that each kind of work takes on a machine with one number of threads.

    Attributes
    ----------
    single, double
        Rates by precision, each forward and with the gradient.
    vertex
        One solve of the preconditioner with three columns, per vertex.
    voxel
        Loss and its gradient, per counted voxel.
    face
        Planning, per face.
    tap
        Blurring, per voxel and coefficient of the filter.
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
        """Return the rates for a precision, forward only or with the gradient."""
        if single:
            return self.single_gradient if gradient else self.single_forward
        return self.double_gradient if gradient else self.double_forward

    def seconds(self, work: Work, single: bool, gradient: bool = True) -> float:
        """Return the seconds of one rendering, with its gradient or without."""
        return self.rates(single, gradient).seconds(work)


# ----------------------------------------------------------------------------------- counting


def count_work(
    method: Literal["closed form", "particle-mesh"],
    band: Band,
    faces: int,
    phases: np.ndarray,
    rules: list[tuple[Rule, np.ndarray]],
    spreading: Spreading | None,
) -> Work:
    """Count the work of one rendering.

    Parameters
    ----------
    band, rules, spreading
        Of the plan.
    phases
        Largest phase along an edge of each face in the band; those of some faces suffice, as only
        their mean is used.
    """
    pixels = _image_pixels(band, band.fft_shape)
    if method == "closed form":
        pairs = float(band.count) * faces
        # Share of a ball of wavevectors below the limit: the phase along an edge is that at the rim
        # times the relative radius times the cosine of an angle.
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
    """Return the work of the three passes of `Band.to_image`."""
    n, (_, ny, nx) = band.fft_shape, band.box_shape
    passes = (
        (n[0] * ny * nx, n[0]),
        (shape[0] * n[1] * nx, n[1]),
        (shape[0] * shape[1] * n[2] / 2, n[2]),
    )
    return float(sum(size * log2(length + 1) for size, length in passes))


# One core of 2024, measured with `calibrate`. The method is always chosen with these costs, so that
# the same settings give the same image on every machine, whether calibrated or not.
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
# A data-centre GPU: estimated from the instructions of the kernels and from publications on cuFFT,
# not measured.
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
    """Return the costs with which methods are chosen for a type of device."""
    return _BUILT_IN_CUDA if device == "cuda" else BUILT_IN
