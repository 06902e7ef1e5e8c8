"""A whole session in one file, ``*.deltamic``: image, seeds, settings, result, states, tracks.

The file is a zip of NumPy arrays (``.npy``), ``run.toml`` with the settings and ``session.json``
with the rest; it needs no other file. See :mod:`napari_deltamic.geometry.archive`.
"""

from __future__ import annotations

import os
from typing import Any

from pydantic import ValidationError

from ..common.version import __version__
from ..common.wrong_value import first_wrong_value
from ..errors import InputError
from ..geometry.archive import ArchiveReader, ArchiveWriter, MeshWriter, opened
from .session_bead import keep_bead
from .session_facts import SESSION, ImageFacts, LayerFacts, SessionFacts
from .session_parts import SavedImage, SavedLayer, Session
from .session_result import result_facts, saved_result, settings_of
from .session_tracks import saved_tracks, tracks_facts

EXTENSION = ".deltamic"
VERSION = 1  # of the format; raised when older versions of this package could not read a file
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
    facts = SessionFacts(
        format=_FORMAT,
        version=VERSION,
        written_by=f"napari-deltamic {__version__}",
        image=_image_facts(archive, "image", session.image),
        second=_image_facts(archive, "second", session.second) if session.second else None,
        seeds=[_layer_facts(archive, k, seed) for k, seed in enumerate(session.seeds)],
        panels=session.panels,
        result=result_facts(archive, meshes, session.result) if session.result else None,
        tracks=tracks_facts(archive, meshes, session.tracks) if session.tracks else None,
    )
    archive.add_text("run.toml", keep_bead(archive, "run/bead", session.settings).to_toml())
    archive.add_json("session.json", SESSION.dump_python(facts, by_alias=True, warnings=False))
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
        session = None if newer else _session(archive, _facts(facts))
    if session is None:
        raise InputError(
            f"{path}: written by a newer version ({facts.get('written_by', 'unknown')}): "
            f"this is napari-deltamic {__version__}"
        )
    return session


# ---- writing -------------------------------------------------------------------------------------


def _image_facts(archive: ArchiveWriter, name: str, image: SavedImage) -> ImageFacts:
    archive.add_array(name, image.pixels)
    return ImageFacts(voxel_size=image.voxel_size, display=image.display, **_place(image))


def _layer_facts(archive: ArchiveWriter, index: int, layer: SavedLayer) -> LayerFacts:
    for name, array in layer.arrays.items():
        archive.add_array(f"seeds/{index}/{name}", array)
    arrays = list(layer.arrays)
    return LayerFacts(kind=layer.kind, arrays=arrays, options=layer.options, **_place(layer))


def _place(layer: SavedImage | SavedLayer | ImageFacts | LayerFacts) -> dict[str, Any]:
    return {name: getattr(layer, name) for name in ("name", "scale", "translate", "units")}


# ---- reading -------------------------------------------------------------------------------------


def _facts(plain: dict[str, Any]) -> SessionFacts:
    try:
        return SESSION.validate_python(plain)
    except ValidationError as error:
        raise InputError(first_wrong_value(error)) from None


def _session(archive: ArchiveReader, facts: SessionFacts) -> Session:
    found = _image(archive, "image", facts.image)
    return Session(
        settings=settings_of(archive, "run.toml"),
        image=found,
        seeds=tuple(_layer(archive, k, seed) for k, seed in enumerate(facts.seeds)),
        result=saved_result(archive, facts.result, found.grid) if facts.result else None,
        panels=facts.panels,
        second=_image(archive, "second", facts.second) if facts.second else None,
        tracks=saved_tracks(archive, facts.tracks) if facts.tracks else None,
    )


def _image(archive: ArchiveReader, name: str, facts: ImageFacts) -> SavedImage:
    pixels = archive.array(name)
    if pixels.ndim != 3:
        raise InputError(
            f"its {name} is not 3D" if name == "image" else "its second view is not 3D"
        )
    return SavedImage(
        pixels=pixels, voxel_size=facts.voxel_size, display=facts.display, **_place(facts)
    )


def _layer(archive: ArchiveReader, index: int, facts: LayerFacts) -> SavedLayer:
    arrays = {name: archive.array(f"seeds/{index}/{name}") for name in facts.arrays}
    return SavedLayer(facts.kind, arrays=arrays, options=facts.options, **_place(facts))
