"""The curvature of a log posterior: Gauss-Newton steps, and the errors of measures.

``H = J' W J + kappa B''`` with J the derivatives of the measured images by displacements of
vertices along their normals (across junctions, in two directions), W one over the variance of each
voxel, and B'' the curvature of the bending energy. Amplitudes, backgrounds, PSF and effects follow
the surface: they are eliminated by their normal equations. Densities are held, and so is all that
moves vertices along the surface.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
import torch
from scipy.linalg import cho_factor, cho_solve

from ...errors import InputError
from ...geometry.mesh import FloatArray, Mesh
from ...scene.light import INSIDES, Light
from ..model.likelihood import solve_scale
from ..model.unequal_insides import each_alone
from ..model.variables import Variables
from ..objective.posterior import Posterior
from ..objective.prediction import as_floats
from ..solvers.factors import on_host
from .directions import Directions
from .normal_jacobian import Colouring, normal_jacobian, widest_psf

# What is affordable: 200 colours of 29 x 150 x 150 voxels with 4,000 vertices took 4 s beside a fit
# of 23 s (two threads), 250 of 33 x 256 x 384 with 12,000 vertices 26 s and 4.7 GB beside one of
# 33 s. Refits, which are there beyond, took 5 s for the latter.
_MOST_WORK = 3e8  # colours times voxels of the grid; chosen so that errors take less than a fit
_MOST_VERTICES = 8_000  # chosen so that errors take less time than a fit
_DENSE = 4_000  # vertices: up to here LAPACK is faster than a sparse factor (a row has hundreds)
_RANK = 1e-9  # of further columns: less is rounding, that is the same column again
_RIDGE = 1e-9  # of the mean diagonal: so that vertices that nothing sees or holds stay

Solve = Callable[[FloatArray], FloatArray]


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
        If there are so many vertices or voxels that it would take more than about a minute.
    """

    def __init__(
        self, posterior: Posterior, at: Variables, mesh: Mesh, held: np.ndarray | None = None
    ) -> None:
        if len(at.vertices) > _MOST_VERTICES:
            text = f"{len(at.vertices)} vertices are too many for exact errors"
            raise InputError(f"{text} (at most {_MOST_VERTICES})")
        self.directions = Directions.of(mesh, at.vertices)
        given = at.vertices, mesh.edges(), widest_psf(posterior), self.directions.vertex
        colouring, voxels = Colouring.of(*given), float(np.prod(posterior.level.grid.shape))
        if colouring.count * voxels > _MOST_WORK:
            text = f"exact errors would take {colouring.count} renderings"
            raise InputError(f"{text} of {voxels:.0f} voxels")
        free = np.ones(len(at.vertices)) if held is None else 1.0 - np.asarray(held, float)
        self._free = free[self.directions.vertex]
        light = posterior.light(at)
        images, measured = posterior.images(at, light), posterior.measured(at)
        jacobians = normal_jacobian(posterior, at, self.directions, colouring)
        weights, residuals, columns, scaled = [], [], [], []
        for number, view in enumerate(posterior.views):
            image, own = images[number], np.zeros((len(images[number]), 2 * len(images)))
            weight = as_floats(view.voxels.weights)
            amplitude, background = _scale(image, measured[number], weight)
            own[:, 2 * number], own[:, 2 * number + 1] = image, 1.0
            columns.append(own)
            weights.append(weight / view.variance)
            residuals.append(measured[number] - amplitude * image - background)
            scaled.append(jacobians[number].multiply(amplitude))
        self._weights, self._residual = np.concatenate(weights), np.concatenate(residuals)
        self._jacobian: sp.csr_matrix = sp.vstack(scaled).tocsr() @ sp.diags(self._free)
        amplitudes = np.concatenate(columns)
        insides = [np.concatenate(posterior.images(at, one)) for one in following_insides(light)]
        amplitudes = np.column_stack([amplitudes, *insides])
        self._own = _with_imaging(amplitudes, posterior, at)
        self._factor(posterior, at)

    def _factor(self, posterior: Posterior, at: Variables) -> None:
        prior, held = posterior.prior, sp.diags(self._free)
        weighted = sp.diags(self._weights) @ self._jacobian
        # With one direction for all, the matrix of each coordinate.
        given = at.vertices, np.broadcast_to([1.0, 0.0, 0.0], at.vertices.shape)
        bend = prior.bending.curvature(*given) + prior.junctions.curvature(*given)
        bend = prior.stiffness * self.directions.restricted(bend)
        matrix = (self._jacobian.T @ weighted + held @ bend @ held).tocsr()
        ridge = _RIDGE * float(matrix.diagonal().mean())
        # Rows of vertices that stay, or that have no normal, are those of a diagonal.
        empty = matrix.diagonal() <= 0
        self._surface = (matrix + sp.diags(np.where(empty, 1.0, ridge))).tocsr()
        self._solve_surface = _factored(self._surface)
        self._mixed = self._own.T @ weighted  # (K, D), K: amplitudes, backgrounds, PSF, effects
        self._followers = self._own.T @ (self._weights[:, None] * self._own)
        first = self._own.shape[1] - len(at.optics) - len(at.effects)
        self._followers[first:, first:] += prior.imaging.prior_curvature()
        self._solved_mixed = self._solve_surface(np.ascontiguousarray(self._mixed.T))
        self._rest = self._followers - self._mixed @ self._solved_mixed

    def matrix(self) -> FloatArray:
        """(D, D) the second derivatives, all that follows eliminated: nats / um^2."""
        follow = np.linalg.solve(self._followers, self._mixed)
        found: FloatArray = self._surface.toarray() - self._mixed.T @ follow
        return (found + found.T) / 2

    def solve(self, right: FloatArray) -> FloatArray:
        """(D,) the inverse of the second derivatives times a vector, or (D, K) times several.

        By the formula of Sherman, Morrison and Woodbury.
        """
        first = self._solve_surface(np.ascontiguousarray(right.reshape(len(right), -1)))
        first = first + self._solved_mixed @ np.linalg.solve(self._rest, self._mixed @ first)
        return first.reshape(right.shape)

    def follows(self, image: FloatArray) -> FloatArray:
        """(D,) or (D, K): what the surface follows changes (N,) or (N, K) of the images by."""
        weighted = (self._weights * image.T).T
        own = np.linalg.solve(self._followers, self._own.T @ weighted)
        return self._free_times(self.solve(self._jacobian.T @ weighted - self._mixed.T @ own))

    def response(self, pull: FloatArray) -> FloatArray:
        """(V, 3) where the surface gives way to, with all that follows, pulled by (V, 3) nats / um.

        The inverse of the second derivatives times the pull.
        """
        along = self._free * self.directions.along(pull)
        return self.directions.displaced(self._free * self.solve(along))

    @property
    def residual(self) -> FloatArray:
        """(N,) measured minus rendered, of all voxels that count."""
        return self._residual

    def amplitudes(self, columns: FloatArray) -> FloatArray:
        """(m,) how much of further columns (N, m) of the image explains most of the residual.

        Surface, amplitudes, backgrounds, PSF and effects follow.
        """
        return self._alternative(columns)[0]

    def alternative(self, columns: FloatArray) -> tuple[float, FloatArray]:
        """What further columns (N, m) gain, nats, and (D,) what the surface then moves by."""
        amplitudes, gain, followed = self._alternative(columns)
        return gain, -followed @ amplitudes

    def instead(self, change: FloatArray) -> tuple[float, FloatArray]:
        """What another rendering, by a change (N,), gains, nats; and (D,) what it is followed by.

        The whole of the change, not as much of it as explains most.
        """
        followed, rest = self._followed(change[:, None])
        weighted = self._weights * rest[:, 0]
        return float(weighted @ self._residual - weighted @ change / 2), -followed[:, 0]

    def _followed(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(D, m) what the surface follows columns by, and (N, m) what of them is left then."""
        followed = self.follows(columns)
        rest = columns - self._jacobian @ followed
        weighted = self._weights[:, None] * rest
        return followed, rest - self._own @ np.linalg.solve(self._followers, self._own.T @ weighted)

    def _alternative(self, columns: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        followed, rest = self._followed(columns)
        right = rest.T @ (self._weights * self._residual)
        inner = rest.T @ (self._weights[:, None] * columns)
        found = np.linalg.pinv((inner + inner.T) / 2, rcond=_RANK, hermitian=True) @ right
        return found, float(right @ found) / 2, followed

    def _free_times(self, along: FloatArray) -> FloatArray:
        found: FloatArray = (self._free * along.T).T
        return found

    def newton_step(self, gradient: Variables) -> Variables:
        """The step to where the objective would be least if it were a parabola; no densities.

        Parameters
        ----------
        gradient
            Of the objective, there or nearby.
        """
        along = self._free * self.directions.along(gradient.vertices)
        n, pull = len(gradient.optics), np.zeros(len(self._followers))
        imaging = np.concatenate([gradient.optics, gradient.effects])
        # Amplitudes and backgrounds are at their optimum: nothing pulls them.
        pull[len(pull) - len(imaging) :] = imaging
        step = -self.solve(along - self._mixed.T @ np.linalg.solve(self._followers, pull))
        follow = np.linalg.solve(self._followers, -pull - self._mixed @ step)
        rest = follow[len(pull) - len(imaging) :]
        moved = self.directions.displaced(self._free * step)
        return Variables(
            moved,
            np.zeros_like(gradient.density),
            np.zeros_like(gradient.insides),
            rest[:n],
            rest[n:],
        )


def following_insides(light: Light) -> list[Light]:
    """Insides whose brightness follows the surface; where they shine alone, one is the scale."""
    if not light.interior:
        return []
    each = each_alone(np.array([k for k, _ in light.cells], np.int64)) or [INSIDES]
    return each if light.membrane else each[1:]


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
