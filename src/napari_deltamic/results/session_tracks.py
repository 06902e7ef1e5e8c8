"""Writes tracked cells into a session file and reads them back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..common.reading import toml_values
from ..errors import InputError
from ..geometry.archive import ArchiveReader, ArchiveWriter, MeshReader, MeshWriter
from ..runs.settings import validated
from ..runs.track_run import TrackRun
from .session_bead import keep_bead, with_bead
from .session_facts import TracksFacts
from .session_parts import SavedTracks


def tracks_facts(archive: ArchiveWriter, meshes: MeshWriter, tracks: SavedTracks) -> TracksFacts:
    """Write tracked cells; returns facts by which :func:`saved_tracks` finds them again."""
    archive.add_array("series", tracks.pixels)
    kept: Any = keep_bead(archive, "tracks/bead", tracks.settings)
    archive.add_text("tracks.toml", kept.to_toml())
    return TracksFacts(
        time=tracks.time,
        seconds=tracks.seconds,
        shared_ground=tracks.shared_ground,
        frames=list(tracks.results),
        meshes=[
            meshes.add(f"tracks/{r.frame}/vertices", r.mesh) if r.mesh else None
            for r in tracks.results
        ],
    )


def saved_tracks(archive: ArchiveReader, facts: TracksFacts) -> SavedTracks:
    """Read what :func:`tracks_facts` wrote. InputError if it is missing or damaged."""
    pixels = archive.array("series")
    if pixels.ndim != 4 or len(facts.frames) != len(facts.meshes):
        raise InputError("its series does not belong to its tracks")
    settings: Any = validated(TrackRun, toml_values(archive.text("tracks.toml")))
    settings = with_bead(archive, "tracks/bead", settings)
    if not all(
        0 <= k < len(pixels) for k in (settings.track.first, *(r.frame for r in facts.frames))
    ):
        raise InputError("its tracks are of frames that its series does not have")
    meshes = MeshReader(archive)
    return SavedTracks(
        pixels=pixels,
        time=facts.time,
        results=tuple(
            replace(frame, mesh=meshes.mesh(mesh) if mesh else None)
            for frame, mesh in zip(facts.frames, facts.meshes, strict=True)
        ),
        settings=settings,
        seconds=facts.seconds,
        shared_ground=facts.shared_ground,
    )
