"""Cells through a series of images: each frame starts from the last, identities stay."""

from .result import Event, FrameResult, Lineage, TrackState, lineage, surface_4d
from .settings import TrackSettings
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
