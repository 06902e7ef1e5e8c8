"""Transforms of a fitted mesh, each computed once for everything that leaves it as it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..fourier.cuda.kept import Kept
from ..scene import Renderer
from ..scene.effects import Effects, FaceEffect
from ..scene.effects.object_side import ObjectSide, Surfaces, assembled
from .fitted_scene import FittedScene

_KEPT = 12  # parts; those of a scene and of its candidates are asked for again and again


class Transforms:
    """u_hat of scenes, put together from parts: the surface, its depths, and the inside.

    Most effects act on the OTF or on the image, so that their candidates share all parts; the
    inside is in proportion to its density.
    """

    def __init__(self) -> None:
        self._kept: Kept[tuple[Tensor, tuple[Any, ...]]] = Kept(_KEPT)

    def of(self, renderer: Renderer, scene: FittedScene) -> Tensor:
        """As :meth:`napari_deltamic.scene.Renderer.transform` of the scene's mesh and density."""
        effects = scene.effects
        whose = renderer.plan, scene.mesh, scene.density
        on_faces = repr([e for e in effects.present() if isinstance(e, FaceEffect)])

        def side(of: Effects = effects) -> ObjectSide:
            weight = torch.as_tensor(scene.mesh.membranes(), dtype=torch.float64)
            if scene.density is not None:
                weight = weight * torch.tensor(scene.density)
            return ObjectSide(
                renderer.plan,
                torch.from_numpy(scene.mesh.vertices_numpy()),
                Surfaces.of(scene.mesh),
                weight,
                of,
                renderer.grid,
                renderer.frame,
            )

        seen = self._part(whose, ("seen", on_faces), lambda: side().seen())
        deep = inside = None
        if effects.depth is not None:
            deep = self._part(whose, ("deep", on_faces), lambda: side().deep())
        if effects.bulk is not None and effects.bulk.density != 0:
            unit = effects.bulk.model_copy(update={"density": 1.0})
            of_one = effects.replace(bulk=unit)
            part = self._part(
                whose, ("inside", on_faces, repr(unit)), lambda: side(of_one).inside()
            )
            inside = effects.bulk.density * part
        return assembled(seen, deep, inside)

    def _part(
        self, whose: tuple[Any, ...], what: tuple[str, ...], make: Callable[[], Tensor]
    ) -> Tensor:
        # What it belongs to is kept too, lest its place be taken by another.
        return self._kept.get((*map(id, whose), *what), lambda: (make(), whose))[0]
