"""Scene: structures, optics and effects in one object, and the image that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..fourier import Band
from ..fourier.plan import Method, check_accuracy
from ..optics import Optics
from .effects import Effects, as_effects
from .formation import Formation
from .grid import Grid
from .render import offset
from .structures import Site, Structure, Transform


@dataclass(frozen=True, eq=False)
class Scene:
    """What the microscope looks at, and how.

    Attributes
    ----------
    structures
        What shines: surfaces, solids, filaments, points.
    optics
        The PSF.
    effects
        Optional parts of image formation, or their names; absent ones are not computed. An effect
        on the object (attenuation, a PSF that changes with depth) acts on all structures; the bulk
        effect is the inside of surfaces.
    """

    structures: tuple[Structure, ...]
    optics: Optics
    effects: Effects = field(default_factory=Effects)

    def __post_init__(self) -> None:
        given = self.structures
        structures = tuple(given) if isinstance(given, (list, tuple)) else (given,)
        if not structures:
            raise InputError("a scene needs a structure: a surface, solid, filament or points")
        object.__setattr__(self, "structures", structures)
        object.__setattr__(self, "effects", as_effects(self.effects))

    def with_effects(self, effects: Effects | Sequence[str]) -> Scene:
        """The same scene with other effects."""
        return replace(self, effects=as_effects(effects))


class SceneRenderer:
    """Renders a scene on a grid; each structure has its own plan, and all share one image.

    Every structure's image is as accurate as asked, relative to itself; so is their sum, unless
    they have opposite signs.

    Parameters
    ----------
    scene, grid
        What is rendered, and where the voxels lie.
    accuracy
        Relative L2 error of the image; 0 for the closed forms at every wavevector of the grid.
    method
        Forces ``"closed form"`` or ``"particle-mesh"``.
    frame
        Grid of the whole image, to which effects refer, where ``grid`` leaves voxels out.

    Raises
    ------
    InputError
        If the accuracy is not in [0, 1), or a structure so far from the grid that its units must be
        wrong.
    """

    def __init__(
        self,
        scene: Scene,
        grid: Grid,
        accuracy: float = 1e-3,
        *,
        method: Method | None = None,
        frame: Grid | None = None,
    ) -> None:
        check_accuracy(accuracy)
        self.scene = scene
        optics, frame = scene.optics, frame or grid
        self.formation = Formation(grid, frame, (0.0, 0.0, 0.0), scene.effects)
        positions = np.concatenate([s.positions() for s in scene.structures])
        shape = self.formation.fft_shape(positions, optics, accuracy)
        z, y, x = (float(w) for w in optics.width())
        site = Site(
            grid,
            frame,
            shape,
            (z, y, x),
            accuracy,
            method,
            optics.diagonal,
            scene.effects,
            optics.cutoff(),
            lambda axes: self.formation.otf(optics, axes),
        )
        self.transforms: list[Transform] = [s.planned(site) for s in scene.structures]
        # One of them holds all others: what they ask of the OTF is a number.
        self.band: Band = max((t.band for t in self.transforms), key=lambda b: b.half)
        single = all(t.single for t in self.transforms)
        self.axes = self.band.axes(torch.float32 if single else torch.float64)

    def transform(self) -> Tensor:
        """u_hat of all structures on the box of the widest band; differentiable."""
        total: Tensor | None = None
        for each in self.transforms:
            box = _widened(each(), each.band, self.band)
            total = box if total is None else total + box
        assert total is not None, "a scene has structures"
        return total

    def image(self) -> Tensor:
        """Image (Z, Y, X): fluorophores seen in each voxel."""
        otf = self.formation.otf(self.scene.optics, self.axes)
        return self.formation.image(self.transform(), otf, self.band)


def render_scene(
    scene: Scene, grid: Grid, accuracy: float = 1e-3, *, method: Method | None = None
) -> Tensor:
    """The image of a scene: all its structures under one PSF, with its effects.

    Of a single surface it is what :func:`napari_deltamic.render` gives, to the bit.

    Parameters
    ----------
    scene
        Differentiable in the tensors of its structures and optics.
    grid
        Where the voxels lie.
    accuracy
        Relative L2 error of the image; 0 for the closed forms at every wavevector of the grid.
    method
        Forces ``"closed form"`` or ``"particle-mesh"``; by default the cheaper of each structure.

    Returns
    -------
    (Z, Y, X) tensor, fluorophores seen in each voxel; float32 or float64 as the accuracy asks. What
    effects add to the measured image (a background) is added by :func:`expected_scene` alone.

    Raises
    ------
    InputError
        As :class:`SceneRenderer`.
    """
    return SceneRenderer(scene, grid, accuracy, method=method).image()


def expected_scene(
    scene: Scene, grid: Grid, accuracy: float, amplitude: float, background: float
) -> np.ndarray:
    """(Z, Y, X) float64: what a detector of photons would count on average.

    ``amplitude * image + background``, and what effects add.
    """
    with torch.no_grad():
        image = amplitude * render_scene(scene, grid, accuracy).to(torch.float64) + background
        added = offset(scene.effects, grid)
        return (image if added is None else image + added).numpy()


def _widened(box: Tensor, band: Band, to: Band) -> Tensor:
    """The box of a band, zero-padded to that of a wider one."""
    if band.half == to.half:
        return box
    z, y, x = (n - k for n, k in zip(to.half, band.half, strict=True))
    return torch.nn.functional.pad(box, (0, x, y, y, z, z))
