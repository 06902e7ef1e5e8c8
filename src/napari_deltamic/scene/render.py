"""From a mesh and a PSF to an image."""

from __future__ import annotations

from math import log, sqrt

import numpy as np
import torch
from scipy.fft import next_fast_len
from torch import Tensor

from ..errors import InputError
from ..fourier import Plan, make_plan
from ..fourier.plan import Method, check_accuracy
from ..geometry.mesh import Mesh, is_tensor
from ..optics import Optics
from .grid import Grid


class Renderer:
    """Renders meshes near a given one on a grid: the plan is made once and used many times.

    Parameters
    ----------
    mesh, grid, optics
        What the plan is made for.
    accuracy
        Relative L2 error of the image; 0 for the closed form at every wavevector of the grid.
    blur
        um along Z, Y, X: a further Gaussian on top of the optics (coarse levels of a fit).
    pixel_integration
        Whether a voxel integrates over its size rather than samples at its centre.
    margin
        um: how far vertices may move before the plan no longer holds; 0 for a mesh that stays.
        Edges may then grow by a tenth, which a fit sees to by planning anew now and then.
    method
        Forces ``"closed form"`` or ``"non-uniform"``.

    Notes
    -----
    The FFT is periodic. The grid is padded just so far that neither the image of the mesh nor that
    of its periodic copies reaches in at the other side.
    """

    def __init__(
        self,
        mesh: Mesh,
        grid: Grid,
        optics: Optics,
        accuracy: float = 1e-3,
        *,
        blur: tuple[float, float, float] = (0.0, 0.0, 0.0),
        pixel_integration: bool = False,
        margin: float = 0.0,
        method: Method | None = None,
    ) -> None:
        check_accuracy(accuracy)
        self.grid = grid
        self.pixel_integration = pixel_integration
        self.blur = blur
        self.margin = margin
        self._faces = torch.as_tensor(mesh.faces)
        self._membranes = torch.as_tensor(mesh.membranes(), dtype=torch.float64)
        self._origin = torch.tensor(grid.origin, dtype=torch.float64)
        self._start = mesh.vertices_numpy()
        width = np.hypot(optics.width(), blur)
        reach = _reach(accuracy) * np.hypot(optics.sigma_um, blur) + margin
        fft_shape = _padded_shape(self._start, grid, reach)
        self.plan: Plan = make_plan(
            self._start - np.asarray(grid.origin),
            mesh.faces,
            fft_shape,
            grid.voxel_size,
            tuple(float(w) for w in width),  # type: ignore[arg-type]
            accuracy,
            method,
            margin=_STRETCH if margin > 0 else 1.0,
            aligned=optics.diagonal,
        )
        self._axes = self.plan.band.axes(torch.float32 if self.plan.single else torch.float64)

    def holds_for(self, vertices: np.ndarray) -> bool:
        """Whether the plan still holds for these vertices (V, 3)."""
        return bool(np.abs(vertices - self._start).max() <= self.margin)

    def transform(self, vertices: Tensor, density: Tensor | None = None) -> Tensor:
        """u_hat on the box of the band; densities (F,) multiply the membranes of each face."""
        weight = self._membranes
        if density is not None:
            if density.shape != weight.shape:
                raise InputError(
                    f"density must have shape ({len(weight)},), one number per face, "
                    f"not {tuple(density.shape)}"
                )
            weight = weight * density
        return self.plan.transform(vertices - self._origin.to(vertices.dtype), self._faces, weight)

    def otf(self, optics: Optics) -> Tensor:
        """The optics, the extra blur and the voxels' own size, on the box of the band."""
        otf = optics.otf(self._axes)
        for axis, k in enumerate(self._axes):
            if self.blur[axis] > 0:
                otf = otf * torch.exp(-0.5 * (self.blur[axis] * k) ** 2)
            if self.pixel_integration:
                otf = otf * torch.sinc(k * (self.grid.voxel_size[axis] / (2 * torch.pi)))
        return otf

    def image(self, transform: Tensor, otf: Tensor) -> Tensor:
        """Image (Z, Y, X): fluorophores seen in each voxel; its sum over all space is the total."""
        return self.plan.band.to_image(transform * otf, self.grid.shape)


def render(
    mesh: Mesh,
    grid: Grid,
    optics: Optics,
    accuracy: float = 1e-3,
    *,
    density: Tensor | np.ndarray | None = None,
    pixel_integration: bool = False,
    method: Method | None = None,
) -> Tensor:
    """The image of a mesh under a PSF.

    Parameters
    ----------
    mesh
        Vertices in um; the result is differentiable in them where they are a tensor that requires
        grad. A wall between two cells is two membranes and counts twice.
    grid
        Where the voxels lie.
    optics
        The PSF; the result is differentiable in its tensors.
    accuracy
        Relative L2 error of the image; 0 computes the closed form at every wavevector of the grid.
    density
        (F,) fluorophores per um^2 of membrane; 1 where not given.
    pixel_integration
        Whether a voxel integrates over its size rather than samples at its centre.
    method
        Forces ``"closed form"`` or ``"non-uniform"``; by default the cheaper one.

    Returns
    -------
    (Z, Y, X) tensor, fluorophores seen in each voxel: float32, or float64 where the accuracy asks
    for more than single precision can hold (below 3e-5).

    Raises
    ------
    InputError
        If the accuracy is not in [0, 1), the density not one number per face, or the mesh so far
        from the grid that its units must be wrong.
    """
    vertices = mesh.vertices if is_tensor(mesh.vertices) else torch.tensor(mesh.vertices_numpy())
    renderer = Renderer(
        mesh, grid, optics, accuracy, pixel_integration=pixel_integration, method=method
    )
    weight = None if density is None else torch.as_tensor(density)
    return renderer.image(renderer.transform(vertices, weight), renderer.otf(optics))


_STRETCH = 1.1  # of edges, within the life of a plan for a mesh that moves
_LARGEST_PERIOD = 8  # times the grid: a mesh further away is in other units


def _um(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{p:.4g}" for p in point) + ")"


def _reach(accuracy: float) -> float:
    """How many sigma an image reaches beyond a surface before it falls below the accuracy."""
    return sqrt(2 * log(1 / max(accuracy * 0.1, 1e-12)))


def _padded_shape(vertices: np.ndarray, grid: Grid, reach: np.ndarray) -> tuple[int, int, int]:
    first, last = grid.extent
    low, high = vertices.min(0) - reach, vertices.max(0) + reach
    # A copy of the mesh one period away must stay clear of the grid, on either side.
    period = np.maximum.reduce(
        [last - low, high - first, last - first + np.asarray(grid.voxel_size)]
    )
    n = np.ceil(period / np.asarray(grid.voxel_size) - 1e-9)
    if (n > _LARGEST_PERIOD * (np.asarray(grid.shape) + reach / np.asarray(grid.voxel_size))).any():
        raise InputError(
            f"the mesh reaches from {_um(vertices.min(0))} to {_um(vertices.max(0))} um, "
            f"the image from {_um(first)} to {_um(last)} um: are the units the same?"
        )
    z, y, x = (int(next_fast_len(int(k), real=True)) for k in n)
    return z, y, x
