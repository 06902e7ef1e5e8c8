"""Transforms of a fitted mesh, each computed once for everything that leaves it as it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..common.kept import Kept
from ..scene import Renderer
from ..scene.effects import DepthEffect, FaceEffect
from ..scene.light import MEMBRANES, Light
from .fitted_scene import FittedScene

_KEPT = 12  # parts of a scene and of its candidates, asked for again; more would only take memory


class Transforms:
    """u_hat of scenes, put together from parts: membranes and insides.

    Most effects act on the OTF or on the image, so that their candidates share the parts; how
    bright each part is changes none of them.
    """

    def __init__(self) -> None:
        self._kept: Kept[tuple[Tensor, tuple[Any, ...]]] = Kept(_KEPT)

    def of(self, renderer: Renderer, scene: FittedScene) -> Tensor:
        """As :meth:`napari_deltamic.scene.Renderer.transform` of the scene's mesh and density."""
        present = scene.effects.present()
        # What acts on the object; of a PSF that changes with depth, that it does.
        on_faces = [e for e in present if isinstance(e, FaceEffect)]
        acting = repr(on_faces), any(isinstance(e, DepthEffect) for e in present)
        whose = renderer.plan, scene.mesh, scene.density
        vertices = torch.from_numpy(scene.mesh.vertices_numpy())
        density = torch.tensor(1.0 if scene.density is None else scene.density)

        def part(light: Light) -> Tensor:
            what = (light, *acting)
            return self._part(whose, what, lambda: renderer.transform(vertices, density, light))

        light, total = scene.light, torch.zeros(())
        for share, alone in ((light.membrane, MEMBRANES), (light.interior, light.insides())):
            if share:
                total = total + share * part(alone)
        return total

    def _part(
        self, whose: tuple[Any, ...], what: tuple[Any, ...], make: Callable[[], Tensor]
    ) -> Tensor:
        # What it belongs to is kept too, lest its place be taken by another.
        return self._kept.get((*map(id, whose), *what), lambda: (make(), whose))[0]
