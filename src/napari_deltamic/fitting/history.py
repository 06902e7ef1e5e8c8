"""The course of a fit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from .model.state import FitState


@dataclass
class History:
    """The course of a fit, state by state.

    loss, level, blur : one value an iteration, see ``FitState``.
    first : the iteration that they begin with; above 1 where a fit was resumed.
    """

    loss: list[float] = field(default_factory=list)
    level: list[int] = field(default_factory=list)
    blur: list[float] = field(default_factory=list)
    first: int = 1

    def add(self, state: FitState) -> None:
        """Note a state; call it for every one that the fit yields."""
        if not self.loss:
            self.first = state.iteration
        self.loss.append(float(state.loss))
        self.level.append(int(state.level))
        self.blur.append(float(state.blur))

    def levels(self) -> list[dict[str, Any]]:
        """For each level reached: number, blur, iterations and last loss."""
        found: list[dict[str, Any]] = []
        for loss, level, blur in zip(self.loss, self.level, self.blur, strict=True):
            if not found or found[-1]["level"] != level:
                found.append({"level": level, "blur": blur, "iterations": 0})
            found[-1]["iterations"] += 1
            found[-1]["loss"] = loss
        return found
