"""Settings of how cells are tracked; they need nothing of the engine."""

from __future__ import annotations

from pydantic import ConfigDict, model_validator

from ..common.description import setting
from .fit_settings import Settings


class TrackSettings(Settings):
    """How cells are tracked through a series of images."""

    model_config = ConfigDict(allow_inf_nan=False)

    time_step: float = setting(
        1.0, title="time step", tip="time from one frame to the next", unit="s", gt=0
    )
    first: int = setting(
        0,
        title="first frame",
        tip="frame to start from, to which the seeds belong; counted from 0",
        flag=None,
        ge=0,
    )
    stop: int | None = setting(
        None,
        title="stop before frame",
        tip="frame to stop before; default: the end of the series",
        flag=None,
        automatic="the end",
        ge=1,
    )
    divisions: bool = setting(
        True,
        title="cells may divide",
        tip="a cell divides where an unexplained wall appears in it and two daughters "
        "explain the image better",
    )
    velocity: float = setting(
        0.8,
        title="share of the last displacement",
        tip="share of a cell's last displacement expected from this frame to the next; used "
        "only where it explains the image better than no displacement",
        advanced=True,
        ge=0,
        le=1,
    )

    @model_validator(mode="after")
    def _some_frames(self) -> TrackSettings:
        if self.stop is not None and self.stop - self.first < 2:
            raise ValueError(
                f"frames {self.first}:{self.stop} are too few: tracking needs two or more"
            )
        return self
