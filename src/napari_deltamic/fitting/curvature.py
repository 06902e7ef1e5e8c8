"""The curvature of a log posterior along normals: Gauss-Newton steps, and the errors of measures.

``H = J' W J + kappa B''`` with J the derivatives of the measured images by displacements of
vertices along their normals, W one over the variance of each voxel, and B'' the curvature of the
bending energy. Amplitudes, backgrounds, PSF and effects follow the surface: they are eliminated by
their normal equations. Densities are held, and so is all that moves vertices along the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch
from scipy.linalg import cho_factor, cho_solve

from ..errors import InputError
from ..geometry.mesh import FloatArray, Mesh
from .convergence import vertex_normals
from .factors import on_host
from .likelihood import solve_scale
from .normal_jacobian import Colouring, normal_jacobian
from .posterior import Posterior
from .variables import Variables

# What is affordable: 154 colours of a 64^3 image took 2 s, most of it in transforms, or 50 ns for
# each voxel and colour: this is about a minute on one core.
_MOST_WORK = 1e9  # colours times voxels of the grid
_MOST_VERTICES = 20_000
_DENSE = 4_000  # vertices: up to here LAPACK is faster than a sparse factor (a row has hundreds)
_RIDGE = 1e-9  # of the mean diagonal: for vertices that no voxel sees and no prior holds

Solve = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of one measured number.

    Attributes
    ----------
    posterior
        If the variances of voxels were those that the objective takes them to be.
    sandwich
        With the variance that voxels really have, by their residuals, each for itself.
    """

    posterior: float
    sandwich: float


class Curvature:
    """The second derivatives of an objective by displacements along normals, factored.

    Parameters
    ----------
    posterior, at
        The objective, and where: at its least for the errors to mean something.
    mesh
        Its connectivity.
    held
        (V,) bool: vertices that stay.

    Raises
    ------
    InputError
        If there are too many vertices or voxels, see :func:`affordable`.
    """

    def __init__(
        self, posterior: Posterior, at: Variables, mesh: Mesh, held: np.ndarray | None = None
    ) -> None:
        colouring = _colouring(posterior, at, mesh)
        why = _too_much(colouring, posterior)
        if why:
            raise InputError(why)
        self._at = at
        self._free = np.ones(len(at.vertices)) if held is None else 1.0 - np.asarray(held, float)
        self.normals = vertex_normals(at.vertices, mesh.faces)
        images = posterior.images(at)
        views = zip(posterior.views, images, posterior.measured(at), strict=True)
        jacobians = normal_jacobian(posterior, at, self.normals, colouring)
        weights, residuals, columns, scaled = [], [], [], []
        for number, ((view, image, measured), jacobian) in enumerate(
            zip(views, jacobians, strict=True)
        ):
            weight = view.voxels.weights.detach().cpu().numpy().astype(np.float64)
            amplitude, background = _scale(image, measured, weight)
            own = np.zeros((len(image), 2 * len(images)))
            own[:, 2 * number], own[:, 2 * number + 1] = image, 1.0
            columns.append(own)
            weights.append(weight / view.variance)
            residuals.append(measured - amplitude * image - background)
            scaled.append(jacobian.multiply(amplitude))
        self._weights, self._residual = np.concatenate(weights), np.concatenate(residuals)
        self._jacobian: sp.csr_matrix = sp.vstack(scaled).tocsr() @ sp.diags(self._free)
        self._own = _with_imaging(np.concatenate(columns), posterior, at)
        self._factor(posterior, at)

    def _factor(self, posterior: Posterior, at: Variables) -> None:
        prior, held = posterior.prior, sp.diags(self._free)
        weighted = sp.diags(self._weights) @ self._jacobian
        given = at.vertices, self.normals
        bend = prior.bending.curvature(*given) + prior.junctions.curvature(*given)
        bend = prior.stiffness * bend
        matrix = (self._jacobian.T @ weighted + held @ bend @ held).tocsr()
        ridge = _RIDGE * float(matrix.diagonal().mean())
        # Rows of vertices that stay, or that have no normal, are those of a diagonal.
        empty = matrix.diagonal() <= 0
        self._surface = (matrix + sp.diags(np.where(empty, 1.0, ridge))).tocsr()
        self._solve_surface = _factored(self._surface)
        self._mixed = self._own.T @ weighted  # (K, V), K: amplitudes, backgrounds, PSF, effects
        known = np.zeros(self._own.shape[1])
        known[self._own.shape[1] - len(at.optics) - len(at.effects) :] = (
            prior.imaging.prior_curvature()
        )
        self._followers = self._own.T @ (self._weights[:, None] * self._own) + np.diag(known)
        self._solved_mixed = self._solve_surface(np.ascontiguousarray(self._mixed.T))
        self._rest = self._followers - self._mixed @ self._solved_mixed

    def matrix(self) -> FloatArray:
        """(V, V) the second derivatives, all that follows eliminated: nats / um^2."""
        follow = np.linalg.solve(self._followers, self._mixed)
        found: FloatArray = self._surface.toarray() - self._mixed.T @ follow
        return (found + found.T) / 2

    def solve(self, right: FloatArray) -> FloatArray:
        """(V,) the inverse of the second derivatives times a vector (Sherman-Morrison-Woodbury)."""
        first = self._solve_surface(right[:, None])[:, 0]
        return first + self._solved_mixed @ np.linalg.solve(self._rest, self._mixed @ first)

    def image_change(self, along: FloatArray) -> FloatArray:
        """(N,) what displacements (V,) along normals change the images by, and all that follows."""
        return self._jacobian @ along - self._own @ np.linalg.solve(
            self._followers, self._mixed @ along
        )

    def newton_step(self, gradient: Variables) -> Variables:
        """The step to where the objective would be least if it were a parabola; no densities.

        Parameters
        ----------
        gradient
            Of the objective, there or nearby.
        """
        along = self._free * (gradient.vertices * self.normals).sum(1)
        n, pull = len(gradient.optics), np.zeros(len(self._followers))
        imaging = np.concatenate([gradient.optics, gradient.effects])
        # Amplitudes and backgrounds are at their optimum: nothing pulls them.
        pull[len(pull) - len(imaging) :] = imaging
        step = -self.solve(along - self._mixed.T @ np.linalg.solve(self._followers, pull))
        follow = np.linalg.solve(self._followers, -pull - self._mixed @ step)
        rest = follow[len(pull) - len(imaging) :]
        moved = (self._free * step)[:, None] * self.normals
        return Variables(moved, np.zeros_like(gradient.density), rest[:n], rest[n:])

    def deviations(self, by_vertices: FloatArray) -> Deviations:
        """Of a number with this gradient by vertices (V, 3).

        With ``x = H^-1 g`` the variance is ``g' x``, or ``x' J' W R W J x`` with the squares R of
        residuals (the sandwich of P. J. Huber, "The behavior of maximum likelihood estimates under
        nonstandard conditions", 1967).
        """
        gradient = self._free * (by_vertices * self.normals).sum(1)
        moved = self.solve(gradient)
        scores = self._weights * self._residual * self.image_change(moved)
        return Deviations(
            float(np.sqrt(max(gradient @ moved, 0.0))), float(np.sqrt((scores**2).sum()))
        )


def affordable(posterior: Posterior, at: Variables, mesh: Mesh) -> bool:
    """Whether a curvature takes no more than about a minute on one core."""
    return not _too_much(_colouring(posterior, at, mesh), posterior)


def _too_much(colouring: Colouring, posterior: Posterior) -> str:
    vertices, voxels = len(colouring.colour), float(np.prod(posterior.level.grid.shape))
    if vertices > _MOST_VERTICES:
        return f"{vertices} vertices are too many for exact errors (at most {_MOST_VERTICES})"
    if colouring.count * voxels > _MOST_WORK:
        return f"exact errors would take {colouring.count} renderings of {voxels:.0f} voxels"
    return ""


def _colouring(posterior: Posterior, at: Variables, mesh: Mesh) -> Colouring:
    widths = np.asarray(posterior.prior.imaging.optics.sigma_um) * posterior.level.factor
    for view in posterior.views:
        if view.optics is not None:
            widths = np.maximum(widths, np.asarray(view.optics.sigma_um) * posterior.level.factor)
    return Colouring.of(at.vertices, mesh.edges(), widths)


def _scale(image: FloatArray, measured: FloatArray, weight: FloatArray) -> tuple[float, float]:
    given = (torch.from_numpy(a) for a in (image, measured, weight))
    amplitude, background, _ = solve_scale(*given)
    return amplitude, background


def _with_imaging(own: FloatArray, posterior: Posterior, at: Variables) -> FloatArray:
    """Columns of PSF and effects after those of amplitudes and backgrounds."""
    if len(at.optics) + len(at.effects) == 0:
        return own
    first, _ = posterior.imaging_columns(at)
    columns = np.zeros((len(own), first.shape[1]))
    columns[: len(first)] = first
    return np.concatenate([own, columns], axis=1)


def _factored(matrix: sp.csr_matrix) -> Solve:
    if matrix.shape[0] <= _DENSE:
        factor = cho_factor(matrix.toarray(), lower=True, overwrite_a=True)
        return lambda right: cho_solve(factor, right)
    solver = on_host(matrix.tocoo())
    return lambda right: solver(torch.from_numpy(right)).numpy()


def volume_gradient(mesh: Mesh, region: int) -> FloatArray:
    """(V, 3) of the volume of a region by vertices, um^2.

    Raises
    ------
    InputError
        If the mesh has no such region, or it is not closed.
    """
    if not mesh.is_closed(region):
        raise InputError(f"region {region} is not closed: it has no volume")
    a, b = mesh.regions.T
    side = (a == region).astype(float) - (b == region)
    # A third of the area vector of each face belongs to each of its corners.
    each = (side * mesh.areas() / 3)[:, None] * mesh.normals()
    sums = [np.bincount(mesh.faces.ravel(), np.repeat(c, 3), len(mesh.vertices)) for c in each.T]
    return np.stack(sums, 1)


def volume_sd(curvature: Curvature, mesh: Mesh, region: int) -> Deviations:
    """Standard deviation of the volume of a closed region, um^3."""
    return curvature.deviations(volume_gradient(mesh, region))
