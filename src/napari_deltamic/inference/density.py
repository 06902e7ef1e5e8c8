"""Density of fluorophores over the surface: uniform, one number per interface, or smooth."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..geometry.mesh import Mesh
from ..settings import DensityModel
from .optimiser import AdamUniform
from .preconditioner import Preconditioner

_STEP = 0.15  # of the log density, first iteration of a level
_LIMIT = 2.0  # |log density|: a wall dimmer than e^-2 of the mean is no evidence of a wall


class DensityField:
    """Log density and its optimiser; amplitudes are solved for, so its mean stays zero.

    A smooth field is one number per vertex, with the gradient preconditioned as the vertices' is,
    so that it follows slow changes of brightness and cannot stand in for shape.
    """

    def __init__(self, mesh: Mesh, pieces: np.ndarray, model: DensityModel) -> None:
        self.model = model
        self._faces = torch.from_numpy(np.asarray(mesh.faces))
        self._area = mesh.areas() * mesh.membranes()
        self._interface = torch.from_numpy(mesh.interfaces()[1].astype(np.int64))
        count = {
            "uniform": 0,
            "interface": int(self._interface.max()) + 1,
            "smooth": len(mesh.vertices),
        }[model]
        self.log = np.zeros(count)
        groups = pieces if model == "smooth" else np.arange(count)
        # One number for each interface: the size of its steps follows it closely, or it would
        # crawl towards the end, its first gradients in mind.
        betas = (0.9, 0.9) if model == "interface" else (0.9, 0.99)
        self._adam = AdamUniform(groups, 1, betas)
        self._leaf: Tensor | None = None

    def _per_face(self, log: Tensor) -> Tensor:
        if self.model == "smooth":
            return torch.exp(log[self._faces].mean(1))
        return torch.exp(log[self._interface])

    @property
    def per_vertex(self) -> np.ndarray | None:
        """(V,) log density where it is smooth, else None."""
        return self.log if self.model == "smooth" else None

    def faces(self, active: bool) -> Tensor | None:
        """(F,) density to render with, tracking gradients; None where it is uniform.

        A smooth one waits until it is active. Numbers of interfaces are too few to stand in for
        shape; held back, the shape would stand in for them: a wall crumples where it is brighter
        than the rest.
        """
        self._leaf = None
        active = active or self.model == "interface"
        if self.model == "uniform" or not (active or self.log.any()):
            return None
        self._leaf = torch.from_numpy(self.log.copy()).requires_grad_(active)
        return self._per_face(self._leaf)

    def faces_numpy(self) -> np.ndarray:
        """(F,) density relative to the mean."""
        if self.model == "uniform":
            return np.ones(len(self._faces))
        return self._per_face(torch.from_numpy(self.log)).numpy()

    def step(self, smoother: Preconditioner, factor: float) -> None:
        """One step along the gradient that the last backward pass left."""
        if self._leaf is None or self._leaf.grad is None:
            return
        gradient = self._leaf.grad.numpy()[:, None]
        if self.model == "smooth":
            step = smoother.solve(self._adam.step(smoother.solve(gradient)))
        else:
            step = self._adam.step(gradient)
        log = self.log - _STEP * factor * step[:, 0]
        density = self._per_face(torch.from_numpy(log)).numpy()
        log = log - np.log(np.average(density, weights=self._area + 1e-300))
        self.log = np.clip(log, -_LIMIT, _LIMIT)

    def restart(self) -> None:
        """Forget the optimiser's past."""
        self._adam.restart()

    def state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        return {"log": self.log, **self._adam.state()}

    def load(self, state: dict[str, np.ndarray]) -> None:
        """Take over what a checkpoint kept."""
        self.log = state["log"].copy()
        self._adam.load(state)
