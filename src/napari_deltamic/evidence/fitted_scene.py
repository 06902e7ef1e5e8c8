"""A fitted scene: everything that the expected image depends on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fitting.state import FitState
from ..geometry.mesh import Mesh
from ..scene import Scene
from ..scene.effects import Effects
from ..scene.effects.bulk import Bulk
from ..scene.light import Light


@dataclass(frozen=True, eq=False)
class FittedScene(Scene):
    """A scene, and how its image is scaled.

    Attributes
    ----------
    amplitude, background
        Expected image = amplitude * rendered image + background + what effects add.
    """

    amplitude: float = 1.0
    background: float = 0.0

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
        effects, share = _with_inside(effects, state.light)
        found = cls.of(mesh, state.optics.detach(), effects, None if uniform else density)
        return found.scaled(share * state.amplitude, state.background)

    def scaled(self, amplitude: float, background: float) -> FittedScene:
        """The same with another scale."""
        return FittedScene(self.structures, self.optics, self.effects, amplitude, background)

    @property
    def density(self) -> np.ndarray | None:
        """(F,) of the membranes relative to the mean; None where it is the same everywhere."""
        held = self.surface.density
        return held if isinstance(held, np.ndarray) else None


def _with_inside(effects: Effects, light: Light) -> tuple[Effects, float]:
    """Effects that show the same inside, and the share of the amplitude that membranes then have.

    Where membranes do not shine they are as dim as an effect can make them: 1 to 100 um^-1.
    """
    if not light.interior or effects.light_inside:
        return effects, 1.0
    most = Bulk.bounds["density"].high
    share = light.membrane or abs(light.interior) / most
    density = float(np.clip(light.interior / share, -most, most))
    return effects.replace(bulk=Bulk(density=density, fit=False)), share
