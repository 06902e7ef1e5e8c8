"""Light from inside the cells."""

from __future__ import annotations

from typing import Annotated, ClassVar

import torch
from pydantic import Field
from torch import Tensor

from .base import Bounds, Cost, Effect, Where


class Bulk(Effect):
    """Fluorophores inside the regions: cytoplasm, nuclei, or a dye that is not only membrane.

    What counts is the difference to the outside. It is negative where the medium around shines more
    than the inside; the level outside is then that of the background.
    """

    name: ClassVar[str] = "bulk"
    where: ClassVar[Where] = "object"
    help: ClassVar[str] = (
        "the inside of the cells shines, or (negative) is darker than the medium around; left out, "
        "at a tenth of the rim's brightness, surfaces shift by a hundred nm"
    )
    cost: ClassVar[Cost] = Cost(transforms=2, closed_form=6)
    bounds: ClassVar[dict[str, Bounds]] = {"density": Bounds("1/um", -100.0, 100.0, 0.1)}

    density: Annotated[float, Field(ge=-100, le=100)] = Field(
        default=0.0,
        description="fluorophores per um^3 that the inside has more than the outside, for one per "
        "um^2 of membrane; the same in all cells",
    )
    regions: dict[int, Annotated[float, Field(ge=0, le=100)]] = Field(
        default={}, description="region -> factor on the density; 1 where not given"
    )

    def hides_reach(self) -> bool:
        """An inside darker than the outside would leave out voxels just because they are dark."""
        return self.density < 0

    def densities(self, regions: Tensor) -> Tensor:
        """Density in each region of an array of their numbers; 0 outside (region 0)."""
        found = torch.where(regions > 0, 1.0, 0.0).to(torch.float64)
        for region, factor in self.regions.items():
            found = torch.where(regions == region, factor, found)
        return self.density * found
