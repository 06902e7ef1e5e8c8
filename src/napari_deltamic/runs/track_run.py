"""The settings of a whole run of tracking."""

from __future__ import annotations

from pydantic import model_validator

from .settings import RunSettings
from .track_settings import TrackSettings as TrackSettings


class TrackRun(RunSettings):
    """A whole run of tracking. Its ``run.toml`` repeats it."""

    image: str  # file of a series, or a folder or pattern of 3D images
    track: TrackSettings = TrackSettings()

    @model_validator(mode="after")
    def _one_view(self) -> TrackRun:
        if self.scene.effects.view is not None:
            raise ValueError("a second view cannot be tracked: leave it out")
        return self
