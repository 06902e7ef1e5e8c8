"""The command line, called as a user calls it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, find_objects
from skimage.segmentation import expand_labels

from napari_deltamic import Mesh, load_mesh, save_mesh
from napari_deltamic.geometry import sphere

from .imaging import APERTURE, Field, point_spread, wavelength
from .scenes import Scene

PROGRAM = (sys.executable, "-m", "napari_deltamic")


@dataclass(frozen=True)
class Outcome:
    """What the command left: report, mesh (None where it failed), seconds, last words."""

    report: dict[str, Any]
    mesh: Mesh | None
    seconds: float
    words: str


@cache
def known_options() -> str:
    """The help of ``fit``: what can be told depends on the version."""
    return subprocess.run(
        [*PROGRAM, "fit", "--help"], capture_output=True, text=True, check=True
    ).stdout


def fitted(
    scene: Scene, folder: Path, told: bool, patience: float, further: Sequence[str] = ()
) -> Outcome:
    """Image, voxel size and seeds alone; or all that is true, neighbours included.

    further : words of the command for either.
    """
    folder.mkdir(parents=True, exist_ok=True)
    image = folder / "image.tif"
    tifffile.imwrite(image, scene.image, imagej=True, metadata={"axes": "ZYX"})
    seeds = _seeds(scene, folder, told)
    words = ["fit", str(image), "--voxel-size", *map(str, scene.voxel_size), "--seeds", seeds]
    if told:
        words += [*_psf(scene, folder), *_possible(scene.recipe.told)]
    out = folder / ("told" if told else "default")
    words += [*further, "-o", str(out), "--overwrite"]
    began = time.monotonic()
    try:
        done = subprocess.run([*PROGRAM, *words], capture_output=True, text=True, timeout=patience)
    except subprocess.TimeoutExpired:
        return Outcome({}, None, time.monotonic() - began, "ran out of time")
    seconds = time.monotonic() - began
    last = (done.stderr.strip().splitlines() or [""])[-1]
    if done.returncode:
        return Outcome({}, None, seconds, last)
    report = json.loads((out / "report.json").read_text())
    return Outcome(report, load_mesh(out / "mesh.ply"), seconds, last)


def _without_tops(labels: NDArray[np.integer], share: float) -> NDArray[np.integer]:
    """Labels without that share of the height of each, at the top."""
    result = labels.copy()
    for name, box in enumerate(find_objects(labels), 1):
        if box is not None:
            first, last = box[0].start, box[0].stop
            top = slice(first, first + round(share * (last - first)))
            result[top][labels[top] == name] = 0
    return result


def _shrunk(
    labels: NDArray[np.integer], share: float, voxel_size: Sequence[float]
) -> NDArray[np.integer]:
    """Labels of which each reaches so much less far from its deepest place."""
    result = np.zeros_like(labels)
    for name, box in enumerate(find_objects(labels), 1):
        if box is not None:
            own = np.pad(labels[box] == name, 1)
            depth = distance_transform_edt(own, sampling=voxel_size)[1:-1, 1:-1, 1:-1]
            result[box][depth > (1 - share) * depth.max()] = name
    return result


def _psf(scene: Scene, folder: Path) -> list[str]:
    """Options that say what the PSF is."""
    microscope, across = scene.recipe.microscope, scene.recipe.psf[1] * scene.voxel_size[2]
    if not microscope:
        return ["--sigma", *map(str, scene.sigma)]
    if scene.recipe.aberrated or scene.recipe.leaning:
        field = Field(scene.recipe.shape, scene.voxel_size)
        how = scene.recipe.aberrated, scene.recipe.leaning
        point = point_spread(microscope, field, across, *how)
        tifffile.imwrite(folder / "psf.tif", point.astype(np.float32))
        return ["--psf", str(folder / "psf.tif"), "--psf-voxel-size", *map(str, field.fine_size)]
    wave = f"{wavelength(microscope, across):.4f}"
    words = ["--modality", microscope, "--na", str(APERTURE), "--immersion", "water"]
    words += ["--psf-model", "scalar", "--wavelength", wave]
    return [*words, "--excitation", wave] if microscope == "confocal" else words


def _possible(told: tuple[str, ...]) -> list[str]:
    """Options with one value each, those that this version has."""
    pairs = zip(told[::2], told[1::2], strict=True)
    return [word for pair in pairs if pair[0] in known_options() for word in pair]


def _seeds(scene: Scene, folder: Path, told: bool) -> str:
    recipe = scene.recipe
    if recipe.seeds == "auto":
        return "auto"
    names = list(scene.centres) if told else list(recipe.seeded)
    scale, offset = recipe.start
    direction = np.array([0.48, 0.6, 0.64])
    centres = {k: scene.centres[k] + offset * scene.radii[k] * direction for k in names}
    if recipe.seeds == "labels":
        path = folder / "seeds.tif"
        known = scene.all_labels if told and scene.strangers else scene.labels
        known = _without_tops(expand_labels(known, recipe.grown), recipe.topless)
        known = known if told else _shrunk(known, recipe.shrunk, scene.voxel_size)
        tifffile.imwrite(path, known.astype(np.uint16), imagej=True, metadata={"axes": "ZYX"})
    elif recipe.seeds == "mesh":
        path = folder / "seeds.ply"
        balls = [
            sphere(centres[k], scale * scene.radii[k], edge_length=2 * min(scene.voxel_size))
            for k in names
        ]
        parts = zip(names, balls, strict=True)
        save_mesh(Mesh.merge([Mesh(b.vertices, b.faces, b.regions * k) for k, b in parts]), path)
    else:
        path = folder / "seeds.csv"
        radius = recipe.seeds == "spheres"
        lines = ["z,y,x,radius" if radius else "z,y,x"]
        for k in names:
            z, y, x = centres[k] if radius else scene.centres[k]
            lines.append(f"{z},{y},{x}" + (f",{scale * scene.radii[k]}" if radius else ""))
        path.write_text("\n".join(lines) + "\n")
    return str(path)


def renumbered(scene: Scene, mesh: Mesh) -> Mesh:
    """Regions of a fit from CSV seeds are numbered by line; here they get the truth's names."""
    if scene.recipe.seeds in ("labels", "mesh"):
        return mesh
    names = np.array([0, *scene.recipe.seeded])
    regions = np.where(mesh.regions < len(names), mesh.regions, 0)
    return Mesh(mesh.vertices, mesh.faces, names[regions])
