"""The mesh of a fit, where it is computed and where it is looked at."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ..fourier.devices import for_objects
from ..geometry.mesh import Mesh


class Surface:
    """A mesh whose vertices are on the device that computes; the host has them once it asks.

    It does not change: a step makes another one, and states share it.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._vertices: Tensor | None = None
        self._like = self.mesh = mesh

    def on(self, device: torch.device) -> Tensor:
        """(V, 3) float64 um, where meshes are transformed for images on a device."""
        there = for_objects(device)
        if self._vertices is None or self._vertices.device != there:
            # A copy: arrays of states must not be written to.
            self._vertices = torch.tensor(self.mesh.vertices_numpy(), device=there)
        return self._vertices

    def moved(self, vertices: Tensor) -> Surface:
        """The same connectivity with other vertices, (V, 3) on any device."""
        other = Surface.__new__(Surface)
        other._like, other._vertices = self._like, vertices
        return other

    @cached_property
    def mesh(self) -> Mesh:
        """On the host."""
        assert self._vertices is not None
        return self._like.with_vertices(on_host(self._vertices))


def on_host(numbers: Tensor) -> np.ndarray:
    """Read-only numbers of a device; of the CPU without a copy."""
    array = numbers.detach().cpu().numpy()
    array.setflags(write=False)  # states share it
    return array
