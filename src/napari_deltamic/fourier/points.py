"""Weighted quadrature points on elements (points, segments, triangles)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..common.kept import kept
from .native import native
from .quadrature import Rule


@dataclass(frozen=True, eq=False)
class Listed:
    """All points, sorted by element, in the format of the GPU's kernels.

    Attributes
    ----------
    element, place
        (P,) int32: element of each point, and its row in ``barycentric`` and ``weights``.
    start
        (E + 1,) int32: where the points of each element begin.
    barycentric, weights
        (places, corners), (places,) of all rules, double.
    """

    element: Tensor
    place: Tensor
    start: Tensor
    barycentric: Tensor
    weights: Tensor

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.element)


@dataclass(frozen=True, eq=False)
class Points:
    """Quadrature rules, each with the elements that use it.

    An element without a rule has no points.
    """

    rules: Sequence[tuple[Rule, np.ndarray]] = field(repr=False)
    elements: int

    def of(self, kept: np.ndarray) -> Points:
        """Return the points of some elements only; kept : (E,) bool."""
        if kept.all():
            return self
        return Points([(r, of[kept[of]]) for r, of in self.rules], self.elements)

    @cached_property
    def count(self) -> int:
        """Number of all points."""
        return sum(len(r.weights) * len(of) for r, of in self.rules)

    @cached_property
    def compiled(self) -> Any:
        """The points in the format of the compiled loops."""
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
        return module.Quadrature(
            rule, np.array(start, np.int64), np.concatenate(places), np.concatenate(weights)
        )

    @kept
    def groups(
        self, real: torch.dtype, device: torch.device
    ) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Return barycentric places (P, corners), weights (P,) and elements (N,) of each rule."""
        key = real, device
        return [
            (placed(r.barycentric, *key), placed(r.weights, *key), torch.tensor(of).to(device))
            for r, of in self.rules
        ]

    @kept
    def listed(self, device: torch.device) -> Listed:
        """Return all points one by one, on a device."""
        first, each = (np.zeros(self.elements, np.int64) for _ in range(2))
        at = 0
        for r, of in self.rules:
            first[of], each[of] = at, len(r.weights)
            at += len(r.weights)
        start = np.append(0, np.cumsum(each))
        element = np.repeat(np.arange(self.elements), each)
        place = first[element] + np.arange(len(element)) - start[element]
        corners = self.rules[0][0].barycentric.shape[1] if self.rules else 1
        shares = np.concatenate([np.zeros((0, corners)), *(r.barycentric for r, _ in self.rules)])
        weights = np.concatenate([np.zeros(0), *(r.weights for r, _ in self.rules)])
        counts = (torch.from_numpy(a.astype(np.int32)).to(device) for a in (element, place, start))
        reals = (placed(a, torch.float64, device) for a in (shares, weights))
        return Listed(*counts, *reals)


def placed(values: np.ndarray, real: torch.dtype, device: torch.device) -> Tensor:
    """Move values to a device that may have no double precision."""
    kind = np.float32 if real == torch.float32 else np.float64
    return torch.from_numpy(values.astype(kind)).to(device)
