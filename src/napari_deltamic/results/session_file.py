"""A whole session in one file, ``*.deltamic``: image, seeds, settings, result, states, tracks.

The file is a zip of NumPy arrays (``.npy``), ``run.toml`` with the settings and ``session.json``
with the rest; it needs no other file. See :mod:`napari_deltamic.geometry.archive`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from ..common.triple import triple
from ..errors import InputError
from ..geometry.archive import ArchiveReader, ArchiveWriter, MeshWriter, opened
from .session_bead import keep_bead
from .session_parts import SavedImage, SavedLayer, SavedResult, SavedTracks, Session
from .session_result import result_facts, saved_result, settings_of
from .session_tracks import saved_tracks, tracks_facts

EXTENSION = ".deltamic"
VERSION = 1  # of the format; grows when older versions could not read a file
_FORMAT = "napari-deltamic session"
_WHAT = "a deltaMic session"


def save_session(path: str | os.PathLike[str], session: Session) -> None:
    """Write a session; the file appears whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    archive = ArchiveWriter()
    meshes = MeshWriter(archive)
    facts: dict[str, Any] = {
        "format": _FORMAT,
        "version": VERSION,
        "written_by": f"napari-deltamic {_version()}",
        "image": _image_facts(archive, "image", session.image),
        "second": _image_facts(archive, "second", session.second) if session.second else None,
        "seeds": [_layer_facts(archive, k, seed) for k, seed in enumerate(session.seeds)],
        "panels": session.panels,
        "result": result_facts(archive, meshes, session.result) if session.result else None,
        "tracks": tracks_facts(archive, meshes, session.tracks) if session.tracks else None,
    }
    archive.add_text("run.toml", keep_bead(archive, "run/bead", session.settings).to_toml())
    archive.add_json("session.json", facts)
    archive.write(path)


def load_session(path: str | os.PathLike[str]) -> Session:
    """Read what :func:`save_session` wrote; arrays and numbers come back bit for bit.

    Raises
    ------
    InputError
        In one line: missing, not a session, damaged, or written by a newer version.
    """
    with opened(path, _WHAT) as archive:
        facts = archive.json("session.json")
        if not isinstance(facts, dict) or facts.get("format") != _FORMAT:
            raise InputError("session.json says nothing of this format")
        newer = int(facts["version"]) > VERSION
        session = None if newer else _session(archive, facts)
    if session is None:
        raise InputError(
            f"{path}: written by a newer version ({facts.get('written_by', 'unknown')}): "
            f"this is napari-deltamic {_version()}"
        )
    return session


# ---- writing -------------------------------------------------------------------------------------


def _image_facts(archive: ArchiveWriter, name: str, image: SavedImage) -> dict[str, Any]:
    archive.add_array(name, image.pixels)
    return {"voxel_size": image.voxel_size, **_place(image), "display": image.display}


def _layer_facts(archive: ArchiveWriter, index: int, layer: SavedLayer) -> dict[str, Any]:
    for name, array in layer.arrays.items():
        archive.add_array(f"seeds/{index}/{name}", array)
    return {
        "kind": layer.kind,
        "arrays": list(layer.arrays),
        **_place(layer),
        "options": layer.options,
    }


def _place(layer: SavedImage | SavedLayer) -> dict[str, Any]:
    return {
        "name": layer.name,
        "scale": layer.scale,
        "translate": layer.translate,
        "units": layer.units,
    }


# ---- reading -------------------------------------------------------------------------------------


def _session(archive: ArchiveReader, facts: Mapping[str, Any]) -> Session:
    found = _image(archive, "image", facts["image"])
    # Earlier versions had neither a second view nor tracks.
    second, tracks = facts.get("second"), facts.get("tracks")
    return Session(
        settings=settings_of(archive, "run.toml"),
        image=found,
        seeds=tuple(_layer(archive, k, seed) for k, seed in enumerate(facts["seeds"])),
        result=saved_result(archive, facts["result"], found.grid) if facts["result"] else None,
        panels=dict(facts["panels"]),
        second=_image(archive, "second", second) if second else None,
        tracks=saved_tracks(archive, tracks) if tracks else None,
    )


def _image(archive: ArchiveReader, name: str, facts: Mapping[str, Any]) -> SavedImage:
    image = SavedImage(
        pixels=archive.array(name),
        voxel_size=triple(facts["voxel_size"]),
        display=dict(facts["display"]),
        **_placed(facts),
    )
    if image.pixels.ndim != 3:
        raise InputError(
            f"its {name} is not 3D" if name == "image" else "its second view is not 3D"
        )
    return image


def _placed(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "name": str(facts["name"]),
        "scale": triple(facts["scale"]),
        "translate": triple(facts["translate"]),
        "units": tuple(str(u) for u in facts["units"]),
    }


def _layer(archive: ArchiveReader, index: int, facts: Mapping[str, Any]) -> SavedLayer:
    arrays = {name: archive.array(f"seeds/{index}/{name}") for name in facts["arrays"]}
    return SavedLayer(
        str(facts["kind"]), arrays=arrays, options=dict(facts["options"]), **_placed(facts)
    )


def _version() -> str:
    try:
        return version("napari-deltamic")
    except PackageNotFoundError:
        return "unknown"


__all__ = [
    "EXTENSION",
    "VERSION",
    "SavedImage",
    "SavedLayer",
    "SavedResult",
    "SavedTracks",
    "Session",
    "load_session",
    "save_session",
]
