"""Density of fluorophores over the surface: uniform, one number per interface, or smooth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from ..fourier.triangle import cross
from ..geometry.mesh import Mesh
from ..settings import DensityModel
from .optimiser import AdamUniform
from .preconditioner import Preconditioner
from .surface import on_host

_STEP = 0.15  # of the log density, first iteration of a level
_FIRM = 1.5  # power of the density: between the two that the weights of voxels make
_LOOSE = 0.05  # of the mean: what the image holds less firmly than this is moved as if it held so
_LARGEST_ESTIMATE = 1.5  # |log density| that the image at the start may say
_LIMIT = 2.0  # |log density|: a wall dimmer than e^-2 of the mean is no evidence of a wall


class DensityField:
    """Log density and its optimiser; amplitudes are solved for, so its mean stays zero.

    A smooth field is one number per vertex, with the gradient preconditioned as the vertices' is,
    so that it follows slow changes of brightness and cannot stand in for shape.
    """

    def __init__(self, mesh: Mesh, pieces: np.ndarray, model: DensityModel) -> None:
        self.model = model
        self._faces = torch.from_numpy(np.asarray(mesh.faces))
        self._membranes = torch.from_numpy(mesh.membranes().astype(np.float64))
        self._area = torch.from_numpy(mesh.areas()) * self._membranes + 1e-300
        self._interface = torch.from_numpy(mesh.interfaces()[1].astype(np.int64))
        count = {
            "uniform": 0,
            "interface": int(self._interface.max()) + 1,
            "smooth": len(mesh.vertices),
        }[model]
        self._log = torch.zeros(count, dtype=torch.float64)
        self._flat = True  # as it began
        groups = pieces if model == "smooth" else np.arange(count)
        # One number for each interface: the size of its steps follows it closely, or it would
        # crawl towards the end, its first gradients in mind.
        betas = (0.9, 0.9) if model == "interface" else (0.9, 0.99)
        self._adam = AdamUniform(groups, 1, betas)
        self._leaf: Tensor | None = None

    def _per_face(self, log: Tensor) -> Tensor:
        return _density(log, self._rows)

    @property
    def _rows(self) -> Tensor:
        """Those of the log density that each face has: (F, 3) corners, or (F,) interfaces."""
        return self._faces if self.model == "smooth" else self._interface

    @property
    def log(self) -> np.ndarray:
        """Log density of each vertex or interface; empty where it is uniform."""
        return on_host(self._log)

    @log.setter
    def log(self, values: np.ndarray) -> None:
        self._log = torch.tensor(values, dtype=torch.float64, device=self._log.device)
        self._flat = not values.any()

    @property
    def per_vertex(self) -> np.ndarray | None:
        """(V,) log density where it is smooth, else None."""
        return self.log if self.model == "smooth" else None

    def faces(self, active: bool, device: torch.device | str = "cpu") -> Tensor | None:
        """(F,) density to render with, tracking gradients; None where it is uniform.

        A smooth one waits until it is active. Numbers of interfaces are too few to stand in for
        shape; held back, the shape would stand in for them: a wall crumples where it is brighter
        than the rest.
        """
        self._leaf = None
        active = active or self.model == "interface"
        if self.model == "uniform" or not (active or not self._flat):
            return None
        self._log, self._faces, self._interface, self._area, self._membranes = (
            t.to(device)
            for t in (self._log, self._faces, self._interface, self._area, self._membranes)
        )
        self._leaf = self._log.detach().requires_grad_(active)
        return self._per_face(self._leaf)

    def faces_numpy(self) -> np.ndarray:
        """(F,) density relative to the mean."""
        return self.later()()

    def later(self) -> Callable[[], np.ndarray]:
        """As :meth:`faces_numpy` is now, computed when it is asked for."""
        if self.model == "uniform":
            return lambda: np.ones(len(self._faces))
        log, rows = self._log, self._rows  # both of where they are now
        return lambda: _density(log, rows).cpu().numpy()

    @property
    def unknown(self) -> bool:
        """Whether a smooth density is about to be fitted that nothing is known of."""
        return self.model == "smooth" and self._flat and self._leaf is not None

    def estimate(self, ratio: np.ndarray, smoother: Preconditioner) -> None:
        """Begin with the brightness of the image where the surface lies.

        Steps from one density take dozens of iterations to tell bright surfaces from dim ones, and
        meanwhile the shape, or light from inside, stands in for the difference.

        Parameters
        ----------
        ratio
            (V,) measured over rendered brightness at the vertices.
        smoother
            As for :meth:`step`.
        """
        log = np.log(np.clip(ratio, np.exp(-_LARGEST_ESTIMATE), np.exp(_LARGEST_ESTIMATE)))
        smooth = smoother.solve(torch.as_tensor(log, device=self._log.device)[:, None])[:, 0]
        mean = torch.dot(self._per_face(smooth), self._area) / self._area.sum()
        self._log = torch.clamp(smooth - torch.log(mean), -_LIMIT, _LIMIT)
        self._flat = False

    def evened(self, gradient: Tensor, vertices: Tensor, sigma: Sequence[float]) -> Tensor:
        """A gradient of the vertices over how firmly the image holds each of them.

        A sheet of density d seen through a PSF of width s along its normal gives the loss a
        curvature along that normal in proportion to d^2 / s^3 where all voxels weigh alike, to d
        where they weigh by one over their brightness. Steps of one size for all leave dim walls and
        those across the axis where they are, and their density falls instead.

        Parameters
        ----------
        gradient, vertices
            (V, 3), of the iteration that :meth:`faces` was asked for; where the density is uniform,
            the gradient comes back as it is.
        sigma
            um, Z, Y, X: widths of the PSF.
        """
        if self._leaf is None:
            return gradient
        with torch.no_grad():
            a, b, c = vertices[self._faces].unbind(1)
            normal = cross(b - a, c - a)
            area = torch.linalg.vector_norm(normal, dim=1).clamp(min=1e-300)
            # Numbers, not a tensor: that would be copied to the device in every iteration.
            along = [n / area * s for n, s in zip(normal.unbind(1), sigma, strict=True)]
            width, least = torch.linalg.vector_norm(torch.stack(along, 1), dim=1), min(sigma)
            weight = self._membranes * self._per_face(self._leaf)
            firm = weight**_FIRM * (least / width.clamp(min=least)) ** 3
            corners, n = self._faces.reshape(-1), len(vertices)
            sums = torch.zeros(n, 2, dtype=normal.dtype, device=normal.device)
            of_faces = torch.stack([area * firm, area], 1).repeat_interleave(3, 0)
            sums.index_add_(0, corners, of_faces)
            mean = sums[:, 0].sum() / sums[:, 1].sum()
            firm = (sums[:, 0] / sums[:, 1].clamp(min=1e-300) / mean).clamp(_LOOSE, 1 / _LOOSE)
        return gradient / firm[:, None]

    def step(self, smoother: Preconditioner, factor: float) -> None:
        """One step along the gradient that the last backward pass left."""
        if self._leaf is None or self._leaf.grad is None:
            return
        gradient = self._leaf.grad[:, None]
        if self.model == "smooth":
            step = smoother.solve(self._adam.step(smoother.solve(gradient)))
        else:
            step = self._adam.step(gradient)
        log = self._log - _STEP * factor * step[:, 0]
        mean = torch.dot(self._per_face(log), self._area) / self._area.sum()
        self._log = torch.clamp(log - torch.log(mean), -_LIMIT, _LIMIT)
        self._flat = False

    def restart(self) -> None:
        """Forget the optimiser's past."""
        self._adam.restart()

    def state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        return {"log": self.log, **self._adam.state()}

    def load(self, state: dict[str, np.ndarray]) -> None:
        """Take over what a checkpoint kept."""
        self.log = state["log"]
        self._adam.load(state)


def _density(log: Tensor, rows: Tensor) -> Tensor:
    """(F,) from the logarithm at each face's interface (F,), or the mean of its corners (F, 3)."""
    found = log[rows]
    return torch.exp(found.mean(1) if rows.ndim == 2 else found)
