"""``napari-deltamic simulate``: noisy images whose cells, labels and parameters are known."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tqdm import tqdm

from ..errors import failure
from ..fitting.model.checks import check_mesh
from ..geometry import Mesh, load_mesh
from ..results.simulation_files import FILES, write_simulation
from ..runs.optics_settings import optics_from_values
from ..scene import Grid, Scene, random_cells, simulate
from ..scene.effects import Effects
from ..scene.structures import membranes_and_insides
from .folders import check_folder
from .messages import Notes, tell
from .optics_arguments import optics_from_arguments, optics_values


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Simulate and write; prints the path of each file, or of each image's folder."""
    count, folder = arguments.count, Path(arguments.output)
    folders = [folder] if count == 1 else [folder / f"{k:05}" for k in range(count)]
    for place in folders:
        check_folder(place, FILES, overwrite=arguments.overwrite)
    grid = Grid(tuple(arguments.shape), tuple(arguments.voxel_size))
    optics, effects = optics_from_arguments(arguments), Effects.from_text(arguments.effects)
    values = optics_values(arguments)
    settings = None if values is None else optics_from_values(values)
    fixed = _fixed_mesh(arguments, grid)
    for effect in effects.present():
        if effect.bounds and effect == type(effect).neutral():
            notes.add(f"the effect {effect.name} changes nothing without its numbers")
    notes.release()
    tqdm.monitor_interval = 0
    bar = tqdm(folders, file=sys.stderr, disable=None if count > 1 else True, leave=False)
    for k, place in enumerate(bar):
        seed = arguments.seed + k
        try:
            mesh = fixed or random_cells(arguments.cells, grid, arguments.kind or "foam", seed)
            made = simulate(
                Scene(membranes_and_insides(mesh, arguments.interior), optics, effects),
                grid,
                photons=arguments.photons,
                photons_per_density=arguments.photons_per_um2,
                background=arguments.background,
                seed=seed,
                bits=arguments.bits,
            )
            paths = write_simulation(place, made, settings)
        except (MemoryError, RuntimeError) as error:
            raise failure(error, grid.shape) from error
        for path in paths if count == 1 else [place]:
            tell(path)
    return 0


def _fixed_mesh(arguments: argparse.Namespace, grid: Grid) -> Mesh | None:
    """The mesh in the given file; None if the cells are random."""
    if arguments.mesh is None:
        return None
    mesh = load_mesh(arguments.mesh)
    check_mesh(mesh, grid)
    return mesh
