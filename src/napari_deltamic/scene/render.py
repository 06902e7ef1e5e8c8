"""Renders a scene to an image."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ..common.accuracy_bounds import check_accuracy
from ..fourier import Band, Plan
from ..fourier.devices import for_objects
from ..fourier.plan import Method
from ..geometry.arrays import is_tensor
from ..geometry.mesh import Mesh
from ..optics import GaussianPSF, Optics
from .effects import Effects, OffsetEffect, as_effects
from .formation import Formation
from .grid import Grid
from .light import MEMBRANES, Light
from .scene import Scene
from .structures import Planned, Site, Solid, Surface

_STRETCH = 1.1  # of edges, while one plan serves a mesh that moves


class Renderer:
    """Renders scenes near a given one on a grid: the plan is made once and used many times.

    Each structure has its own plan, and all share one image. Every structure's image is as accurate
    as asked, relative to itself; so is their sum, unless they have opposite signs.

    Parameters
    ----------
    scene, grid
        The scene that the plan is made for, and where the voxels lie.
    accuracy
        Relative L2 error of the image; 0 for the closed form at every wavevector of the grid.
    blur
        A further Gaussian blur, um along Z, Y, X (for coarse levels of a fit).
    frame
        Grid of the whole image, to which effects refer, if ``grid`` leaves voxels out.
    margin
        How far (um) vertices may move before the plan no longer holds; 0 for a scene that stays.
        Otherwise edges may grow by a tenth, and a fit plans anew now and then to keep to that.
    method
        Forces ``"closed form"`` or ``"particle-mesh"``.
    device
        Where images are; see :func:`napari_deltamic.fourier.devices.choose_device`.
    plan
        Plan for the scene's only surface; by default the cheapest for the accuracy.

    Raises
    ------
    InputError
        If the accuracy is not in [0, 1), or a structure is so far from the grid that its units must
        be wrong.

    Notes
    -----
    The FFT is periodic. The grid is padded just enough that neither the image of the scene nor
    those of its periodic copies reach in from the other side.
    """

    def __init__(
        self,
        scene: Scene,
        grid: Grid,
        accuracy: float = 1e-3,
        *,
        blur: tuple[float, float, float] = (0.0, 0.0, 0.0),
        frame: Grid | None = None,
        margin: float = 0.0,
        method: Method | None = None,
        device: torch.device | str = "cpu",
        plan: Plan | None = None,
    ) -> None:
        check_accuracy(accuracy)
        self.scene, self.grid, self.frame, self.accuracy = scene, grid, frame or grid, accuracy
        self.blur, self.margin = blur, margin
        self.device = torch.device(device)
        optics = scene.optics
        self._start = np.concatenate([s.positions() for s in scene.structures])
        self._last_otf: tuple[Optics | None, Tensor | None] = None, None
        self._held_axes: tuple[Tensor, Tensor, Tensor] | None = None
        self._take(scene.effects)
        z, y, x = (float(w) for w in np.hypot(optics.width(), blur))
        site = Site(
            grid,
            self.frame,
            self._formation.fft_shape(self._start, optics, accuracy, margin),
            (z, y, x),
            accuracy,
            method,
            optics.diagonal,
            optics.cutoff(blur),
            partial(self._formation.otf, optics),  # a method of this renderer would keep it alive
            _STRETCH if margin > 0 else 1.0,
            for_objects(self.device),
            plan,
        )
        self._moving = scene.on_one_mesh()
        self._planned: list[Planned] = [s.planned(site) for s in scene.structures]
        # The largest band holds all others, as they differ only in the least |OTF|.
        self.band: Band = max((p.plan.band for p in self._planned), key=lambda b: b.half)
        single = all(p.plan.single for p in self._planned)
        self._axes = self.band.axes(torch.float32 if single else torch.float64)

    def _take(self, effects: Effects) -> None:
        self.effects = effects
        self._formation = Formation(self.grid, self.frame, self.blur, effects)

    @property
    def plan(self) -> Plan:
        """The plan of the scene's mesh."""
        return next(p.plan for p in self._planned if isinstance(p.plan, Plan))

    def with_effects(self, effects: Effects) -> Renderer:
        """Return a renderer with the same plan and other numbers of the same effects."""
        renderer = copy(self)
        renderer._take(effects)
        renderer._last_otf = None, None
        return renderer

    def pads_enough_for(self, effects: Effects, optics: Optics) -> bool:
        """Whether the grid is padded enough for other effects, which may reach further."""
        formation = Formation(self.grid, self.frame, self.blur, effects)
        needed = formation.fft_shape(self._start, optics, self.accuracy, self.margin)
        return all(n <= m for n, m in zip(needed, self.band.fft_shape, strict=True))

    def transform(
        self,
        vertices: Tensor | None = None,
        density: Tensor | None = None,
        light: Light | None = None,
        cells: Tensor | None = None,
    ) -> Tensor:
        """Return u_hat on the band's box, differentiable; two boxes if the PSF varies with depth.

        Parameters
        ----------
        vertices
            (V, 3) um: new vertices of the scene's mesh; by default those of the plan.
        density
            (F,) factors on its membranes.
        light
            Factors on its surfaces and solids; what does not shine is not computed. By default 1.
        cells
            (R,) how bright the inside of each region of a solid is, instead of the light's numbers.

        Raises
        ------
        InputError
            If the number of densities is not that of faces, or of numbers not that of regions.
        """
        total: Tensor | None = None
        for number, structure in enumerate(self.scene.structures):
            factor = 1.0 if light is None else light.of(isinstance(structure, Surface))
            if factor == 0:
                continue
            moved = vertices if structure in self._moving else None
            own = density if isinstance(structure, Surface) else None
            if isinstance(structure, Solid):
                own = _cells(structure, light) if cells is None else cells
            box = self.part(number, moved, own)
            box = box if factor == 1 else factor * box
            total = box if total is None else total + box
        assert total is not None, "a scene has structures, and something of it shines"
        return total

    def part(
        self, number: int, positions: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """Return u_hat of one structure of any kind; see :meth:`transform`.

        Parameters
        ----------
        number
            Index of the structure in the scene, from 0.
        positions
            (N, 3) um: its new vertices or points; by default those of the plan.
        density
            As ``transform`` takes it for a surface or a solid; (S,) or (P,) factors on the
            densities of segments or the weights of points.
        """
        planned = self._planned[number]
        box = self._held(planned.transform(self.effects, positions, density))
        return planned.plan.band.widened(box, self.band)

    def _held(self, box: Tensor) -> Tensor:
        """Move the box to the device of the image, in a type that the device supports."""
        if self.device.type == "mps":
            box = box.to(torch.complex64 if box.is_complex() else torch.float32)
        return box.to(self.device)

    def otf(self, optics: Optics) -> Tensor:
        """Return the OTF of optics, extra blur and effects on the box of the band."""
        if self.device.type == "cpu":
            return self._formation.otf(optics, self._axes)
        last, otf = self._last_otf
        if otf is None or last is not optics:
            otf = self._held(self._formation.otf(optics, self._axes_for(optics)))
            # Kept while the optics stay the same.
            self._last_otf = (None, None) if otf.requires_grad else (optics, otf)
        return otf

    def _axes_for(self, optics: Optics) -> tuple[Tensor, Tensor, Tensor]:
        """Return axes on the device if the OTF is a mere formula; else on the CPU."""
        z, y, x = self._axes
        if not isinstance(optics, GaussianPSF) or self.effects.present():
            return z, y, x
        if self._held_axes is None:
            self._held_axes = self._held(z), self._held(y), self._held(x)
        return self._held_axes

    def image(self, transform: Tensor, otf: Tensor, known: Tensor | None = None) -> Tensor:
        """Return the image (Z, Y, X): fluorophores seen in each voxel.

        Its sum over all space is their total number.
        known : the image, if it was made before and only its gradients are wanted.
        """
        return self._formation.image(transform, otf, self.band, known)

    def rendered(self) -> Tensor:
        """Return the image of the scene itself."""
        return self.image(self.transform(), self.otf(self.scene.optics))

    def offset(self) -> Tensor | None:
        """Return what effects add to the measured image, in its unit; None for nothing."""
        return offset(self.effects, self.grid, self.frame)


def offset(effects: Effects, grid: Grid, frame: Grid | None = None) -> Tensor | None:
    """Return (Z, Y, X) what effects add to the measured image of a grid; None for nothing."""
    found = None
    for effect in effects.present():
        if isinstance(effect, OffsetEffect):
            added = effect.offset(grid, frame or grid).expand(grid.shape)
            found = added if found is None else found + added
    return found


def render_scene(
    scene: Scene, grid: Grid, accuracy: float = 1e-3, *, method: Method | None = None
) -> Tensor:
    """Render a scene: all its structures under one PSF, with its effects.

    Parameters
    ----------
    scene
        Differentiable in the tensors of its structures and optics.
    grid
        Where the voxels lie.
    accuracy
        Relative L2 error of the image; 0 for the closed forms at every wavevector of the grid.
    method
        Forces ``"closed form"`` or ``"particle-mesh"``; by default the cheaper for each structure.

    Returns
    -------
    (Z, Y, X) tensor, fluorophores seen in each voxel: float32, or float64 if the accuracy is beyond
    single precision (below 3e-5). What effects add to the measured image (a background) is added
    only by :func:`expected_image`.

    Raises
    ------
    InputError
        As :class:`Renderer`.
    """
    return Renderer(scene, grid, accuracy, method=method).rendered()


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
    """Render the membranes of a mesh under a PSF: :func:`render_scene` of a single surface.

    It is computed on the device of the mesh's vertices.

    Parameters
    ----------
    mesh
        Vertices in um; the result is differentiable in them if they are a tensor that requires
        grad. A wall between two cells is two membranes and counts twice.
    optics
        The PSF; the result is differentiable in its tensors.
    density
        (F,) fluorophores per um^2 of membrane; 1 where not given.
    effects
        Optional parts of image formation, or their names.
    grid, accuracy, method
        As in :func:`render_scene`.

    Raises
    ------
    InputError
        As :class:`Renderer`, or if the density is not one number per face.
    """
    device = mesh.vertices.device if is_tensor(mesh.vertices) else "cpu"
    scene = Scene.of(mesh, optics, effects, density)
    return Renderer(scene, grid, accuracy, method=method, device=device).rendered()


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
    light: Light = MEMBRANES,
) -> np.ndarray:
    """Return (Z, Y, X) float32: what the microscope would measure without noise.

    It is ``amplitude * rendered image + background``, and what effects add; see :func:`render`.
    The light says which parts of the mesh shine.
    """
    chosen = as_effects(effects)
    scene = Scene.of(mesh, optics, chosen, density, light.interior != 0)
    with torch.no_grad():
        renderer = Renderer(scene, grid, accuracy)
        image = renderer.image(renderer.transform(light=light), renderer.otf(optics))
        image = amplitude * image + background
        added = offset(chosen, grid)
        return (image if added is None else image + added).to(torch.float32).numpy()


def _cells(solid: Solid, light: Light | None) -> Tensor | None:
    """Return (R,) how bright the insides of a solid's regions are; None if all are alike."""
    if light is None or not light.cells:
        return None
    return torch.from_numpy(light.of_cells(solid.mesh.region_ids()))
