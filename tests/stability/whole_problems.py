"""Whole problems: rendering, loss and fit together, measured for the tests and for the page.

The scene is small: a sphere of 162 vertices in 24 x 26 x 25 voxels, a peak of 40 photons.
"""

import gc
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from benchmarks.shapes import scaled

import napari_deltamic as nd
from napari_deltamic.fitting.level_run import LevelRun
from napari_deltamic.fitting.model.likelihood import ImageNoise, match
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer, Scene

GRID = nd.Grid((24, 26, 25), (0.1, 0.1, 0.1))
OPTICS = nd.GaussianPSF((0.16, 0.14, 0.15))
CENTRE, RADIUS = (1.15, 1.25, 1.2), 0.7
TRUTH = sphere(CENTRE, RADIUS, subdivisions=3)


def photons(mesh: Mesh, grid: nd.Grid, optics: nd.GaussianPSF, noise: int | None) -> np.ndarray:
    """The image of a mesh, 40 photons over a background of 2; noise: the seed of it."""
    image = nd.render(mesh, grid, optics, 1e-4).numpy().astype(np.float64)
    image = 2 + 40 * image.clip(0) / image.max()
    return image if noise is None else np.random.default_rng(noise).poisson(image).astype(float)


def start(subdivisions: int = 2) -> Mesh:
    """Too small by a quarter and beside the truth by a voxel."""
    z, y, x = CENTRE
    return sphere((z, y - 0.1, x + 0.1), 0.75 * RADIUS, subdivisions=subdivisions)


# ------------------------------------------------------------------------------------- gradients


def gradient_errors(method: str, accuracy: float, likelihood: str) -> dict[str, float]:
    """Worst relative error of the gradient of the whole loss, in vertices, PSF and densities.

    Against central differences of fourth order, in which amplitude and background are solved for
    anew each time. What is held, as in the fit, are the weights of the voxels and the plan: the
    derivative is that of the loss with these weights, not of how they would change.
    """
    mesh, optics = start(), nd.GaussianPSF((0.17, 0.15, 0.14))
    measured = torch.from_numpy(photons(TRUTH, GRID, OPTICS, 1)).reshape(-1)
    renderer = Renderer(Scene.of(mesh, optics), GRID, accuracy, method=method)
    inputs = {
        "vertices": torch.tensor(mesh.vertices_numpy()),
        "PSF": optics.parameters().detach().clone(),
        "density": torch.ones(len(mesh.faces), dtype=torch.float64),
    }

    def image(vertices: torch.Tensor, psf: torch.Tensor, density: torch.Tensor) -> torch.Tensor:
        otf = renderer.otf(optics.with_parameters(psf))
        return renderer.image(renderer.transform(vertices, density), otf).reshape(-1)

    with torch.no_grad():
        noise = ImageNoise(measured, likelihood)  # type: ignore[arg-type]
        model = image(*inputs.values())
        model = model * (measured.std() / model.std()) + measured.mean() - model.mean()
        weights = noise.weights(measured, model if likelihood == "poisson" else None)

    def loss(*at: torch.Tensor) -> torch.Tensor:
        return match(image(*at), measured, weights.to(measured.dtype))[0]

    found = {}
    rng = np.random.default_rng(2)
    for name in inputs:
        at = {k: v.clone().requires_grad_(k == name) for k, v in inputs.items()}
        loss(*at.values()).backward()
        gradient = at[name].grad
        worst = 0.0
        for _ in range(3):
            way = torch.from_numpy(rng.normal(size=at[name].shape))
            way /= way.norm()
            exact = _slope(loss, inputs, name, way)
            scale = float(gradient.norm()) / np.sqrt(way.numel())
            worst = max(worst, float(abs(float((gradient * way).sum()) - exact) / scale))
        found[name] = worst
    return found


def _slope(
    loss: Callable[..., torch.Tensor],
    inputs: dict[str, torch.Tensor],
    name: str,
    way: torch.Tensor,
    step: float = 1e-3,
) -> float:
    def at(h: float) -> float:
        moved = {k: v + h * way if k == name else v for k, v in inputs.items()}
        with torch.no_grad():
            return float(loss(*moved.values()))

    near, far = at(step) - at(-step), at(2 * step) - at(-2 * step)
    return (8 * near - far) / (12 * step)


# ------------------------------------------------------------------------------------- long fits


@dataclass(frozen=True)
class LongFit:
    """What became of a mesh in a long fit; sizes are relative to the start."""

    iterations: int
    finite: bool
    area: float
    volume: float
    centre_inside: bool  # in the image
    moved_late: float  # shift of the centre over the last nine tenths of the iterations, um
    grown_late: float  # growth of the area over them
    grown_mb: float  # memory of the process, over them too


@contextmanager
def never_ending() -> Iterator[None]:
    """Fits that do not end by themselves.

    No setting asks for that: a fit ends when hardly anything is to be gained.
    """
    with mock.patch.object(LevelRun, "_finished", return_value=False):
        yield


def fit_to_noise(iterations: int, ends: bool, seed: int = 0, fit_psf: bool = False) -> LongFit:
    """A sphere of 42 vertices and nothing to find: 16^3 voxels of Poisson noise.

    ``ends``: whether the fit may end by itself.
    """
    grid = nd.Grid((16, 16, 16), (0.1, 0.1, 0.1))
    image = np.random.default_rng(seed).poisson(20, grid.shape).astype(np.float64)
    mesh = sphere((0.75, 0.75, 0.75), 0.4, subdivisions=1)
    settings = FitSettings(levels=(1.0,), max_iterations=iterations, fit_psf=fit_psf)
    finite, memory, early, state = True, 0.0, mesh, None
    with nullcontext() if ends else never_ending():
        for state in nd.fit(image, grid, mesh, nd.GaussianPSF(0.13), settings=settings):
            vertices = state.mesh.vertices_numpy()
            finite = finite and bool(np.isfinite(vertices).all() and np.isfinite(state.loss))
            if state.iteration == iterations // 10:
                memory, early = resident_mb(), state.mesh
    assert state is not None
    centre = state.mesh.vertices_numpy().mean(0)
    first, last = grid.extent
    return LongFit(
        iterations=state.iteration,
        finite=finite,
        area=float(state.mesh.areas().sum() / mesh.areas().sum()),
        volume=float(state.mesh.volumes()[1] / mesh.volumes()[1]),
        centre_inside=bool(((centre >= first) & (centre <= last)).all()),
        moved_late=float(np.abs(centre - early.vertices_numpy().mean(0)).max()),
        grown_late=float(state.mesh.areas().sum() / early.areas().sum()),
        grown_mb=resident_mb() - memory,
    )


def resident_mb() -> float:
    """Memory of this process in MB; 0 where the system does not tell."""
    gc.collect()
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


# ------------------------------------------------------------------------------------ hard meshes


@dataclass(frozen=True)
class HardMesh:
    """What became of a mesh file: refused, or fitted."""

    name: str
    faces: int = 0
    closed: bool = False
    repairs: int = 0
    refused: str = ""
    iterations: int = 0
    finite: bool = True
    first_loss: float = np.nan
    last_loss: float = np.nan


def fit_hard_mesh(path: Path, iterations: int = 50) -> HardMesh:
    """Scaled to 20^3 voxels, rendered, and fitted to its own image from half a voxel beside it."""
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")
        try:
            mesh = nd.load_mesh(path)
        except nd.InputError as error:
            return HardMesh(path.name, refused=str(error).removeprefix(f"{path}: "))
    grid = nd.Grid((20, 20, 20), (0.1, 0.1, 0.1))
    low, high = (np.asarray(b) for b in mesh.bounds())
    mesh = scaled(mesh.translated(-(low + high) / 2), 1.3 / (high - low).max())
    mesh = mesh.translated((0.95, 0.95, 0.95))
    optics = nd.GaussianPSF(0.13)
    image = photons(mesh, grid, optics, None)
    settings = FitSettings(max_iterations=iterations)
    losses, finite = [], True
    for state in nd.fit(
        image, grid, mesh.translated((0.05, -0.05, 0.04)), optics, settings=settings
    ):
        losses.append(state.loss)
        finite = finite and bool(np.isfinite(state.mesh.vertices_numpy()).all())
    finite = finite and bool(np.isfinite(losses).all())
    return HardMesh(
        path.name,
        len(mesh.faces),
        mesh.is_closed(),
        len(messages),
        "",
        len(losses),
        finite,
        losses[0],
        losses[-1],
    )


# ---------------------------------------------------------------------------------------- threads

THREADED = {
    "at one level": FitSettings(levels=(1.0,)),
    "in double precision": FitSettings(accuracy=1e-5, levels=(1.5, 1.0)),
    "from coarse to fine": FitSettings(),
    "with PSF and smooth density": FitSettings(fit_psf=True, density="smooth"),
}


def apart_by_threads(settings: FitSettings, subdivisions: int = 2) -> tuple[float, int, int]:
    """Largest distance of a vertex after fits with 1 and 2 threads, over the size of the cell.

    Also how many iterations each took.
    """
    image = photons(TRUTH, GRID, OPTICS, 3)
    before, ends = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            *_, last = nd.fit(image, GRID, start(subdivisions), OPTICS, settings=settings)
            ends.append(last)
    finally:
        torch.set_num_threads(before)
    one, two = (end.mesh.vertices_numpy() for end in ends)
    apart = float(np.linalg.norm(one - two, axis=1).max() / (2 * RADIUS))
    return apart, ends[0].iteration, ends[1].iteration


# ------------------------------------------------------------------------------------------ units


def apart_by_units(unit: float, accuracy: float = 0.0, iterations: int = 24) -> float:
    """Largest distance of a vertex after fits in um and in another unit, over the cell's size.

    The first level is no whole number of voxels wide: rounding would choose between two grids. In
    double precision: what single leaves to chance, steps of second order make a hundred times as
    large.
    """
    here, there = (_end_in(u, accuracy, iterations) for u in (1.0, unit))
    apart = np.linalg.norm(here - there, axis=1)
    return float(apart.max() / (2 * RADIUS))


@cache
def _end_in(unit: float, accuracy: float, iterations: int) -> np.ndarray:
    """Vertices (V, 3) um of a fit in another unit."""
    grid = nd.Grid(GRID.shape, tuple(unit * d for d in GRID.voxel_size))  # type: ignore[arg-type]
    optics = nd.GaussianPSF(tuple(unit * s for s in OPTICS.sigma_um))
    settings = FitSettings(accuracy=accuracy, levels=(1.9, 1.0), max_iterations=iterations)
    image = photons(TRUTH, GRID, OPTICS, 3)
    *_, last = nd.fit(image, grid, scaled(start(), unit), optics, settings=settings)
    return last.mesh.vertices_numpy() / unit
