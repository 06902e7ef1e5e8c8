"""``napari-deltamic accuracy``: what accuracy costs in time, on a user's own scene and machine."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..accuracy.accuracy_chart import (
    shape_answer,
    shape_chart,
    shape_facts,
    shape_table,
    short,
    way_facts,
    ways_chart,
    ways_table,
)
from ..accuracy.forecast import Forecast
from ..accuracy.machine_costs import costs
from ..accuracy.outlook import expected
from ..accuracy.shape_error import DRAWS, ShapeError, photons_for, shape_errors
from ..accuracy.tradeoff import Way, measure_ways, with_front
from ..common.choices import RENDERED_ACCURACY
from ..common.words import counted, duration
from ..common.writing import make_folder, write_atomically
from ..errors import failure
from ..fitting import fit
from ..fitting.job import FitInput
from ..fitting.model.checks import check_mesh
from ..fitting.model.default_accuracy import accuracy_for, image_noise
from ..fourier.cuda import missing
from ..fourier.native import simd_level, threads
from ..geometry import Mesh, load_mesh
from ..geometry.formats import MESH_FILES
from ..optics import Optics
from ..scene import Grid
from .inputs import gather
from .messages import Bar, Notes, tell
from .optics_arguments import OPTICS_ARGUMENTS, optics_from_arguments


@dataclass(frozen=True)
class _Scene:
    """What is measured."""

    name: str
    mesh: Mesh
    grid: Grid
    optics: Optics
    accuracy: float
    noise: float | None = None
    job: FitInput | None = None

    @property
    def title(self) -> str:
        shape = " x ".join(map(str, self.grid.shape))
        cores = counted(threads(), "thread")
        return f"{self.name}: {shape} voxels, {len(self.mesh.faces)} faces, {cores}"


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Measure, print the tables, and write the files if a folder is given."""
    folder = Path(arguments.output) if arguments.output else None
    scene = _read(arguments, notes)
    if folder is not None:
        make_folder(folder)
    notes.release()
    try:
        costs(again=True)
        ways = _ways(scene, arguments.budget)
        told = None if scene.job is None else expected(scene.job)
        _say(scene, ways, told)
        shapes = _shapes(scene, arguments) if arguments.shape_error else []
    except (MemoryError, RuntimeError) as error:
        raise failure(error, scene.grid.shape) from error
    voxel = min(scene.grid.voxel_size)
    if shapes:
        print(f"\n{shape_table(shapes, voxel)}\n\n{shape_answer(shapes)}")
    if folder is not None:
        for path in _write(folder, scene, ways, told, shapes, voxel):
            tell(path)
    return 0


# -------------------------------------------------------------------------------------- input


def _read(arguments: argparse.Namespace, notes: Notes) -> _Scene:
    if Path(arguments.scene).suffix.lower() in MESH_FILES:
        return _from_mesh(arguments)
    return _from_image(arguments, notes)


def _from_mesh(arguments: argparse.Namespace) -> _Scene:
    grid = Grid(tuple(arguments.shape), tuple(arguments.voxel_size))
    optics = optics_from_arguments(arguments)
    mesh = load_mesh(arguments.scene)
    check_mesh(mesh, grid)
    accuracy = RENDERED_ACCURACY if arguments.accuracy is None else arguments.accuracy
    return _Scene(Path(arguments.scene).name, mesh, grid, optics, accuracy)


class _Blank(argparse.Namespace):
    """Arguments of `fit`; those not given are None."""

    def __getattr__(self, name: str) -> None:
        return None


def _from_image(arguments: argparse.Namespace, notes: Notes) -> _Scene:
    given = ("channel", "seeds", "voxel_size", "sigma", "missing_nan", *OPTICS_ARGUMENTS)
    asked = {name: getattr(arguments, name) for name in given}
    job = gather(_Blank(image=arguments.scene, **asked), notes)
    noise = image_noise(job.image)
    accuracy = accuracy_for(noise) if arguments.accuracy is None else arguments.accuracy
    job = job.with_settings(fit=job.settings.fit.model_copy(update={"accuracy": accuracy}))
    name = Path(arguments.scene).name
    return _Scene(name, job.mesh, job.grid, job.optics, accuracy, noise, job)


# ---------------------------------------------------------------------------------- measuring


@contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on stderr."""
    with Bar(desc=what, file=sys.stderr, leave=False, disable=None) as bar:

        def show(done: int, of: int) -> None:
            bar.total = of
            bar.update(done - bar.n)

        yield show


def _ways(scene: _Scene, budget: float) -> list[Way]:
    with _bar("ways to render") as progress:
        found = measure_ways(
            scene.mesh, scene.grid, scene.optics, scene.accuracy, budget=budget, progress=progress
        )
        return with_front(found)


def _shapes(scene: _Scene, arguments: argparse.Namespace) -> list[ShapeError]:
    """Surface errors: of the mesh at the given photons, or of the fit at the image's noise."""
    truth, optics = scene.mesh, scene.optics
    photons = arguments.photons
    if scene.job is not None:
        job = scene.job
        print("fitting the image, to simulate it ...", file=sys.stderr)
        last = None
        for last in fit(  # noqa: B007
            job.image, job.grid, job.mesh, job.optics,
            settings=job.settings.fit, counted=job.counted, effects=job.settings.scene.effects,
        ):  # fmt: skip
            pass
        assert last is not None
        truth = last.mesh
        photons = photons_for(float(scene.noise or 0), truth, scene.grid, optics)
    with _bar("fits of simulated images") as progress:
        found = shape_errors(
            truth,
            scene.grid,
            optics,
            photons,
            draws=arguments.draws or DRAWS,
            progress=progress,
        )
        return list(found)


# -------------------------------------------------------------------------------------- output


def _say(scene: _Scene, ways: list[Way], told: Forecast | None) -> None:
    print(scene.title)
    if scene.noise is not None:
        print(f"noise of a voxel: {scene.noise:.2g} of the range of the image")
    print(f"accuracy in use: {short(scene.accuracy)}")
    if told is not None:
        print(
            f"a fit from these seeds: about {duration(told.seconds)}, at the last level "
            f"{duration(told.seconds_per_iteration)} an iteration"
        )
    print(f"\n{ways_table(ways)}")
    if all(way.memory is None for way in ways):
        print("\nmemory: this system does not report the peak of a computation")
    why = missing() or "fits use the GPU, whose times are not measured here"
    print(f"\nmeasured on the CPU: {why}")


def _write(
    folder: Path,
    scene: _Scene,
    ways: list[Way],
    told: Forecast | None,
    shapes: list[ShapeError],
    voxel: float,
) -> list[Path]:
    facts: dict[str, Any] = {
        "version": __version__,
        "machine": {"threads": threads(), "cores": os.cpu_count(), "instructions": simd_level()},
        "scene": {
            "name": scene.name,
            "shape": list(scene.grid.shape),
            "voxel_size_um": list(scene.grid.voxel_size),
            "sigma_um": list(scene.optics.sigma_um),
            "faces": len(scene.mesh.faces),
            "vertices": len(scene.mesh.vertices),
        },
        "noise": scene.noise,
        "accuracy_in_use": scene.accuracy,
        "ways": [way_facts(way) for way in ways],
        "forecast": None if told is None else asdict(told),
        "shape": shape_facts(shapes, voxel) if shapes else None,
    }
    pictures = {"accuracy.png": ways_chart(ways, scene.title)}
    if shapes:
        pictures["shape.png"] = shape_chart(shapes, f"{scene.name}: error of the fitted surface")
    paths = []
    for name, chart in pictures.items():
        write_atomically(folder / name, chart.png())
        paths.append(folder / name)
    path = folder / "accuracy.json"
    write_atomically(path, (json.dumps(facts, indent=2, allow_nan=False) + "\n").encode())
    return [path, *paths]
