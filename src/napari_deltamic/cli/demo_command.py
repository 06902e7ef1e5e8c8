"""``napari-deltamic demo``: a dividing cell whose true surface is known, and the fit of it.

In a window, or into a folder.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from ..common.writing import make_folder, write_atomically
from ..evidence import analyse_residual
from ..evidence.fit_facts import verdict_of
from ..fitting import FitState, fit
from ..fitting.history import History
from ..fitting.job import FitInput
from ..geometry import Mesh, save_mesh, sphere
from ..images.stacks import write_image
from ..measure import surface_distance
from ..optics import GaussianPSF
from ..results.report import write_results
from ..runs.settings import FitSettings, RunSettings, SceneSettings
from ..scene.samples import Sample, dividing_cell_sample
from .messages import Notes

START_RADIUS = 2.6  # um: smaller than the cells, so that one sees the spheres grow
SIGMA_ERROR = 1.3  # times too wide is the PSF at the start: enough to see that the fit mends it


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Open napari and show the fit; without a display or napari, fit and write the results."""
    notes.release()
    sample, folder = dividing_cell_sample(), Path(arguments.output)
    window = not arguments.headless and has_display()
    if window and find_spec("napari") is None:
        notes.add("napari is not installed, so the results are written: 'pip install napari[all]'")
        window = False
    if window:
        from ..gui.live_demo import show  # needs Qt and napari, unlike the rest

        show(sample, start_mesh(sample), demo_settings(sample, folder))
    else:
        run_headless(sample, folder)
    return 0


def has_display() -> bool:
    """Whether a window can be opened here."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def start_mesh(sample: Sample) -> Mesh:
    """Where the demonstration starts: a sphere for each cell, with edges of 2.5 voxels."""
    edge = 2.5 * min(sample.grid.voxel_size)  # finer than seeds have, to look smooth; else slower
    return Mesh.merge([sphere(center, START_RADIUS, edge_length=edge) for center in sample.centers])


def demo_settings(sample: Sample, folder: Path) -> RunSettings:
    """The run that the demonstration shows, with the files that it would read."""
    z, y, x = (SIGMA_ERROR * s for s in sample.optics.sigma_um)
    return RunSettings(
        image=str(folder.absolute() / "image.tif"),
        seeds=str(folder.absolute() / "seeds.ply"),
        scene=SceneSettings(voxel_size=sample.grid.voxel_size, sigma=(z, y, x)),
        fit=FitSettings(fit_psf=True),
    )


def run_headless(sample: Sample, folder: Path) -> None:
    """Fit, write the results, and print where they are and how good they are."""
    settings, mesh = demo_settings(sample, folder), start_mesh(sample)
    assert settings.scene.sigma is not None
    make_folder(folder)
    write_image(settings.image, sample.image, sample.grid.voxel_size)
    save_mesh(mesh, settings.seeds)
    save_mesh(sample.truth, folder / "truth.ply")
    write_atomically(folder / "run.toml", settings.to_toml().encode())
    shape = " x ".join(map(str, sample.grid.shape))
    print(f"fitting a {sample.name} in a noisy image of {shape} voxels ...", flush=True)
    history, state = History(), None
    started = time.monotonic()
    psf = GaussianPSF(settings.scene.sigma)
    for state in fit(sample.image, sample.grid, mesh, psf, settings=settings.fit):
        history.add(state)
    seconds = time.monotonic() - started
    assert state is not None, "a fit yields at least one state"
    job = FitInput(settings, sample.image, sample.grid, mesh, psf, None)
    left = analyse_residual(sample.image, sample.grid, state)
    found = verdict_of(job, state, left)
    paths = write_results(
        folder,
        state,
        sample.image,
        sample.grid,
        settings,
        history,
        seconds,
        explained=left.shares(),
        verdict=found,
    )
    print(f"shapes: {found.sentence()}")
    for line in summary(sample, state, seconds):
        print(line)
    print(f"written to {folder.absolute()}:")
    for path in paths:
        print(f"  {path.name}")


def summary(sample: Sample, state: FitState, seconds: float) -> list[str]:
    """Lines that compare the result of the fit with the truth."""
    distance = surface_distance(state.mesh, sample.truth, samples=5000)
    voxel = min(sample.grid.voxel_size)
    verdict = state.message or ("converged" if state.converged else "ended")
    psf = [" ".join(f"{s:.3f}" for s in o.sigma_um) for o in (state.optics, sample.optics)]
    return [
        f"{verdict}: {state.iteration} iterations, {seconds:.1f} s",
        f"surface error: {distance.mean / voxel:.3f} voxels on average, "
        f"{distance.p95 / voxel:.3f} at 95 % ({voxel:g} um voxels)",
        f"PSF widths: {psf[0]} um (Z Y X); the truth is {psf[1]}",
    ]
