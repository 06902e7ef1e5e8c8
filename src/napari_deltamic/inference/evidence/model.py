"""The expected image of a fitted scene, and its derivatives in everything that was fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...fourier import Plan
from ...geometry.mesh import Mesh
from ...optics import Optics
from ...scene import Grid, Renderer
from ...scene.effects import Effect, Effects, OffsetEffect
from .modes import ShapeModes

_MOVE = 0.08  # of the PSF's width: a difference of shapes
_SHAPE_ACCURACY = 1e-2  # of derivatives in the shape, which are many and need not be better
_PSF_CHANGE = 1e-2
_CHANGE = 0.05  # of an effect's scale
_MARGIN = 2.0  # widths that vertices may move before a renderer is planned anew


@dataclass(frozen=True)
class Scene:
    """Everything that the expected image depends on.

    Attributes
    ----------
    mesh, optics, effects
        As they were fitted.
    amplitude, background
        Expected image = amplitude * rendered image + background + what effects add.
    density
        (F,) of the membranes relative to the mean; None where it is the same everywhere.
    """

    mesh: Mesh
    optics: Optics
    effects: Effects
    amplitude: float
    background: float
    density: np.ndarray | None = None


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
        scene: Scene,
        grid: Grid,
        index: np.ndarray,
        accuracy: float,
        frame: Grid | None = None,
    ) -> None:
        self.grid, self.accuracy, self.frame = grid, accuracy, frame or grid
        self._index = torch.from_numpy(np.asarray(index, dtype=np.int64))
        self._width = min(scene.optics.sigma_um)
        self._renderer = self._planned(scene, accuracy)

    def _planned(self, scene: Scene, accuracy: float) -> Renderer:
        return Renderer(
            scene.mesh,
            self.grid,
            scene.optics,
            accuracy,
            effects=scene.effects,
            frame=self.frame,
            margin=_MARGIN * self._width,
        )

    @property
    def plan(self) -> Plan:
        """Of the images."""
        return self._renderer.plan

    def _renderer_for(self, scene: Scene) -> Renderer:
        held = self._renderer
        same = held.effects.names == scene.effects.names
        if not same or not held.holds_for(scene.mesh.vertices_numpy()):
            self._renderer = held = self._planned(scene, self.accuracy)
        return held.with_effects(scene.effects)

    def _voxels(self, image: Tensor) -> np.ndarray:
        found: np.ndarray = image.reshape(-1)[self._index].to(torch.float64).numpy()
        return found

    @staticmethod
    def _transform(renderer: Renderer, scene: Scene, vertices: np.ndarray | None = None) -> Tensor:
        v = scene.mesh.vertices_numpy() if vertices is None else vertices
        density = None if scene.density is None else torch.from_numpy(scene.density)
        return renderer.transform(torch.from_numpy(v), density)

    @torch.no_grad()
    def rendered(self, scene: Scene) -> np.ndarray:
        """(N,) of the rendered image, before amplitude and background."""
        renderer = self._renderer_for(scene)
        transform = self._transform(renderer, scene)
        return self._voxels(renderer.image(transform, renderer.otf(scene.optics)))

    def expected(self, scene: Scene) -> np.ndarray:
        """(N,) of the expected image."""
        return self.measured(self.rendered(scene), scene)

    def measured(self, rendered: np.ndarray, scene: Scene) -> np.ndarray:
        """(N,) of the expected image, from that of the rendered one."""
        values = scene.amplitude * rendered + scene.background
        added = self._renderer_for(scene).offset()
        return values if added is None else values + self._voxels(added)

    @torch.no_grad()
    def shape_columns(self, scene: Scene, modes: ShapeModes) -> np.ndarray:
        """(N, K): change of the expected image for a coefficient of 1 um of each mode."""
        renderer = self._planned(scene, max(self.accuracy, _SHAPE_ACCURACY))
        otf = renderer.otf(scene.optics)
        v = scene.mesh.vertices_numpy()
        columns = []
        for field in modes.fields:
            h = _MOVE * self._width / max(float(np.abs(field).max()), 1e-12)
            ends = [self._transform(renderer, scene, v + side * h * field) for side in (1, -1)]
            change = ends[0] - ends[1]
            columns.append(self._voxels(renderer.image(change, otf)) * (scene.amplitude / (2 * h)))
        return _stacked(columns, len(self._index))

    @torch.no_grad()
    def density_columns(self, scene: Scene, fields: np.ndarray) -> np.ndarray:
        """(N, M): for a coefficient of 1 of each field (M, F) of the logarithm of the density."""
        renderer = self._planned(scene, max(self.accuracy, _SHAPE_ACCURACY))
        otf = renderer.otf(scene.optics)
        held = np.ones(len(scene.mesh.faces)) if scene.density is None else scene.density
        without = replace(scene, effects=scene.effects.without("bulk"))
        if scene.effects.bulk is not None:  # the inside does not dim with its surface
            renderer = self._planned(without, max(self.accuracy, _SHAPE_ACCURACY))
            otf = renderer.otf(scene.optics)
        columns = []
        for field in fields:
            transform = self._transform(renderer, replace(without, density=held * field))
            columns.append(scene.amplitude * self._voxels(renderer.image(transform, otf)))
        return _stacked(columns, len(self._index))

    @torch.no_grad()
    def psf_columns(self, scene: Scene) -> np.ndarray:
        """(N, P): for each of the PSF's parameters."""
        renderer = self._renderer_for(scene)
        transform = self._transform(renderer, scene)
        p = scene.optics.parameters().detach()
        columns = []
        for k in range(len(p)):
            step = torch.zeros_like(p)
            step[k] = _PSF_CHANGE
            otf = renderer.otf(scene.optics.with_parameters(p + step)) - renderer.otf(
                scene.optics.with_parameters(p - step)
            )
            column = self._voxels(renderer.image(transform, otf))
            columns.append(column * (scene.amplitude / (2 * _PSF_CHANGE)))
        return _stacked(columns, len(self._index))

    def effect_columns(self, scene: Scene, effect: Effect) -> np.ndarray:
        """(N, P): for each of an effect's parameters, about the values that it has.

        One column, the whole difference that it makes, for an effect without numbers.
        """
        if not effect.bounds:
            without = replace(scene, effects=scene.effects.without(effect.name))
            having = replace(scene, effects=scene.effects.replace(**{effect.name: effect}))
            return _stacked([self._with(having) - self._with(without)], len(self._index))
        p = effect.parameters()
        columns = []
        for k in range(len(p)):
            step = torch.zeros_like(p)
            step[k] = 1.0 if isinstance(effect, OffsetEffect) else _CHANGE
            ends: list[Any] = [effect.with_parameters(p + side * step) for side in (1, -1)]
            # At a bound only one side is allowed.
            between = float(ends[0].parameters()[k] - ends[1].parameters()[k])
            if between <= 0:
                columns.append(np.zeros(len(self._index)))
                continue
            if isinstance(effect, OffsetEffect):
                added = [self._added(e) for e in ends]
            else:
                added = [
                    self._with(replace(scene, effects=scene.effects.replace(**{e.name: e})))
                    for e in ends
                ]
            columns.append((added[0] - added[1]) / between)
        return _stacked(columns, len(self._index))

    def _added(self, effect: OffsetEffect) -> np.ndarray:
        return self._voxels(effect.offset(self.grid, self.frame).expand(self.grid.shape))

    def _with(self, scene: Scene) -> np.ndarray:
        """Expected image of a scene whose effects are not those planned for."""
        held = self._renderer
        try:
            return self.expected(scene)
        finally:
            self._renderer = held


def _stacked(columns: list[np.ndarray], length: int) -> np.ndarray:
    return np.stack(columns, 1) if columns else np.zeros((length, 0))


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
