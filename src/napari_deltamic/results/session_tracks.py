"""Tracked cells in a session file, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.reading import toml_values
from ..errors import InputError
from ..geometry.archive import ArchiveReader, ArchiveWriter, MeshReader, MeshWriter
from ..runs.settings import validated
from ..runs.track_run import TrackRun
from ..tracking import FrameResult
from .event_facts import EventFacts
from .session_bead import keep_bead, with_bead
from .session_facts import FrameFacts, TracksFacts
from .session_parts import SavedTracks

_NUMBERS = 8  # of a frame: number, time, loss, iterations, seconds, three widths of the PSF


def tracks_facts(archive: ArchiveWriter, meshes: MeshWriter, tracks: SavedTracks) -> TracksFacts:
    """Write tracked cells; by what is returned :func:`saved_tracks` finds them again."""
    archive.add_array("series", tracks.pixels)
    kept: Any = keep_bead(archive, "tracks/bead", tracks.settings)
    archive.add_text("tracks.toml", kept.to_toml())
    # A table: what is not known is NaN, which JSON does not know.
    numbers = [
        (r.frame, r.time, r.loss, r.iterations, r.seconds, *r.sigma_um) for r in tracks.results
    ]
    archive.add_array("tracks/numbers", np.array(numbers, np.float64).reshape(-1, _NUMBERS))
    return TracksFacts(
        time=tracks.time,
        seconds=tracks.seconds,
        shared_ground=tracks.shared_ground,
        frames=[
            FrameFacts(
                mesh=meshes.add(f"tracks/{r.frame}/vertices", r.mesh) if r.mesh else None,
                message=r.message,
                psf=r.psf,
                structure=r.structure,
                moving=r.moving,
                grade=r.grade,
                judgement=r.judgement,
                events=EventFacts.of(r.events),
            )
            for r in tracks.results
        ],
    )


def saved_tracks(archive: ArchiveReader, facts: TracksFacts) -> SavedTracks:
    """What :func:`tracks_facts` wrote. InputError if it is missing or damaged."""
    pixels, numbers = archive.array("series"), archive.array("tracks/numbers")
    if pixels.ndim != 4 or numbers.shape != (len(facts.frames), _NUMBERS):
        raise InputError("its series does not belong to its tracks")
    settings: Any = validated(TrackRun, toml_values(archive.text("tracks.toml")))
    settings = with_bead(archive, "tracks/bead", settings)
    there = (numbers[:, 0] >= 0) & (numbers[:, 0] < len(pixels))
    if not 0 <= settings.track.first < len(pixels) or not there.all():
        raise InputError("its tracks are of frames that its series does not have")
    meshes = MeshReader(archive)
    return SavedTracks(
        pixels=pixels,
        time=facts.time,
        results=tuple(
            _frame(meshes, frame, row.tolist())
            for frame, row in zip(facts.frames, numbers, strict=True)
        ),
        settings=settings,
        seconds=facts.seconds,
        shared_ground=facts.shared_ground,
    )


def _frame(meshes: MeshReader, facts: FrameFacts, row: list[float]) -> FrameResult:
    frame, time, loss, iterations, seconds, z, y, x = row
    return FrameResult(
        frame=int(frame),
        time=time,
        mesh=meshes.mesh(facts.mesh) if facts.mesh else None,
        message=facts.message,
        events=tuple(e.event(int(frame)) for e in facts.events),
        loss=loss,
        iterations=int(iterations),
        seconds=seconds,
        sigma_um=(z, y, x),
        psf=facts.psf,
        structure=facts.structure,
        moving=facts.moving,
        grade=facts.grade,
        judgement=facts.judgement,
    )
