"""Plans put together by hand, with which those chosen for an accuracy are compared."""

from __future__ import annotations

from math import log, pi, sqrt

import numpy as np

from .band import Band
from .cost import count_work
from .plan import Plan, edge_phases
from .quadrature import rule
from .spreading import Transfer, choose_spreading

_TOLERANCE = {True: 3e-5, False: 1e-12}  # of aliases, by precision: what rounding would do anyway


def fixed_plan(
    vertices: np.ndarray,
    faces: np.ndarray,
    fft_shape: tuple[int, int, int],
    voxel_size: tuple[float, float, float],
    width: tuple[float, float, float],
    threshold: float,
    degree: int | None,
    single: bool,
    aligned: bool,
    transfer: Transfer,
) -> Plan:
    """Make a plan of the closed form, or of one quadrature rule for all faces, on a given band.

    Parameters
    ----------
    vertices, faces, fft_shape, voxel_size, width, aligned, transfer
        As in :func:`napari_deltamic.fourier.make_plan`.
    threshold
        |OTF| at the edge of the band; 0 for every wavevector of the grid.
    degree
        Degree of the rule; None for the closed form.
    single
        Whether in single precision.
    """
    if threshold == 0:
        band, aligned = Band.full(fft_shape, voxel_size), False
        radius = tuple(pi / d for d in voxel_size)
    else:
        radius = tuple(sqrt(2 * log(1 / threshold)) / w for w in width)
        band = Band.within(fft_shape, voxel_size, radius, aligned)  # type: ignore[arg-type]
    phases = edge_phases(vertices, faces, radius, aligned)
    if degree is None:
        work = count_work("closed form", band, len(faces), phases, [], None)
        return Plan("closed form", band, 0.0, threshold, single, None, [], 0.0, work)
    rules = [(rule(degree), np.arange(len(faces)))]
    points = len(faces) * len(rules[0][0].weights)
    spreading = choose_spreading(
        band.half, band.spacing, transfer, _TOLERANCE[single], points, single, width=width
    )
    work = count_work("particle-mesh", band, len(faces), phases, rules, spreading)
    return Plan("particle-mesh", band, 0.0, threshold, single, spreading, rules, 0.0, work)
