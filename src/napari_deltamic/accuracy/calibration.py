"""Measures the costs of this machine by a few small renderings, in about a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import astuple, dataclass, fields
from math import log, sqrt

import numpy as np
import scipy.sparse as sp
import torch
from scipy.ndimage import gaussian_filter
from scipy.optimize import nnls
from torch import Tensor

from ..fitting.model.level import CUT_OFF
from ..fitting.solvers.factors import Solve, on_host
from ..fourier.band import Band
from ..fourier.closed_form import band_ft
from ..fourier.cost import BUILT_IN, Costs, Rates, Work, count_work
from ..fourier.particle_mesh import elements_ft
from ..fourier.plan import edge_phases, make_plan
from ..fourier.points import Points
from ..fourier.quadrature import rule
from ..fourier.spreading import choose_spreading, gaussian
from ..geometry.connected import adjacency
from ..geometry.mesh import Mesh
from ..geometry.primitives import sphere

_BUDGET = 0.8  # s, after which no further round is started, so that all takes about a second
_ROUNDS = 5  # at most; the fastest counts, else the costs kept could be from a busy moment
_PULL = 0.05  # towards the usual proportions: too weak to matter where something was measured
# What is timed: small and large, so that each cost is most of the time of some trial. Closed form:
# subdivisions and radius (um) of a ball, wavevectors across.
_CLOSED = ((2, 0.05, 9), (1, 0.01, 61), (1, 0.3, 31))
# Particle-mesh, likewise, and so that all widths occur: subdivisions of a ball,
# wavevectors across, tolerance of the spreading.
_SPREAD = ((0, 13, 2e-3), (3, 15, 2e-2), (3, 15, 2e-5), (1, 51, 2e-3))
_RADIUS = 0.3  # um, of a ball in a cube of 1 um: any radius that fits would do
_IMAGES = ((15, 32), (31, 60))  # wavevectors and voxels across: two, since there are two costs

# Voxels, their size and the PSF's width (um), accuracy: the time of a plan hardly depends on them.
_PLANNED = ((40,) * 3, (0.05,) * 3, (0.07,) * 3, 1e-3)
_BLUR = 3.0  # voxels


@dataclass(frozen=True)
class _Trial:
    """A computation to time, forward and with its gradient, and the work that it stands for."""

    work: Work
    forward: Callable[[], Tensor]
    leaf: Tensor

    def times(self) -> tuple[float, float]:
        """Seconds for the forward computation, and for it with its gradient."""
        start = time.perf_counter()
        out = self.forward()
        middle = time.perf_counter()
        torch.autograd.grad(out, self.leaf, torch.ones_like(out))
        return middle - start, time.perf_counter() - start


def calibrate() -> Costs:
    """Time the parts of a rendering and a fit; the fastest of several short runs counts.

    Takes about a second, and about two the first time in a process (measured: 0.8 to 0.9 and
    2.2 s). What else the machine is doing shows in the pace of fits, and is learned from them.
    """
    start = time.perf_counter()
    trials = {single: _trials(single) for single in (True, False)}
    others = _others()
    found: dict[tuple[bool, int], list[tuple[float, float]]] = {}
    other: dict[str, list[float]] = {name: [] for name in others}
    for round_ in range(_ROUNDS + 1):
        for single, some in trials.items():
            for i, trial in enumerate(some):
                times = trial.times()
                if round_ > 0:  # the first one warms up
                    found.setdefault((single, i), []).append(times)
        for name, (function, units) in others.items():
            begun = time.perf_counter()
            function()
            other[name].append((time.perf_counter() - begun) / units)
        if round_ > 0 and time.perf_counter() - start > _BUDGET:
            break
    rates = {}
    for single, some in trials.items():
        for which in (0, 1):
            seconds = [min(t[which] for t in found[single, i]) for i in range(len(some))]
            rates[single, which] = _solved([t.work for t in some], seconds, single, which == 1)
    return Costs(
        rates[True, 0],
        rates[True, 1],
        rates[False, 0],
        rates[False, 1],
        **{name: min(times) for name, times in other.items()},
        measured=True,
    )


def _solved(works: list[Work], seconds: list[float], single: bool, gradient: bool) -> Rates:
    """Non-negative rates that explain the times best, each time relative to its size."""
    # A trial is half of a rendering: the transform, or the step from there to the image.
    matrix = np.array([[0.5, *astuple(w)] for w in works])
    times = np.array(seconds)
    guess = np.array(astuple(BUILT_IN.rates(single, gradient)))
    scaled = matrix * guess / times[:, None]  # of the order of 1
    level = float(np.median(1 / scaled.sum(1)))
    weak = _PULL * np.eye(len(guess))
    factors, _ = nnls(
        np.vstack([scaled, weak]),
        np.concatenate([np.ones(len(times)), weak @ np.full(len(guess), level)]),
    )
    return Rates(
        **dict(zip((f.name for f in fields(Rates)), (guess * factors).tolist(), strict=True))
    )


# ------------------------------------------------------------------------------------- trials


def _trials(single: bool) -> list[_Trial]:
    kind = torch.complex64 if single else torch.complex128
    return [
        *(_closed(*trial, single) for trial in _CLOSED),
        *(_particle_mesh(*trial, single) for trial in _SPREAD),
        *(_image(*trial, kind) for trial in _IMAGES),
    ]


def _ball(subdivisions: int, radius: float = _RADIUS) -> Mesh:
    return sphere((0.5, 0.5, 0.5), radius, subdivisions=subdivisions)


def _cube(side: int, fft: int | None = None) -> Band:
    """A band of ``side`` wavevectors across, in a cube of 1 um."""
    fft = fft or 2 * side
    spacing, half = 2 * np.pi, side // 2
    return Band.within((fft,) * 3, (1 / fft,) * 3, ((half + 0.5) * spacing,) * 3)


def _closed(subdivisions: int, radius: float, side: int, single: bool) -> _Trial:
    mesh, band = _ball(subdivisions, radius), _cube(side)
    v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    f, ones = torch.as_tensor(mesh.faces), torch.ones(len(mesh.faces), dtype=torch.float64)
    assert band.radius is not None
    phases = edge_phases(mesh.vertices_numpy(), mesh.faces, band.radius, True)
    work = count_work("closed form", band, len(f), phases, [], None)

    def forward() -> Tensor:
        return band_ft(v, f, ones, band.rows, band.spacing, single)

    return _Trial(_without_pixels(work), forward, v)


def _particle_mesh(subdivisions: int, side: int, tolerance: float, single: bool) -> _Trial:
    mesh, band = _ball(subdivisions), _cube(side)
    v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    f, ones = torch.as_tensor(mesh.faces), torch.ones(len(mesh.faces), dtype=torch.float64)
    rules = [(rule(4), np.arange(len(f)))]
    points = Points(rules, len(f))
    reach = band.half[0] * band.spacing[0]
    # For a Gaussian OTF that has fallen to 1e-3 at the edge of the band.
    transfer = gaussian((sqrt(2 * log(1e3)) / reach,) * 3)
    spreading = choose_spreading(band.half, band.spacing, transfer, tolerance, points.count, single)
    work = count_work("particle-mesh", band, len(f), np.zeros(0), rules, spreading)

    def forward() -> Tensor:
        return elements_ft(v, f, ones, points, spreading, single)

    return _Trial(_without_pixels(work), forward, v)


def _image(side: int, fft: int, kind: torch.dtype) -> _Trial:
    band = _cube(side, fft)
    u = torch.ones(band.box_shape, dtype=kind, requires_grad=True)
    work = count_work("particle-mesh", band, 0, np.zeros(0), [], None)
    return _Trial(work, lambda: band.to_image(u * 0.5, band.fft_shape), u)


def _without_pixels(work: Work) -> Work:
    return Work(*astuple(work)[:-1])


def _others() -> dict[str, tuple[Callable[[], object], float]]:
    """What a fit does besides rendering: functions to time, and the units that each works on."""
    mesh = _ball(4)
    solve = _smoother(mesh)
    columns = torch.ones(len(mesh.vertices), 3, dtype=torch.float64)
    voxels = 50_000
    image = torch.rand(voxels * 2)
    index = torch.arange(0, 2 * voxels, 2)
    target = torch.rand(voxels)

    def loss() -> None:
        leaf = image.clone().requires_grad_()
        residual = 0.5 * leaf[index] - target
        torch.dot(target, residual**2).backward()
        for _ in range(3):  # amplitude and background are solved for in double precision
            (target.to(torch.float64) * residual.detach()).sum()

    def plan() -> None:
        make_plan(mesh.vertices_numpy(), mesh.faces, *_PLANNED)

    block = np.zeros((30, 30, 30), np.float32)
    return {
        "vertex": (lambda: solve(columns), len(columns)),
        "voxel": (loss, voxels),
        "face": (plan, len(mesh.faces)),
        "tap": (
            lambda: gaussian_filter(block, _BLUR, truncate=CUT_OFF),
            block.size * 3 * 2 * CUT_OFF * _BLUR,
        ),
    }


def _smoother(mesh: Mesh) -> Solve:
    """A solver from a sparse factorisation, as the preconditioner of a fit uses it."""
    a = adjacency(mesh)
    degrees = sp.diags(np.asarray(a.sum(1)).ravel())
    return on_host((sp.eye(len(mesh.vertices)) + 10 * (degrees - a)).tocoo())
