"""Threads and spots, both much thinner than the PSF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError
from ...fourier.filament import LinePlan, make_line_plan, path_segments
from ...geometry.arrays import FloatArray, to_numpy
from ..effects import Effects
from .checked_numbers import Values, as_tensor, check_numbers, checked_positions, one_each
from .seen import joined_boxes, shares
from .site import Planned, Site


@dataclass(frozen=True, eq=False)
class Filament:
    """Thin threads: straight segments between vertices.

    Attributes
    ----------
    vertices
        (V, 3) um; rendering is differentiable in a tensor.
    segments
        (S, 2) the vertices that each segment joins; None: all in sequence.
    density
        Fluorophores per um: one number, or (S,).
    """

    vertices: np.ndarray | Tensor
    segments: np.ndarray | None = None
    density: Values = 1.0

    def __post_init__(self) -> None:
        n = len(checked_positions(self.vertices, "vertices"))
        joined = self.joined()
        if joined.ndim != 2 or joined.shape[1] != 2 or not len(joined):
            raise InputError(f"segments must have shape (S, 2), not {joined.shape}")
        if joined.min() < 0 or joined.max() >= n:
            raise InputError("a segment names a vertex that is not there")
        check_numbers(self.density, len(joined), "density", "segment")

    def joined(self) -> np.ndarray:
        """Return (S, 2) the segments."""
        if self.segments is None:
            return path_segments(len(self.vertices))
        return np.asarray(self.segments, np.int64)

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return checked_positions(self.vertices, "vertices")

    def planned(self, site: Site) -> Planned:
        """See ``Structure``."""
        segments = self.joined()
        weights = one_each(self.density, len(segments))
        return _PlannedLine.of(as_tensor(self.vertices), segments, weights, site)


@dataclass(frozen=True, eq=False)
class Points:
    """Spots much smaller than the PSF.

    Attributes
    ----------
    places
        (P, 3) um; rendering is differentiable in a tensor.
    weight
        Fluorophores in each spot: one number, or (P,).
    """

    places: np.ndarray | Tensor
    weight: Values = 1.0

    def __post_init__(self) -> None:
        n = len(checked_positions(self.places, "points"))
        if not n:
            raise InputError("there are no points")
        check_numbers(self.weight, n, "weight", "point")

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return checked_positions(self.places, "points")

    def planned(self, site: Site) -> Planned:
        """See ``Structure``."""
        places = as_tensor(self.places)
        every = np.arange(len(places))[:, None]
        return _PlannedLine.of(places, every, one_each(self.weight, len(places)), site)


@dataclass(frozen=True)
class _PlannedLine:
    """Segments or points planned for a site; see ``Planned``."""

    plan: LinePlan
    vertices: Tensor
    elements: Tensor
    weights: Tensor
    site: Site

    @classmethod
    def of(
        cls, vertices: Tensor, elements: np.ndarray, weights: Tensor, site: Site
    ) -> _PlannedLine:
        plan = make_line_plan(
            to_numpy(vertices) - np.asarray(site.grid.origin),
            elements,
            site.fft_shape,
            site.grid.voxel_size,
            site.width,
            site.accuracy,
            site.method,
            site.aligned,
            site.cutoff,
            site.transfer,
            site.stretch,
        )
        return cls(plan, vertices, torch.from_numpy(elements), weights, site)

    def transform(
        self, effects: Effects, vertices: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """See ``Planned``."""
        vertices = self.vertices if vertices is None else vertices
        placed = self.site.local(vertices)

        def middles() -> Tensor:
            return vertices[self.elements].mean(1).to(torch.float64)

        weights = self.weights if density is None else self.weights * density
        seen = shares(weights, middles, self.site.frame, effects)
        return joined_boxes([self.plan.transform(placed, self.elements, part) for part in seen])
