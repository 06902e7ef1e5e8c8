"""Density of fluorophores over the surface: uniform, one number per interface, or smooth."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from ..common.choices import DensityModel
from ..geometry.mesh import FloatArray, Mesh
from .lbfgs import dot
from .preconditioner import Preconditioner, adjacency

_LARGEST_ESTIMATE = 1.5  # |log density| that the image at the start may say
LIMIT = 2.0  # |log density|: a wall dimmer than e^-2 of the mean is no evidence of a wall
# Nats: the prior is 1/2 of each, times the squared logarithm of a piece of surface as large as the
# PSF's width squared, and times its squared differences along edges (which, in two dimensions, do
# not depend on the mesh).
_AWAY, _ROUGH = 1.0, 1.0


class Density:
    """The log densities of a mesh: how faces follow from them, and what is known beforehand.

    A smooth field is one number per vertex. Its prior holds it near the mean and smooth, so that
    it follows slow changes of brightness and cannot stand in for shape.

    Parameters
    ----------
    mesh
        Its faces and their areas.
    model
        ``"uniform"``, ``"interface"`` or ``"smooth"``.
    width
        um: of the PSF.
    """

    def __init__(self, mesh: Mesh, model: DensityModel, width: float) -> None:
        self.model = model
        self._faces = torch.from_numpy(np.asarray(mesh.faces))
        self._area = mesh.areas() * mesh.membranes() + 1e-300
        self._interface = mesh.interfaces()[1].astype(np.int64)
        n = len(mesh.vertices)
        pieces = np.zeros(0)
        if model == "smooth":
            third = np.repeat(mesh.areas() / 3, 3)
            pieces = np.bincount(mesh.faces.ravel(), third, n) / (3 * width) ** 2
            a = adjacency(mesh)
            self._rough = sp.diags(np.asarray(a.sum(1)).ravel()) - a
        elif model == "interface":
            pieces = np.bincount(self._interface, mesh.areas()) / (3 * width) ** 2
        self._pieces = pieces

    def __len__(self) -> int:
        return len(self._pieces)

    def faces(self, log: Tensor) -> Tensor | None:
        """(F,) density to render with, differentiable in the logarithms (D,); None: uniform."""
        if self.model == "uniform":
            return None
        if self.model == "smooth":
            return torch.exp(log[self._faces.to(log.device)].mean(1))
        return torch.exp(log[torch.from_numpy(self._interface).to(log.device)])

    def faces_numpy(self, log: FloatArray) -> FloatArray:
        """(F,) density relative to the mean."""
        found = self.faces(torch.from_numpy(np.asarray(log)))
        return np.ones(len(self._area)) if found is None else found.numpy()

    def prior(self, log: FloatArray) -> tuple[float, FloatArray]:
        """Nats, and their gradient (D,)."""
        pull = _AWAY * self._pieces * log
        if self.model == "smooth":
            pull = pull + _ROUGH * (self._rough @ log)
        return 0.5 * dot(log, pull), pull

    def centred(self, log: FloatArray) -> FloatArray:
        """The same of mean density 1; the amplitude takes the factor.

        Steps would take hundreds of iterations to that, and which voxels count depends on it.
        """
        return log - np.log(self._mean(log)) if len(log) else log

    def bounded(self, log: FloatArray) -> FloatArray:
        """The same within the limits, of mean density 1."""
        if not len(log):
            return log
        return np.clip(self.centred(log), -LIMIT, LIMIT)

    def estimate(self, ratio: FloatArray, smoother: Preconditioner) -> FloatArray:
        """(V,) log density from the brightness of the image where the surface lies.

        Steps from one density take dozens of iterations to tell bright surfaces from dim ones, and
        meanwhile the shape, or light from inside, stands in for the difference.

        Parameters
        ----------
        ratio
            (V,) measured over rendered brightness at the vertices.
        smoother
            Of functions on the surface.
        """
        log = np.log(np.clip(ratio, np.exp(-_LARGEST_ESTIMATE), np.exp(_LARGEST_ESTIMATE)))
        return self.bounded(smoother.solve(torch.from_numpy(log[:, None]))[:, 0].numpy())

    def _mean(self, log: FloatArray) -> float:
        return float(np.average(self.faces_numpy(log), weights=self._area))
