"""``napari-deltamic simulate``: noisy images whose cells, labels and parameters are known."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, get_args

from tqdm import tqdm

from ..errors import InputError
from ..geometry import Mesh, load_mesh
from ..inference.checks import check_mesh
from ..optics_settings import optics_from_values
from ..scene import Grid, Scene, Surface, random_cells, simulate
from ..scene.effects import Effects
from ..scene.noise import Bits
from ..scene.random_cells import Kind
from ..simulation_files import FILES, write_simulation
from .folders import check_folder
from .messages import Notes, failure
from .optics_arguments import add_grid_and_optics, optics_from_arguments, optics_values

_MOST = 100_000  # images of one set


def add_parser(commands: Any) -> None:
    """Add the command to the parser of all."""
    parser = commands.add_parser(
        "simulate",
        help="make noisy images whose cells are known, for tests, teaching and training",
        description="Simulate an image of a mesh, or of random cells. Writes image.tif, "
        "noise_free.tif, mesh.ply, mesh.rec, labels.tif, parameters.json, and run.toml, which fits "
        "the image. The same options give the same bytes.",
    )
    add = parser.add_argument
    add("mesh", nargs="?", metavar="MESH", help=".ply, .obj, .off, .stl, .rec or .vtk; um")
    add("--cells", type=int, metavar="N", help="so many random cells instead of a mesh")
    add("--kind", choices=get_args(Kind), help="of random cells (default: foam)")
    add_grid_and_optics(parser)
    add(
        "--effects",
        default="none",
        metavar="E",
        help="with their numbers, as attenuation=0.02,bulk=0.1,camera:gain=2:offset=100",
    )
    add("--photons", type=float, metavar="P", help="in the brightest voxel (default: 100)")
    add(
        "--photons-per-um2",
        type=float,
        metavar="P",
        help="of membrane, instead of those in the brightest voxel",
    )
    add("--background", type=float, metavar="B", help="photons (default: a tenth of the brightest)")
    add(
        "--bits",
        type=int,
        choices=get_args(Bits),
        default=16,
        help="of an intensity; 32 is float32 (default: %(default)s)",
    )
    add("--seed", type=int, default=0, metavar="S", help="of cells and noise (default: 0)")
    add("--count", type=int, default=1, metavar="N", help="images, of seeds S, S+1, ...")
    add("--overwrite", action="store_true", help="replace the results in DIR")
    add(
        "-o",
        "--output",
        required=True,
        metavar="DIR",
        help="folder for the results; with --count, a folder in it for each image",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Simulate and write; prints the path of each file, or of each image's folder."""
    count, folder = arguments.count, Path(arguments.output)
    if not 1 <= count <= _MOST:
        raise InputError(f"--count must be 1 to {_MOST}, not {count}")
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
                Scene((Surface(mesh),), optics, effects),
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
            print(path)
    return 0


def _fixed_mesh(arguments: argparse.Namespace, grid: Grid) -> Mesh | None:
    """The mesh of a file; None where cells are random."""
    if (arguments.mesh is None) == (arguments.cells is None):
        raise InputError("simulate needs MESH or --cells N" + ", not both" * bool(arguments.mesh))
    if arguments.mesh is None:
        return None
    if arguments.kind is not None:
        raise InputError("--kind goes with --cells, not with a mesh")
    mesh = load_mesh(arguments.mesh)
    check_mesh(mesh, grid)
    return mesh
