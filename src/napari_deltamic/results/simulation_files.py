"""Writes a simulation: the image, its ground truth, and the settings that fit it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..common.writing import make_folder, write_atomically, written_together
from ..geometry import save_mesh
from ..images.stacks import write_image
from ..runs.optics_settings import OpticsSettings
from ..runs.settings import FitSettings, RunSettings, SceneSettings
from ..scene.simulate import Simulation
from ..scene.structures import Solid

FILES = (
    "image.tif",
    "noise_free.tif",
    "mesh.ply",
    "mesh.rec",
    "labels.tif",
    "run.toml",
    "parameters.json",
)


def write_simulation(
    folder: str | os.PathLike[str], simulation: Simulation, optics: OpticsSettings | None = None
) -> list[Path]:
    """Write a simulation; files of the same names are replaced.

    ``image.tif`` (with noise), ``noise_free.tif`` (mean intensities), ``mesh.ply`` and ``mesh.rec``
    (um), ``labels.tif`` (the region of each voxel), ``run.toml`` (fits the image from the labels)
    and ``parameters.json`` (the true values of everything else). Without a mesh, what follows from
    it is left out.

    Parameters
    ----------
    folder
        Made if it is not there.
    optics
        Settings that the PSF was built from, for the fit; by default a Gaussian PSF as wide.

    Returns
    -------
    list of paths, in the order of ``FILES``.

    Raises
    ------
    InputError
        If the folder or a file cannot be written.
    """
    folder = Path(folder).absolute()
    make_folder(folder)
    grid = simulation.grid
    image, noise_free, ply, rec, labels, toml, parameters = (folder / name for name in FILES)
    with written_together(parameters):
        write_image(image, simulation.image, grid.voxel_size)
        write_image(noise_free, simulation.noise_free, grid.voxel_size)
        written = [image, noise_free]
        if simulation.mesh is not None and simulation.labels is not None:
            save_mesh(simulation.mesh, ply)
            save_mesh(simulation.mesh, rec)
            small = simulation.labels.max() < 2**16
            write_image(
                labels,
                simulation.labels.astype(np.uint16) if small else simulation.labels,
                grid.voxel_size,
            )
            settings = RunSettings(
                image=str(image),
                seeds=str(labels),
                scene=SceneSettings(
                    voxel_size=grid.voxel_size,
                    origin=grid.origin,
                    sigma=simulation.scene.optics.sigma_um if optics is None else None,
                    optics=optics,
                    effects=simulation.scene.effects,
                ),
                fit=FitSettings(),
            )
            write_atomically(toml, settings.to_toml().encode())
            written += [ply, rec, labels, toml]
        text = json.dumps(facts(simulation), indent=2) + "\n"
        write_atomically(parameters, text.encode())
    return [*written, parameters]


def facts(simulation: Simulation) -> dict[str, Any]:
    """Return the true values of a simulated image, without its meshes, as plain values."""
    grid, scene = simulation.grid, simulation.scene
    volumes = simulation.mesh.volumes() if simulation.mesh is not None else {}
    return {
        "version": __version__,
        **simulation.parameters,
        "grid": grid.as_plain(),
        "structures": [type(s).__name__.lower() for s in scene.structures],
        "interiors": [s.densities().tolist() for s in scene.structures if isinstance(s, Solid)],
        "optics": {
            "model": type(scene.optics).__name__,
            "sigma_um": list(scene.optics.sigma_um),
            **{p.name: p.value for p in scene.optics.described()},
        },
        "effects": scene.effects.to_dict(),
        "volumes_um3": {str(region): volume for region, volume in volumes.items()},
    }
