"""Density of fluorophores over the surface: uniform, one number per interface, or smooth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from ...common.choices import DensityModel
from ...common.kept import kept
from ...geometry.connected import adjacency
from ...geometry.mesh import FloatArray, IntArray, Mesh
from ..solvers.factors import on_host
from ..solvers.lbfgs import dot
from ..solvers.preconditioner import Preconditioner

_SOLVED = 1e-9  # of a row: what no face sees stays 0; as exact as densities in a file


@dataclass(frozen=True)
class DensityRules:
    """How far densities may go, and what is thought of them beforehand.

    Attributes
    ----------
    largest_estimate
        |log density| that the image at the start may say: a factor of 4.5, less than the limit of a
        fit, so that it is free to go both ways. Measured: half and twice change nothing in small
        fits.
    limit
        |log density|: a wall dimmer than e^-2 of the mean is no evidence of a wall.
    away, rough
        The squared size of a field is the sum of each, times the squared logarithm of a piece of
        surface as large as the PSF's width squared, and times its squared differences along edges
        (which, in two dimensions, do not depend on the mesh).
    even
        Log density, in the mean over pieces: a smooth field smaller than this counts as even. Cow
        and fish, even and uneven by 0.15 and 0.6, at 10 and 200 photons: 0.03 and 0.1 were about as
        good.
    walls_first
        How bright insides have to be, of the peak of a membrane's image, for walls to differ in a
        smooth density, and for densities of walls to be fitted before it where many cells begin
        near their walls. Measured in ten such draws, membranes alone seem to have insides of 0.08
        to 0.27 at the start, cells with insides had 0.48 and more.
    """

    largest_estimate: float = 1.5
    limit: float = 2.0
    away: float = 1.0
    rough: float = 1.0
    even: float = 0.05
    walls_first: float = 0.4


RULES = DensityRules()


class Density:
    """The log densities of a mesh: how faces follow from them, and what is known beforehand.

    A smooth field is one number per vertex. Its prior holds it near the mean and smooth, so that
    it follows slow changes of brightness and cannot stand in for shape. How uneven it is, nobody
    knows beforehand: a Gaussian prior of unknown variance, integrated over it, is one of Student's
    t, which pulls a field that the image does not ask for to nothing, and lets go of another. An
    even surface is then found as well as by a model that knows that it is even.

    Parameters
    ----------
    mesh
        Its faces and their areas.
    model
        ``"uniform"``, ``"interface"`` or ``"smooth"``.
    width
        um: of the PSF.
    walls_differ
        Whether a smooth field is held near the mean of its wall, and means of walls as densities
        that belong to walls are. Where insides shine as well, and cells differ, walls that are held
        alike are made up for by shapes that are off.
    """

    def __init__(
        self, mesh: Mesh, model: DensityModel, width: float, walls_differ: bool = False
    ) -> None:
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
            self._walls = _Walls(mesh, self._interface, width) if walls_differ else None
        elif model == "interface":
            pieces = np.bincount(self._interface, mesh.areas()) / (3 * width) ** 2
        self._pieces = pieces

    def __len__(self) -> int:
        return len(self._pieces)

    def faces(self, log: Tensor) -> Tensor | None:
        """(F,) density to render with, differentiable in the logarithms (D,); None: uniform."""
        if self.model == "uniform":
            return None
        # Not by indexing, whose gradient sorts.
        if self.model == "smooth":
            corners = log.index_select(0, self._faces_on(log.device).reshape(-1))
            return torch.exp(corners.reshape(-1, 3).sum(1) / 3)
        return torch.exp(log.index_select(0, self._faces_on(log.device)))

    @kept
    def _faces_on(self, device: torch.device) -> Tensor:
        """(F, 3) vertices whose numbers a face takes, or (F,) its interface."""
        own = self._faces if self.model == "smooth" else torch.from_numpy(self._interface)
        return own.to(device)

    def faces_numpy(self, log: FloatArray) -> FloatArray:
        """(F,) density relative to the mean."""
        if self.model == "uniform":
            return np.ones(len(self._area))
        # Not by torch, which wakes all its threads for so little.
        if self.model == "smooth":
            return np.asarray(np.exp(log[self._faces.numpy()].mean(1)))
        return np.asarray(np.exp(log[self._interface]))

    def of_faces(self, density: FloatArray) -> FloatArray:
        """(D,) logarithms from which densities (F,) follow, in the sense of least squares."""
        each = np.log(np.clip(density, np.exp(-RULES.limit), np.exp(RULES.limit)))
        if self.model == "interface":
            return np.bincount(self._interface, each) / np.bincount(self._interface)
        if self.model == "uniform":
            return np.zeros(0)
        corners = self._faces.numpy()
        rows = np.repeat(np.arange(len(corners)), 3)
        shape = len(corners), len(self._pieces)
        mean = sp.coo_matrix((np.full(corners.size, 1 / 3), (rows, corners.ravel())), shape).tocsr()
        # Factored, as iterations would end with other last digits on another number of threads.
        normal = (mean.T @ mean + _SOLVED * sp.eye(shape[1])).tocoo()
        return on_host(normal)(torch.from_numpy(mean.T @ each)[:, None])[:, 0].numpy()

    def prior(self, log: FloatArray, independent: float = 1.0) -> tuple[float, FloatArray]:
        """Nats, and their gradient (D,).

        Parameters
        ----------
        independent
            Share of the voxels, and so of the pieces of a smooth field, that are independent.
        """
        if self.model != "smooth":
            pull = RULES.away * self._pieces * log
            return 0.5 * dot(log, pull), pull
        if self._walls is None:
            pull = RULES.away * self._pieces * log
        else:
            apart = self._walls.apart(log)
            pull = self._walls.apart_backwards(RULES.away * self._pieces * apart)
        pull += RULES.rough * (self._rough @ log)
        pieces, size = float(self._pieces.sum()), dot(log, pull)
        relative = size / (pieces * RULES.even**2)
        value = 0.5 * np.sqrt(independent) * pieces * float(np.log1p(relative))
        gradient = pull * self._strength(size, independent)
        if self._walls is None:
            return value, gradient
        walls, by_walls = self._walls.prior(log)
        return value + walls, gradient + by_walls

    def _strength(self, size: float, independent: float) -> float:
        """How firmly the prior holds a smooth field, from its squared size."""
        pieces = float(self._pieces.sum())
        return float(np.sqrt(independent)) * pieces / (pieces * RULES.even**2 + size)

    def unevenness(self, log: FloatArray, independent: float) -> tuple[FloatArray, float]:
        """(V,) squared size of a smooth field at each vertex, walls that differ included, and how
        firmly it would be held if they were not told apart from it."""
        size = log * (RULES.away * self._pieces * log + RULES.rough * (self._rough @ log))
        return size, self._strength(float(size.sum()), independent)

    def centred(self, log: FloatArray) -> FloatArray:
        """The same of mean density 1; the amplitude takes the factor.

        Steps would take hundreds of iterations to that, and which voxels count depends on it.
        """
        return log - np.log(self._mean(log)) if len(log) else log

    def bounded(self, log: FloatArray) -> FloatArray:
        """The same within the limits, of mean density 1."""
        if not len(log):
            return log
        return np.clip(self.centred(log), -RULES.limit, RULES.limit)

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
        most = RULES.largest_estimate
        log = np.log(np.clip(ratio, np.exp(-most), np.exp(most)))
        return self.bounded(smoother.solve(torch.from_numpy(log[:, None]))[:, 0].numpy())

    def _mean(self, log: FloatArray) -> float:
        return float(np.average(self.faces_numpy(log), weights=self._area))


class _Walls:
    """Means over walls of a field on vertices; a vertex of a junction belongs to all it bounds."""

    def __init__(self, mesh: Mesh, interface: IntArray, width: float) -> None:
        third = np.repeat(mesh.areas() / 3, 3)
        corner = np.repeat(interface, 3), mesh.faces.ravel()
        share = sp.coo_matrix((third, corner)).tocsr()
        own, at = (np.asarray(share.sum(axis)).ravel() + 1e-300 for axis in (1, 0))
        self._means, self._back = sp.diags(1 / own) @ share, sp.diags(1 / at) @ share.T
        self._pieces = np.bincount(interface, mesh.areas()) / (3 * width) ** 2

    def apart(self, log: FloatArray) -> FloatArray:
        """(V,) from the means of its walls."""
        found: FloatArray = log - self._back @ (self._means @ log)
        return found

    def apart_backwards(self, gradient: FloatArray) -> FloatArray:
        """(V,) gradient by the field, of one by what is apart."""
        found: FloatArray = gradient - self._means.T @ (self._back.T @ gradient)
        return found

    def prior(self, log: FloatArray) -> tuple[float, FloatArray]:
        """Nats of the means, and their gradient (V,)."""
        means = self._means @ log
        pull = RULES.away * self._pieces * means
        return 0.5 * dot(means, pull), self._means.T @ pull


Shown = tuple[
    Mesh, FloatArray | None
]  # a mesh and its log densities (D,), as far as they are known


def evener(
    model: DensityModel,
    before: Shown,
    after: Shown,
    width: float,
    points: Sequence[FloatArray],
    reach: float,
    independent: float,
) -> list[float]:
    """Nats by which the prior favours one surface over the one before, near some places.

    A membrane that is dim where there is none explains an image as well as one that is not there:
    how uneven it has to be for that speaks against it.

    Parameters
    ----------
    width
        um: of the PSF.
    points
        (n, 3) um of each place.
    reach
        um.
    independent
        See :meth:`Density.prior`.
    """
    if model != "smooth":
        return [0.0] * len(points)
    fields, firm = [], 0.0
    for mesh, known in (after, before):
        density = Density(mesh, model, width)
        log = np.zeros(len(density)) if known is None else known
        size, strength = density.unevenness(log, independent)
        firm = 0.5 * strength  # as firm as before
        fields.append((mesh.vertices_numpy(), size))
    found = []
    for each in points:
        here, there = (
            own[cKDTree(each).query(vertices)[0] <= reach].sum() for vertices, own in fields
        )
        found.append(firm * float(there - here))
    return found
