"""How much of another channel lies on each wall and in each cell, seen through the PSF.

The geometry is fixed. With light of density 1 on one wall or in one cell, and none elsewhere, the
microscope would show one image: a column. The channel is a sum of columns and a background; the
densities are found by weighted linear least squares, so that light which the PSF spreads from one
wall over the next is put back. Where the channel lies beside the membranes' image, and how wide its
PSF is, are unknowns of the same solve, by Gauss-Newton steps (the columns' part of every derivative
is taken by the densities, as in variable projection: G. Golub, V. Pereyra, 1973).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np
import scipy.sparse as sp
import torch
from scipy.linalg import cho_factor, cho_solve

from ..errors import InputError
from ..evidence.voxel_variance import voxel_variance
from ..fitting.model.checks import check_image
from ..geometry.mesh import FloatArray, Mesh
from ..optics import GaussianPSF, Optics
from ..scene import Grid, Scene, Solid, Surface, render_scene
from .part_images import part_images

# Share of the PSF's width: steps of numerical derivatives, large enough for the images' accuracy.
_NUDGE = 0.1
# Shares of the mean diagonal: what nothing determines gets an enormous error, which it would lack
# otherwise.
_RIDGE_OF_POSE, _RIDGE_OF_DENSITIES = 1e-9, 1e-10


@dataclass(frozen=True)
class ChannelSettings:
    """How the amounts of a channel are found.

    walls, insides : what shines; if a channel stains only membranes, insides would only add errors.
    register : whether shift and PSF width of the channel are fitted.
    accuracy : relative, of the image of each part; a choice: below the noise of any channel.
    most_shift : um; larger shifts are not tried, since chromatic shifts are below 1.
    most_steps : Gauss-Newton steps of shift and width, at most; they end earlier once nothing
        changes, so that only a search that goes astray takes as many.
    settled : share of the PSF's width: a smaller change of shift ends the steps.
    most_parts : most walls and cells to solve for, since the matrix of errors is dense.
    """

    walls: bool = True
    insides: bool = True
    register: bool = True
    accuracy: float = 1e-2
    most_shift: float = 2.0
    most_steps: int = 8
    settled: float = 0.01
    most_parts: int = 5000

    def __post_init__(self) -> None:
        if not (self.walls or self.insides):
            raise InputError("a channel labels walls, insides, or both")


@dataclass(frozen=True, eq=False)
class ChannelAmounts:
    """The amounts of a channel and how they were found.

    walls, walls_se : (W,) densities per um^2 and their standard errors, in the order of
        ``mesh.interfaces()``; NaN if nothing of a wall is seen.
    insides, insides_se : (C,) the same per um^3, in the order of ``mesh.region_ids()``.
    background : of the channel, in its unit.
    shift : (3,) um by which the channel's image is shifted against that of the mesh.
    sigma : (3,) um; widths of its PSF.
    explained : share of the channel's variance that the sum of all columns explains.
    """

    walls: FloatArray
    walls_se: FloatArray
    insides: FloatArray
    insides_se: FloatArray
    background: float
    shift: tuple[float, float, float]
    sigma: tuple[float, float, float]
    explained: float


def channel_amounts(
    image: np.ndarray,
    grid: Grid,
    mesh: Mesh,
    optics: Optics,
    settings: ChannelSettings | None = None,
) -> ChannelAmounts:
    """Find the densities of a channel on walls and inside cells, with standard errors.

    Parameters
    ----------
    image
        (Z, Y, X) of the channel, on the voxels of the grid; NaN where missing.
    mesh
        um; fixed.
    optics
        The channel's PSF to start with; a Gaussian one is fitted, others are fixed.

    Raises
    ------
    InputError
        If the image has another shape or is constant, there are too many parts, or the channel
        shows nothing of this mesh.
    """
    settings = settings or ChannelSettings()
    pixels, known = check_image(image, grid)
    count = len(mesh.interfaces()[0]) * settings.walls + len(mesh.region_ids()) * settings.insides
    if count > settings.most_parts:
        raise InputError(f"{count} walls and cells are more than {settings.most_parts}")
    problem = _Channel(pixels.astype(np.float64), known, grid, mesh, settings, image)
    pose = _Pose(np.zeros(3), optics)
    for _ in range(settings.most_steps if settings.register else 0):
        step = problem.step(pose)
        pose = pose.moved(step)
        if np.abs(step[:3]).max() < settings.settled * min(pose.optics.sigma_um):
            break
        if np.abs(pose.shift).max() > settings.most_shift:
            raise InputError(
                f"the channel does not fit onto the mesh: it would be shifted by more than "
                f"{settings.most_shift:g} um"
            )
    return problem.amounts(pose)


@dataclass(frozen=True, eq=False)
class _Pose:
    """The shift of the channel, um, and its PSF."""

    shift: FloatArray
    optics: Optics

    @property
    def free(self) -> int:
        """How many numbers are fitted: the shift, and a Gaussian's widths, axial and in plane."""
        return 5 if isinstance(self.optics, GaussianPSF) and self.optics.diagonal else 3

    def moved(self, by: FloatArray) -> _Pose:
        """Return the pose moved by a shift (um) and changes of the logarithms of the widths."""
        if self.free == 3:
            return _Pose(self.shift + by[:3], self.optics)
        z, y, x = self.optics.sigma_um
        # Factors of at most exp(0.5): a step from far away must not go astray.
        axial, lateral = np.exp(np.clip(by[3:], -0.5, 0.5))
        return _Pose(self.shift + by[:3], GaussianPSF((z * axial, y * lateral, x * lateral)))


class _Channel:
    """The least-squares problem of one channel."""

    def __init__(
        self,
        pixels: FloatArray,
        known: np.ndarray,
        grid: Grid,
        mesh: Mesh,
        settings: ChannelSettings,
        image: np.ndarray,
    ) -> None:
        self.grid, self.mesh, self.settings = grid, mesh, settings
        self.known = known.reshape(-1)
        self.measured = pixels.reshape(-1)[self.known]
        self.variance = voxel_variance(image, pixels, known)
        # Equal weights until there is a model.
        self.weights = np.ones(len(self.measured))

    def columns(self, pose: _Pose) -> sp.csr_matrix:
        """Return (N, K + 1) columns on the known voxels; the last one is the background."""
        found = part_images(
            self.mesh.translated(pose.shift),
            self.grid,
            pose.optics,
            self.settings.walls,
            self.settings.insides,
            self.settings.accuracy,
        )
        seen = found.tocsr()[self.known]
        return sp.hstack([seen, sp.csr_matrix(np.ones((seen.shape[0], 1)))]).tocsr()

    def step(self, pose: _Pose) -> FloatArray:
        """Return the Gauss-Newton step of shift and widths; densities adapt to each change."""
        columns = self.columns(pose)
        if not columns[:, :-1].nnz:
            raise InputError("nothing of the mesh lies in the image of the channel")
        densities, _ = self.solved(columns)
        model = columns @ densities
        self._weigh(model)
        derivatives = self._derivatives(pose, densities)
        root = np.sqrt(self.weights)
        # The part of each derivative that densities can explain is left to them.
        left = np.column_stack([derivatives, self.measured])
        left -= columns @ self.solved(columns, left)[0]
        left *= root[:, None]
        matrix = left[:, :-1].T @ left[:, :-1]
        ridge = _RIDGE_OF_POSE * np.trace(matrix) / len(matrix)
        if not ridge > 0:
            raise InputError("the channel shows nothing of this mesh")
        ridged = matrix + ridge * np.eye(len(matrix))
        found: FloatArray = np.linalg.solve(ridged, left[:, :-1].T @ left[:, -1])
        return found

    def amounts(self, pose: _Pose) -> ChannelAmounts:
        """Return densities and their errors at a pose."""
        columns = self.columns(pose)
        densities, _ = self.solved(columns)
        self._weigh(columns @ densities)
        densities, variances = self.solved(columns)
        left = self.measured - columns @ densities
        # Residuals beyond the noise add to the errors.
        chi = float((self.weights * left**2).mean())
        errors = np.sqrt(max(1.0, chi) * variances)
        densities = np.where(np.isfinite(variances), densities, nan)
        n_walls = len(self.mesh.interfaces()[0]) if self.settings.walls else 0
        variance = float(((self.measured - self.measured.mean()) ** 2).mean())
        z, y, x = (float(s) for s in pose.shift)
        return ChannelAmounts(
            walls=densities[:n_walls],
            walls_se=errors[:n_walls],
            insides=densities[n_walls:-1],
            insides_se=errors[n_walls:-1],
            background=float(densities[-1]),
            shift=(z, y, x),
            sigma=pose.optics.sigma_um,
            explained=1 - float((left**2).mean()) / variance if variance > 0 else nan,
        )

    def solved(
        self, columns: sp.csr_matrix, values: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return densities (K + 1, ...) for values (N, ...) and variances; 0 and NaN if unseen."""
        values = self.measured if values is None else values
        table = values.reshape(len(values), -1)
        weighted = columns.multiply(self.weights[:, None]).tocsr()
        matrix = np.asarray((columns.T @ weighted).todense())
        scale = np.sqrt(matrix.diagonal())
        seen = scale > 0
        scaled = matrix[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen])
        factor = cho_factor(scaled + _RIDGE_OF_DENSITIES * np.eye(int(seen.sum())))
        right = np.asarray(weighted.T @ table)[seen] / scale[seen, None]
        found, variance = np.zeros((len(scale), table.shape[1])), np.full(len(scale), nan)
        found[seen] = cho_solve(factor, right) / scale[seen, None]
        inverse = cho_solve(factor, np.eye(int(seen.sum())))
        variance[seen] = inverse.diagonal() / scale[seen] ** 2
        return found.reshape(-1, *values.shape[1:]), variance

    def _weigh(self, model: FloatArray) -> None:
        """Set weights to one over the variance of voxels as bright as the model."""
        whole = np.zeros(self.known.shape)
        whole[self.known] = model
        variance = np.asarray(self.variance(whole.reshape(self.grid.shape))).reshape(-1)
        self.weights = 1 / np.maximum(variance[self.known], 1e-12 * float(variance.max()))

    def _derivatives(self, pose: _Pose, densities: FloatArray) -> FloatArray:
        """Return (N, 3 or 5) derivatives of the model by shift (um) and logarithms of widths."""
        sizes = [*(_NUDGE * s for s in pose.optics.sigma_um), _NUDGE, _NUDGE][: pose.free]
        found = []
        for k, size in enumerate(sizes):
            step = np.zeros(pose.free)
            step[k] = size
            ends = [self._model(pose.moved(side * step), densities) for side in (1, -1)]
            found.append((ends[0] - ends[1]) / (2 * size))
        return np.column_stack(found)

    def _model(self, pose: _Pose, densities: FloatArray) -> FloatArray:
        """Return (N,) the sum of all columns, rendered at once; without the background."""
        mesh = self.mesh.translated(pose.shift)
        pairs, wall = mesh.interfaces()
        structures: list[Surface | Solid] = []
        if self.settings.walls:
            structures.append(Surface(mesh, densities[: len(pairs)][wall] / mesh.membranes()))
        if self.settings.insides:
            regions = mesh.region_ids().tolist()
            inside = densities[len(densities) - 1 - len(regions) : -1].tolist()
            closed = {r: d for r, d in zip(regions, inside, strict=True) if mesh.is_closed(r)}
            structures.append(Solid(mesh, closed))
        scene = Scene(tuple(structures), pose.optics)
        with torch.no_grad():
            image = render_scene(scene, self.grid, self.settings.accuracy).double().numpy()
        found: FloatArray = image.reshape(-1)[self.known]
        return found
