"""From a mesh and a PSF to an image."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..fourier import Plan, make_plan
from ..fourier.devices import for_objects
from ..fourier.plan import Method, check_accuracy
from ..geometry.mesh import Mesh, is_tensor
from ..optics import GaussianPSF, Optics
from .effects import Effects, OffsetEffect, as_effects
from .effects.object_side import Surfaces, acts_on_object, object_transform
from .formation import Formation
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
    effects
        Optional parts of image formation, or their names; absent ones are not computed.
    frame
        Grid of the whole image, to which effects refer, where ``grid`` leaves voxels out.
    margin
        um: how far vertices may move before the plan no longer holds; 0 for a mesh that stays.
        Edges may then grow by a tenth, which a fit sees to by planning anew now and then.
    method
        Forces ``"closed form"`` or ``"particle-mesh"``.
    device
        Where images are; see :func:`napari_deltamic.fourier.devices.choose_device`.

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
        effects: Effects | Sequence[str] = (),
        frame: Grid | None = None,
        margin: float = 0.0,
        method: Method | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        check_accuracy(accuracy)
        self.device = torch.device(device)
        # Effects on the object are computed on the CPU.
        self._object_device = for_objects(self.device)
        self._last_otf: tuple[Optics | None, Tensor | None] = None, None
        self.grid = grid
        self.frame = frame or grid
        self.blur = blur
        self.margin = margin
        self._surfaces = Surfaces.of(mesh)
        there = self._object_device
        self._faces = self._surfaces.faces.to(there)
        self._membranes = torch.as_tensor(mesh.membranes(), dtype=torch.float64, device=there)
        self._origin = torch.tensor(grid.origin, dtype=torch.float64, device=there)
        self._start = mesh.vertices_numpy()
        self._start_there = torch.tensor(self._start, device=there)
        width = np.hypot(optics.width(), blur)
        self._take(as_effects(effects))
        fft_shape = self._formation.fft_shape(self._start, optics, accuracy, margin)
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
            cutoff=optics.cutoff(blur),
            device=there.type,
            transfer=lambda axes: self._formation.otf(optics, axes),
        )
        self._axes = self.plan.band.axes(torch.float32 if self.plan.single else torch.float64)

    def _take(self, effects: Effects) -> None:
        self.effects = effects
        self._on_object = acts_on_object(effects)
        self._formation = Formation(self.grid, self.frame, self.blur, effects)

    def with_effects(self, effects: Effects) -> Renderer:
        """The same plan with other numbers of the same effects."""
        renderer = copy(self)
        renderer._take(effects)
        renderer._last_otf = None, None
        return renderer

    def holds_for(self, vertices: np.ndarray) -> bool:
        """Whether the plan still holds for these vertices (V, 3)."""
        return bool(np.abs(vertices - self._start).max() <= self.margin)

    def pads_enough_for(self, effects: Effects, optics: Optics) -> bool:
        """Whether the plan is wide enough for other effects, which may reach further."""
        formation = Formation(self.grid, self.frame, self.blur, effects)
        needed = formation.fft_shape(self._start, optics, self.plan.accuracy, self.margin)
        return all(n <= m for n, m in zip(needed, self.plan.band.fft_shape, strict=True))

    def moved(self, vertices: Tensor) -> Tensor:
        """um, 0-dim: how far a vertex is from where the plan was made, along an axis at most."""
        if self._start_there.device != vertices.device:
            self._start_there = self._start_there.to(vertices.device)
        return (vertices.detach() - self._start_there).abs().amax()

    def transform(self, vertices: Tensor, density: Tensor | None = None) -> Tensor:
        """u_hat on the box of the band; densities (F,) multiply the membranes of each face.

        Two such boxes where the PSF changes with depth.
        """
        weight = self._membranes
        if density is not None:
            if density.shape != weight.shape:
                raise InputError(
                    f"density must have shape ({len(weight)},), one number per face, "
                    f"not {tuple(density.shape)}"
                )
            weight = weight * density.to(weight.device)
        if self._on_object:
            given = vertices.cpu(), self._surfaces, weight.cpu(), self.effects
            return self._held(object_transform(self.plan, *given, self.grid, self.frame))
        placed = vertices.to(self._object_device)
        placed = placed - self._origin.to(placed.dtype)
        return self._held(self.plan.transform(placed, self._faces, weight))

    def _held(self, box: Tensor) -> Tensor:
        """On the device of the image, in a type that it holds."""
        if self.device.type == "mps":
            box = box.to(torch.complex64 if box.is_complex() else torch.float32)
        return box.to(self.device)

    def otf(self, optics: Optics) -> Tensor:
        """The optics, the extra blur and what effects make of them, on the box of the band."""
        if self.device.type == "cpu":
            return self._formation.otf(optics, self._axes)
        last, otf = self._last_otf
        if otf is None or last is not optics:
            otf = self._held(self._formation.otf(optics, self._axes_for(optics)))
            # Kept as long as the optics stay the same.
            self._last_otf = (None, None) if otf.requires_grad else (optics, otf)
        return otf

    def _axes_for(self, optics: Optics) -> tuple[Tensor, Tensor, Tensor]:
        """On the device where a formula is all that is computed; else on the CPU."""
        z, y, x = self._axes
        if not isinstance(optics, GaussianPSF) or self.effects.present():
            return z, y, x
        return self._held(z), self._held(y), self._held(x)

    def image(self, transform: Tensor, otf: Tensor) -> Tensor:
        """Image (Z, Y, X): fluorophores seen in each voxel; its sum over all space is the total."""
        return self._formation.image(transform, otf, self.plan.band)

    def offset(self) -> Tensor | None:
        """What effects add to the measured image, in its unit; None where nothing is added."""
        return offset(self.effects, self.grid, self.frame)


def offset(effects: Effects, grid: Grid, frame: Grid | None = None) -> Tensor | None:
    """(Z, Y, X) what effects add to the measured image of a grid; None where nothing is added."""
    found = None
    for effect in effects.present():
        if isinstance(effect, OffsetEffect):
            added = effect.offset(grid, frame or grid).expand(grid.shape)
            found = added if found is None else found + added
    return found


def render(
    mesh: Mesh,
    grid: Grid,
    optics: Optics,
    accuracy: float = 1e-3,
    *,
    density: Tensor | np.ndarray | None = None,
    effects: Effects | Sequence[str] = (),
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
    effects
        Optional parts of image formation, or their names. A background is in the unit of the
        measured image and so added by :func:`expected_image` alone.
    method
        Forces ``"closed form"`` or ``"particle-mesh"``; by default the cheaper one.

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
    device = vertices.device
    renderer = Renderer(mesh, grid, optics, accuracy, effects=effects, method=method, device=device)
    # A copy of an array: torch warns of those that are read-only.
    weight = torch.tensor(density) if isinstance(density, np.ndarray) else density
    return renderer.image(renderer.transform(vertices, weight), renderer.otf(optics))


def expected_image(
    mesh: Mesh,
    grid: Grid,
    optics: Optics,
    accuracy: float,
    amplitude: float,
    background: float,
    *,
    density: Tensor | np.ndarray | None = None,
    effects: Effects | Sequence[str] = (),
) -> np.ndarray:
    """(Z, Y, X) float32: what the microscope would measure, but for noise.

    ``amplitude * rendered image + background``, and what effects add; see :func:`render`.
    """
    chosen = as_effects(effects)
    with torch.no_grad():
        image = render(mesh, grid, optics, accuracy, density=density, effects=chosen)
        image = amplitude * image + background
        added = offset(chosen, grid)
        return (image if added is None else image + added).to(torch.float32).numpy()


_STRETCH = 1.1  # of edges, within the life of a plan for a mesh that moves
