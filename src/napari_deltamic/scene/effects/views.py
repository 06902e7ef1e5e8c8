"""A second image of the same scene."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from .base import Cost, ViewEffect

Width = Annotated[float, Field(gt=0)]


class SecondView(ViewEffect):
    """The same scene through another PSF, as from a second objective, on the same grid."""

    name: ClassVar[str] = "second_view"
    title: ClassVar[str] = "second view"
    help: ClassVar[str] = (
        "a second image, registered to the first, seen through another PSF; left out, what only "
        "that one resolves is lost"
    )
    cost: ClassVar[Cost] = Cost(images=1, bands=2)

    fit: bool = Field(default=False, description="its PSF is held")
    sigma: tuple[Width, Width, Width] = Field(
        description="um, Z Y X: standard deviations of its Gaussian PSF"
    )
    image: str = Field(default="", description="file of the second image, on the first one's grid")
