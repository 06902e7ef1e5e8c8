"""How cells are tracked: the settings that need nothing of the engine."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field, model_validator

from .fit_settings import Settings


class TrackSettings(Settings):
    """How cells are tracked through a series of images."""

    model_config = ConfigDict(allow_inf_nan=False)

    time_step: Annotated[float, Field(gt=0)] = Field(
        default=1.0, description="s from one frame to the next"
    )
    first: Annotated[int, Field(ge=0)] = Field(
        default=0, description="frame to start from, to which the seeds belong; the first is 0"
    )
    stop: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="frame to stop before; None: the end of the series"
    )
    divisions: bool = Field(
        default=True,
        description="a cell divides where an unexplained wall appears in it and two daughters "
        "explain the image better",
    )
    velocity: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.8,
        description="share of a cell's last displacement that the next one is expected to have; it "
        "is used only where it explains the image better than no displacement",
    )

    @model_validator(mode="after")
    def _some_frames(self) -> TrackSettings:
        if self.stop is not None and self.stop - self.first < 2:
            raise ValueError(
                f"frames {self.first}:{self.stop} are too few: tracking needs two or more"
            )
        return self
