"""Cells through a series of images: each frame starts from the last, identities stay."""

from ..runs.track_run import TrackSettings
from .result import Event, FrameResult, Lineage, TrackState, lineage, surface_4d
from .track import track

__all__ = [
    "Event",
    "FrameResult",
    "Lineage",
    "TrackSettings",
    "TrackState",
    "lineage",
    "surface_4d",
    "track",
]
