"""Weighted points on elements (points, segments, triangles): which, and in which proportions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .native import native
from .quadrature import Rule


@dataclass(frozen=True, eq=False)
class Points:
    """Rules of quadrature, each with the elements that take it.

    An element that no rule names has no points.
    """

    rules: Sequence[tuple[Rule, np.ndarray]] = field(repr=False)
    elements: int

    def of(self, kept: np.ndarray) -> Points:
        """The points of some elements; kept : (E,) bool."""
        if kept.all():
            return self
        return Points([(r, of[kept[of]]) for r, of in self.rules], self.elements)

    @cached_property
    def count(self) -> int:
        """Of all points."""
        return sum(len(r.weights) * len(of) for r, of in self.rules)

    @cached_property
    def compiled(self) -> Any:
        """As the compiled loops take them."""
        module = native()
        assert module is not None
        rule = np.zeros(self.elements, np.int32)
        corners = self.rules[0][0].barycentric.shape[1] if self.rules else 1
        start, places, weights = [0, 0], [np.zeros((0, corners))], [np.zeros(0)]
        for number, (r, of) in enumerate(self.rules, 1):
            rule[of] = number
            start.append(start[-1] + len(r.weights))
            places.append(r.barycentric)
            weights.append(r.weights)
        given = np.concatenate(places), np.concatenate(weights)
        return module.Quadrature(rule, np.array(start, np.int64), *given)

    def groups(
        self, real: torch.dtype, device: torch.device
    ) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Barycentric places (P, corners), weights (P,) and elements (N,) of each rule."""
        key = real, device
        if key not in self._groups:
            self._groups[key] = [
                (placed(r.barycentric, *key), placed(r.weights, *key), torch.tensor(of).to(device))
                for r, of in self.rules
            ]
        return self._groups[key]

    @cached_property
    def _groups(
        self,
    ) -> dict[tuple[torch.dtype, torch.device], list[tuple[Tensor, Tensor, Tensor]]]:
        return {}


def placed(values: np.ndarray, real: torch.dtype, device: torch.device) -> Tensor:
    """On a device that may know no double precision."""
    kind = np.float32 if real == torch.float32 else np.float64
    return torch.from_numpy(values.astype(kind)).to(device)
