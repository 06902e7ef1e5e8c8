"""Saves and loads a scene: one zip file with its arrays, its optics and its effects."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.archive import ArchiveReader, ArchiveWriter, MeshReader, MeshWriter, opened
from ..geometry.arrays import is_tensor, to_numpy
from ..optics import GaussianPSF, Optics
from ..runs.optics_settings import OpticsSettings, optics_from_values
from ..runs.settings import validated
from ..scene.effects import Effects
from ..scene.scene import Scene
from ..scene.structures import Filament, Points, Solid, Structure, Surface

_FORMAT = 1
_WHAT = "a scene"


def save_scene(
    scene: Scene, path: str | os.PathLike[str], optics: OpticsSettings | None = None
) -> None:
    """Write a whole scene: positions and densities bit for bit, the PSF, and the effects.

    Tensors are written as numbers; their gradients are not kept.

    Parameters
    ----------
    optics
        Settings from which the PSF was built; not needed for a Gaussian one. A measured PSF stays
        in the file that they name.

    Raises
    ------
    InputError
        If the file cannot be written, or settings of the PSF are missing.
    """
    archive = ArchiveWriter()
    meshes = MeshWriter(archive)
    structures = [
        _structure_facts(structure, f"structures/{k}", archive, meshes)
        for k, structure in enumerate(scene.structures)
    ]
    archive.add_json(
        "scene.json",
        {
            "format": _FORMAT,
            "structures": structures,
            "optics": _optics_facts(scene.optics, optics),
            "effects": scene.effects.to_dict(),
        },
    )
    archive.write(path)


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read what :func:`save_scene` wrote.

    Raises
    ------
    InputError
        In one line, with the path: missing, not a scene, damaged, or of a later version.
    """
    with opened(path, _WHAT) as archive:
        facts = archive.json("scene.json")
        if facts["format"] != _FORMAT:
            raise InputError(f"it has format {facts['format']}, this version reads {_FORMAT}")
        meshes = MeshReader(archive)
        structures = [_structure(each, archive, meshes) for each in facts["structures"]]
        optics = optics_from_values(facts["optics"]).build()
        return Scene(tuple(structures), optics, validated(Effects, facts["effects"]))


def _optics_facts(optics: Optics, given: Any) -> dict[str, Any]:
    if given is None:
        if not isinstance(optics, GaussianPSF):
            raise InputError(
                f"a {type(optics).__name__} does not say what it was made from: give its settings"
            )
        values = optics.sigma if optics.diagonal else optics.covariance
        name = "sigma" if optics.diagonal else "covariance"
        given = optics_from_values({"kind": "gaussian", name: values.detach().double().tolist()})
    found: dict[str, Any] = given.model_dump(mode="json", exclude_none=True)
    return found


def _structure_facts(
    structure: Structure, name: str, archive: ArchiveWriter, meshes: MeshWriter
) -> dict[str, Any]:
    def held(field: str, values: Any) -> Any:
        """Return a number, or store an array and return its name."""
        if np.ndim(to_numpy(values) if is_tensor(values) else values) == 0:
            return float(values)
        archive.add_array(f"{name}/{field}", to_numpy(values))
        return f"{name}/{field}"

    if isinstance(structure, Surface):
        mesh = meshes.add(f"{name}/vertices", structure.mesh)
        return {"kind": "surface", "mesh": mesh, "density": held("density", structure.density)}
    if isinstance(structure, Solid):
        mesh = meshes.add(f"{name}/vertices", structure.mesh)
        return {"kind": "solid", "mesh": mesh, "density": held("density", structure.densities())}
    if isinstance(structure, Filament):
        return {
            "kind": "filament",
            "vertices": held("vertices", structure.vertices),
            "segments": held("segments", structure.joined()),
            "density": held("density", structure.density),
        }
    if isinstance(structure, Points):
        return {
            "kind": "points",
            "places": held("places", structure.places),
            "weight": held("weight", structure.weight),
        }
    raise InputError(f"a scene file cannot hold a {type(structure).__name__}")


def _structure(facts: dict[str, Any], archive: ArchiveReader, meshes: MeshReader) -> Structure:
    def held(field: str) -> Any:
        value = facts[field]
        return archive.array(value) if isinstance(value, str) else value

    if facts["kind"] == "surface":
        return Surface(meshes.mesh(facts["mesh"]), held("density"))
    if facts["kind"] == "solid":
        return Solid(meshes.mesh(facts["mesh"]), held("density"))
    if facts["kind"] == "filament":
        return Filament(held("vertices"), held("segments"), held("density"))
    if facts["kind"] == "points":
        return Points(held("places"), held("weight"))
    raise InputError(f"it holds a structure of kind {facts['kind']!r}, which is not known here")
