"""A fitted scene: everything that the expected image depends on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..fitting.model.state import FitState
from ..geometry.mesh import Mesh
from ..scene import Scene
from ..scene.effects import Effects
from ..scene.light import MEMBRANES, Light
from ..scene.structures import Solid


@dataclass(frozen=True, eq=False)
class FittedScene(Scene):
    """A scene, and how its image is scaled.

    Attributes
    ----------
    amplitude, background
        Expected image = amplitude * rendered image + background + what effects add.
    light
        What of its mesh shines in the rendered image.
    """

    amplitude: float = 1.0
    background: float = 0.0
    light: Light = MEMBRANES

    @classmethod
    def of_state(
        cls,
        state: FitState,
        effects: Effects,
        mesh: Mesh | None = None,
        density: np.ndarray | None = None,
    ) -> FittedScene:
        """What a fit found; ``mesh``, ``density``: of a part of it."""
        if mesh is None:
            mesh, density = state.mesh, state.density
        uniform = density is None or np.ptp(density) == 0
        found = cls.of(
            mesh,
            state.optics.detach(),
            effects,
            None if uniform else density,
            insides=state.light.interior != 0,
        )
        return replace(found, light=state.light).scaled(state.amplitude, state.background)

    def scaled(self, amplitude: float, background: float) -> FittedScene:
        """The same with another scale."""
        return replace(self, amplitude=amplitude, background=background)

    @property
    def density(self) -> np.ndarray | None:
        """(F,) of the membranes relative to the mean; None where it is the same everywhere."""
        held = self.surface.density
        return held if isinstance(held, np.ndarray) else None

    @property
    def insides(self) -> Solid | None:
        """Of its mesh; None where they do not shine."""
        return next((s for s in self.structures if isinstance(s, Solid)), None)
