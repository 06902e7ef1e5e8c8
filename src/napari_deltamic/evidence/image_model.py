"""The expected image of a fitted scene, and its derivatives in everything that was fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..fourier import Plan
from ..scene import Grid, Renderer
from ..scene.columns import Now, effect_columns, optics_columns
from ..scene.effects import Effect, Effects
from .fitted_scene import FittedScene
from .modes import ShapeModes
from .surface import SurfaceColumns
from .transforms import Transforms

_MARGIN = 2.0  # widths that vertices may move before a renderer is planned anew
# Of the PSF: a narrower one has a wider band. Measured: half and twice change no score by 0.2 %.
_NARROWED = 0.95


@dataclass(frozen=True)
class _Planned:
    """A renderer, and the widths (3,) um of the PSF that its band is for."""

    renderer: Renderer
    width: np.ndarray

    def holds_for(self, scene: FittedScene) -> bool:
        """Whether neither its mesh has moved too far nor its PSF become too narrow."""
        wide = (np.asarray(scene.optics.width()) >= _NARROWED * self.width).all()
        return bool(wide) and self.renderer.holds_for(scene.mesh.vertices_numpy())

    def pads_enough_for(self, scene: FittedScene) -> bool:
        """Whether no copy of the mesh is seen with its effects."""
        return self.renderer.pads_enough_for(scene.effects, scene.optics)


class ImageModel:
    """Expected values of the voxels that count, and their derivatives.

    Parameters
    ----------
    scene
        Near which images are wanted.
    grid
        Of the image.
    index
        (N,) flat indices of the voxels that count.
    accuracy
        Relative L2 error of the images.
    frame
        Grid of the whole image where ``grid`` is a part of it.
    """

    def __init__(
        self,
        scene: FittedScene,
        grid: Grid,
        index: np.ndarray,
        accuracy: float,
        frame: Grid | None = None,
    ) -> None:
        self.grid, self.accuracy, self.frame = grid, accuracy, frame or grid
        self._index = np.asarray(index, dtype=np.int64)
        self._voxels = _Voxels(torch.from_numpy(self._index))
        self._width = min(scene.optics.sigma_um)
        self._transforms = Transforms()
        self._plan_for(scene)

    def _plan_for(self, scene: FittedScene) -> None:
        self._planned = self._plan(scene)
        self._padded: dict[tuple[str, ...], _Planned] = {}

    def _plan(self, scene: FittedScene) -> _Planned:
        renderer = Renderer(
            scene,
            self.grid,
            self.accuracy,
            frame=self.frame,
            margin=_MARGIN * self._width,
        )
        return _Planned(renderer, np.asarray(scene.optics.width()))

    @property
    def plan(self) -> Plan:
        """Of the images."""
        return self._planned.renderer.plan

    def _renderer_for(self, scene: FittedScene) -> Renderer:
        """One plan for all scenes near each other, but for effects that need a wider padding."""
        if not self._planned.holds_for(scene):
            self._plan_for(scene)
        if self._planned.pads_enough_for(scene):
            return self._planned.renderer.with_effects(scene.effects)
        names = scene.effects.names
        held = self._padded.get(names)
        if held is None or not (held.holds_for(scene) and held.pads_enough_for(scene)):
            held = self._padded[names] = self._plan(scene)
        return held.renderer.with_effects(scene.effects)

    def _seen(self, image: Tensor) -> np.ndarray:
        found: np.ndarray = self._voxels.of(image).to(torch.float64).numpy()
        return found

    @torch.no_grad()
    def rendered(self, scene: FittedScene) -> np.ndarray:
        """(N,) of the rendered image, before amplitude and background."""
        renderer = self._renderer_for(scene)
        transform = self._transforms.of(renderer, scene)
        return self._seen(renderer.image(transform, renderer.otf(scene.optics)))

    def expected(self, scene: FittedScene) -> np.ndarray:
        """(N,) of the expected image."""
        return self.measured(self.rendered(scene), scene)

    def measured(self, rendered: np.ndarray, scene: FittedScene) -> np.ndarray:
        """(N,) of the expected image, from that of the rendered one."""
        values = scene.amplitude * rendered + scene.background
        added = self._renderer_for(scene).offset()
        return values if added is None else values + self._seen(added)

    def light_columns(self, scene: FittedScene, rendered: np.ndarray) -> np.ndarray:
        """(N, 2 or 3): for amplitude and background, and the interior where both kinds shine."""
        columns = [rendered, np.ones(len(rendered))]
        if scene.light.membrane and scene.light.interior:
            insides = replace(scene, light=scene.light.insides())
            columns.append(scene.amplitude * self.rendered(insides))
        return np.array(columns).T

    def shape_columns(self, scene: FittedScene, modes: ShapeModes) -> np.ndarray:
        """(N, K): change of the expected image for a coefficient of 1 um of each mode."""
        return self._of_surface(scene).shape(modes)

    def density_columns(self, scene: FittedScene, fields: np.ndarray) -> np.ndarray:
        """(N, M): for a coefficient of 1 of each field (M, F) of the logarithm of the density."""
        return self._of_surface(scene).density(fields)

    def _of_surface(self, scene: FittedScene) -> SurfaceColumns:
        return SurfaceColumns(scene, self.grid, self.frame, self._index, self.accuracy)

    @torch.no_grad()
    def psf_columns(self, scene: FittedScene) -> np.ndarray:
        """(N, P): for each of the PSF's parameters."""
        return _stacked(optics_columns(self._now(scene)), len(self._index))

    @torch.no_grad()
    def effect_columns(self, scene: FittedScene, effect: Effect) -> np.ndarray:
        """(N, P): for each of an effect's parameters, about the values that it has.

        One column, the whole difference that it makes, for an effect without numbers.
        """
        having = scene.with_effects(scene.effects.adding(effect))
        if effect.bounds:
            return _stacked(effect_columns(self._now(having), effect), len(self._index))
        without = scene.with_effects(scene.effects.without(effect.name))
        change = torch.from_numpy(self.expected(having) - self.expected(without))
        return _stacked([change], len(self._index))

    def _now(self, scene: FittedScene) -> Now:
        """Where its derivatives are taken."""
        renderer = self._renderer_for(scene)
        spectrum, otf = self._transforms.of(renderer, scene), renderer.otf(scene.optics)
        return Now(
            _Forming(self.grid, self.frame),
            renderer,
            scene.optics,
            scene.effects,
            lambda other: self._transforms.of(other, scene.with_effects(other.effects)),
            spectrum,
            otf,
            self._voxels.of(renderer.image(spectrum, otf)),
            self._voxels,
            scene.amplitude,
        )


@dataclass(frozen=True)
class _Forming:
    """See :class:`~napari_deltamic.scene.columns.Forming`."""

    grid: Grid
    frame: Grid

    def rendered(self, renderer: Renderer, transform: Tensor, otf: Tensor) -> Tensor:
        """As the renderer forms it."""
        return renderer.image(transform, otf)


@dataclass(frozen=True)
class _Voxels:
    """Flat indices (N,) of the voxels that count."""

    index: Tensor

    def of(self, image: Tensor) -> Tensor:
        """(N,) values in an image (Z, Y, X)."""
        return image.reshape(-1)[self.index]


def _stacked(columns: list[Tensor], length: int) -> np.ndarray:
    """(N, K), stored column by column."""
    if not columns:
        return np.zeros((0, length)).T
    return np.array([c.to(torch.float64).numpy() for c in columns]).T


def parameters_of(effects: Effects) -> list[tuple[Effect, int]]:
    """Each fitted effect and how many numbers it has."""
    return [(e, len(e.parameters())) for e in effects.fitted()]


def with_changed(effects: Effects, change: np.ndarray) -> Effects:
    """The effects with their numbers, one after the other, changed by so much."""
    changed: dict[str, Any] = {}
    at = 0
    for effect, n in parameters_of(effects):
        p = effect.parameters() + torch.from_numpy(np.asarray(change[at : at + n]))
        changed[effect.name] = effect.with_parameters(p)
        at += n
    return effects.replace(**changed)
