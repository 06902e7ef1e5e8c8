"""Simulation: a noisy image of a scene, with its ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..common.choices import Bits
from ..common.one_thread import one_thread
from ..errors import InputError
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from .effects import VoxelEffect
from .grid import Grid
from .noise import detected, intensities
from .render import offset, render_scene
from .scene import Scene
from .structures import Solid, Surface

BACKGROUND_SHARE = 0.1  # of the photons at the peak, if no background is given
_RINGS = 0.1  # of the peak; chosen: images of PSFs narrower than voxels ring below zero, too


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated image and its ground truth.

    Attributes
    ----------
    scene, grid
        What was simulated.
    image
        (Z, Y, X) uint8, uint16 or float32: intensities, with noise.
    noise_free
        (Z, Y, X) float32: the mean intensities, before saturation.
    mesh
        All surfaces and solids; None if there are none.
    labels
        (Z, Y, X) int32: the region at the centre of each voxel, 0 outside; None without a mesh.
    parameters
        Plain values: seed, photons, amplitude, background, bits.
    """

    scene: Scene
    grid: Grid
    image: NDArray[Any]
    noise_free: NDArray[np.float32]
    mesh: Mesh | None
    labels: NDArray[np.int32] | None
    parameters: dict[str, Any]


def simulate(
    scene: Scene,
    grid: Grid,
    *,
    photons: float | None = None,
    photons_per_density: float | None = None,
    background: float | None = None,
    seed: int = 0,
    bits: Bits = 16,
    accuracy: float = 1e-6,
) -> Simulation:
    """Make an image of a scene, with the noise of photons and of its camera.

    The same arguments give the same bytes, whatever the number of threads.

    Parameters
    ----------
    scene
        The camera effect, if present, turns photons into intensities and adds its noise; voxels of
        the effect ``missing`` get its value (0 if it has none).
    grid
        Where the voxels lie.
    photons
        Photons in the brightest voxel, on top of the background; by default 100.
    photons_per_density
        Alternatively, photons collected for each unit of the structures' densities (each
        fluorophore, thus per um^2 of a membrane of density 1).
    background
        Photons in every voxel; by default a tenth of those at the peak.
    seed
        Seed of the noise.
    bits
        8 (uint8), 12 or 16 (uint16), or 32 (float32).
    accuracy
        Relative L2 error of the image without noise.

    Raises
    ------
    InputError
        If a number is out of range, both kinds of photons are given, nothing of the scene is seen,
        light would be negative, or the image does not fit into the bits.
    """
    view = scene.effects.view
    if view is not None:
        raise InputError(f"a simulation shows one view: leave out the effect {view.name}")
    if photons is not None and photons_per_density is not None:
        raise InputError("give photons at the peak, or photons per density, not both")
    for name, value in (("photons", photons), ("photons_per_density", photons_per_density)):
        if value is not None and not (isfinite(value) and value > 0):
            raise InputError(f"{name} must be positive, not {value}")
    if background is not None and not (isfinite(background) and background >= 0):
        raise InputError(f"background must be 0 or more photons, not {background}")
    with one_thread(), torch.no_grad():
        image = render_scene(scene, grid, accuracy).to(torch.float64).numpy()
    peak = float(image.max())
    if not peak > 0:
        raise InputError("nothing of the scene is seen: does it lie inside the image?")
    amplitude = photons_per_density or (photons or 100.0) / peak
    ground = BACKGROUND_SHARE * amplitude * peak if background is None else background
    camera = scene.effects.detector
    light = amplitude * image + ground
    added = offset(scene.effects, grid)
    if added is not None:  # in the unit of the image
        light = light + added.numpy() / (camera.gain if camera else 1.0)
    if light.min() < -_RINGS * amplitude * peak:
        raise InputError(
            f"negative light: {light.min():.3g} photons in the darkest voxel; give more "
            "background, or insides that take less from it"
        )
    noisy = detected(light, camera, _generator(seed), bits)
    for effect in scene.effects.present():
        if isinstance(effect, VoxelEffect):
            effect.spoil(noisy)
    mesh = true_mesh(scene)
    return Simulation(
        scene,
        grid,
        noisy,
        intensities(light, camera).astype(np.float32),
        mesh,
        None if mesh is None else voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin),
        {
            "seed": int(seed),
            "photons": amplitude * peak,
            "amplitude": amplitude,
            "background": ground,
            "bits": bits,
            "accuracy": accuracy,
        },
    )


def true_mesh(scene: Scene) -> Mesh | None:
    """Merge the meshes of surfaces and solids; one that both share counts once."""
    meshes: list[Mesh] = []
    for structure in scene.structures:
        if isinstance(structure, (Surface, Solid)) and all(
            structure.mesh is not mesh for mesh in meshes
        ):
            meshes.append(structure.mesh)
    if not meshes:
        return None
    return meshes[0] if len(meshes) == 1 else Mesh.merge(meshes)


def _generator(seed: int) -> np.random.Generator:
    if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
        raise InputError(f"a seed is a whole number from 0 on, not {seed!r}")
    return np.random.Generator(np.random.PCG64(seed))
