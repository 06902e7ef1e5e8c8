"""What an iteration of a fit costs, and how many a level needs: the numbers behind a forecast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from ..fitting.model.level import CUT_OFF, LevelShape
from ..fitting.objective.schedule import Schedule
from ..fourier.cost import Costs, Work
from ..fourier.plan import Plan
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..runs.settings import FitSettings
from ..scene import Grid


@dataclass(frozen=True)
class ForecastRules:
    """What a forecast assumes about a fit, from measured fits.

    Attributes
    ----------
    first, coarse, last
        Iterations of the first, the middle and the last levels, for seeds far away. Measured for
        all five levels: 66 to 184 in 18 scenes of ``benchmarks.defaults`` (f7b2103), median 106.
    near_blur, near_coarse, near_last
        The same where seeds lie near the membranes, that is, where the first blur is less than
        ``near_blur``. Measured with foams of 4 to 16 cells, levels 2 to 1: 32, 27 to 32, 15 to 50.
    alone
        Iterations of the only level. Measured on 21 scenes without cells that touch (as above): 23
        to 85, median 50; vesicles and single cells of the samples take 11 to 18.
    neighbours
        Where cells touch, other neighbours are tried at the end: this many further iterations,
        times the cube root of the number of cells minus 1. Measured: 35 to 199 in 11 scenes (as
        above), most where most cells touch; foams of 5, 8 and 12 cells took 47, 30 and 52.
    freer
        Factor on the last level where density or PSF are fitted as well. Measured on a ball: 15
        iterations with the PSF, 13 without.
    solves, apart
        Work of an iteration besides rendering, in solves of the preconditioner, which are measured
        alone: two solves and the steps between them; keeping surfaces from crossing.
    overhead
        Fixed cost of an iteration, in calls: the same however small the scene, so that tiny fits
        are not forecast as free.
    smooth
        Factor on all of this where the brightness is smooth. Measured: 1.2 to 1.3 in a foam of 8.
    posing, posing_first, posing_alone
        Factor on all of that, as every few iterations the objective is posed anew, and other models
        and contacts of cells are tried. Measured against the forecast without it, as above: a
        single level 1.7 to 13, median 3.4; all levels together 2.2 times as long as with 1.7 for
        the first and 1.35 for others, which samples took before models were compared.
    begun, begun_last
        Time that the first objective of a level takes, in iterations without posing: measured in
        these scenes 4 to 15, at the last level 9 to 30.
    factoring
        Time to factorise the preconditioner's matrix, in solves. Measured: 171, 147 and 29 for 642,
        2562 and 10242 vertices.
    looks
        Iterations after which all voxels are looked at; chosen by eye.
    psf_every
        Where the PSF is fitted, one iteration in this many adds four images for it. Measured on a
        ball in 40 x 56 x 56 voxels: 1.3 to 2.8 ms, where 1.9 were forecast.
    window, more
        Iterations still needed by a level that goes on beyond what was expected, or this share of
        those it has had: otherwise the end would always seem near.
    unknown
        Multiple of the iterations expected at the last level beyond which its end is unknown.
        Simulated images need up to 2.7 times (``benchmarks.eta``); three regions of nuclei 13 to 16
        times.
    trusted
        Iterations after which the pace of a fit counts as much as its forecast, since the first
        ones say little.
    teach
        Fewest iterations from which a fit teaches anything: the first ones prepare what later ones
        reuse.
    farthest
        Largest factor by which a forecast can be off: more would have another cause, such as a
        machine that slept or another program.
    """

    first: int = 20
    coarse: int = 20
    last: int = 25
    near_blur: float = 2.0
    near_coarse: int = 25
    near_last: int = 18
    alone: int = 38
    neighbours: int = 27
    freer: float = 1.3
    solves: float = 3.0
    apart: float = 5.0
    overhead: float = 1.0
    smooth: float = 1.3
    posing: float = 3.0
    posing_first: float = 3.7
    posing_alone: float = 3.4
    begun: float = 8.0
    begun_last: float = 20.0
    factoring: float = 100.0
    looks: int = 10
    psf_every: int = 5
    window: int = 12
    more: float = 0.1
    unknown: float = 2.7
    trusted: float = 5.0
    teach: int = 5
    farthest: float = 30.0


FORECAST = ForecastRules()


def iterations_of(
    settings: FitSettings, factors: Sequence[float], number: int, first: bool, tried: int
) -> int:
    """Iterations expected of a level; tried : cells whose neighbours will be tried, 0 if none."""
    near = factors[0] < FORECAST.near_blur
    if number < len(factors):
        return FORECAST.near_coarse if near else FORECAST.first if first else FORECAST.coarse
    free = settings.fit_psf or settings.density != "uniform"
    near_last = FORECAST.alone if len(factors) == 1 else FORECAST.near_last
    wanted = (near_last if near else FORECAST.last) * (FORECAST.freer if free else 1.0)
    return round(wanted + FORECAST.neighbours * max(tried ** (1 / 3) - 1, 0.0))


def posing_of(number: int, levels: int) -> float:
    """Factor on the time of an iteration, for what is done only every few iterations."""
    if levels == 1:
        return FORECAST.posing_alone
    return FORECAST.posing_first if number == 1 else FORECAST.posing


def iteration_seconds(
    costs: Costs,
    plan: Plan,
    shape: LevelShape,
    mesh: Mesh,
    near: float,
    settings: FitSettings,
    factor: float,
) -> float:
    """Seconds of one iteration, not counting what :func:`posing_of` adds as a factor."""
    vertices, voxels = len(mesh.vertices), prod(shape.grid.shape)
    call = costs.rates(plan.single, True).call
    seconds = costs.seconds(plan.work, plan.single) + FORECAST.overhead * call
    seconds += near * costs.voxel + FORECAST.solves * vertices * costs.vertex
    if settings.collisions:
        seconds += FORECAST.apart * vertices * costs.vertex
    if settings.density == "smooth":
        seconds += FORECAST.solves / 2 * vertices * costs.vertex + call / 2
    seconds += (len(mesh.faces) * costs.face + call) / Schedule().renewed_every
    seconds += voxels * costs.voxel / FORECAST.looks
    if settings.fit_psf and factor <= Schedule().imaging_below:
        image = costs.rates(plan.single, False).seconds(Work(pixels=plan.work.pixels))
        seconds += (4 * image + 8 * near * costs.voxel) / FORECAST.psf_every
    return seconds * (FORECAST.smooth if settings.density == "smooth" else 1.0)


def preparation_seconds(costs: Costs, shape: LevelShape, grid: Grid, mesh: Mesh) -> float:
    """Seconds before the first iteration of a level: blurred images, plan, preconditioner."""
    taps = 2 * CUT_OFF * np.divide(shape.blur, grid.voxel_size).sum() + 3
    blurred = 2 * prod(grid.shape) * taps * costs.tap if any(shape.blur) else 0.0
    return float(
        blurred
        + len(mesh.faces) * costs.face
        + FORECAST.factoring * len(mesh.vertices) * costs.vertex
    )


def seen_voxels(shape: LevelShape, grid: Grid) -> float:
    """Number of voxels of a level whose blur lies mostly in the image, so not those at its rim."""
    n = np.array(grid.shape) - 0.5 * np.divide(shape.blur, grid.voxel_size)
    return float(np.prod(np.maximum(n, 0) / shape.step))


def near_voxels(grid: Grid, optics: Optics, reach: float, factor: float, mesh: Mesh) -> float:
    """Approximate number of voxels of a grid within reach of a surface."""
    sigma = factor * np.asarray(optics.sigma_um)
    along = np.sqrt(((mesh.normals() * sigma) ** 2).sum(1)).clip(1e-12)
    # Distance at which the image of a flat piece falls to what level.py asks for.
    distance = along * np.sqrt(reach**2 + 2 * np.log(sigma.max() / along))
    shell = 2 * float(mesh.areas() @ distance)
    around = float(np.prod(np.ptp(mesh.bounds(), axis=0) + 2 * reach * sigma))
    return min(shell, around) / float(np.prod(grid.voxel_size))
