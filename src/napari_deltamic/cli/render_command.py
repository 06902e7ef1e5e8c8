"""``napari-deltamic render``: the image of a mesh under a PSF."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import failure
from ..fitting.model.checks import check_mesh
from ..geometry import load_mesh
from ..images.stacks import write_image
from ..scene import Grid, render
from ..scene.effects import Effects
from .messages import Notes, tell
from .optics_arguments import optics_from_arguments


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Render the image and write it; prints the path."""
    output = Path(arguments.output)
    grid = Grid(tuple(arguments.shape), tuple(arguments.voxel_size))
    optics = optics_from_arguments(arguments)
    effects = Effects.from_text(arguments.effects or "none")
    mesh = load_mesh(arguments.mesh)
    check_mesh(mesh, grid)
    notes.release()
    try:
        image = render(mesh, grid, optics, arguments.accuracy, effects=effects)
        write_image(output, image.numpy(), grid.voxel_size)
    except (MemoryError, RuntimeError) as error:
        raise failure(error, grid.shape) from error
    tell(output)
    return 0
