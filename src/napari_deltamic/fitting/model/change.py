"""What a user changes while a fit runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...geometry.mesh import Mesh
from ...optics import Optics
from ...runs.settings import FitSettings
from ...scene.effects import Effects

_LEFT_OPEN = ("accuracy", "flatness")  # settings that the software may have filled in


@dataclass(frozen=True, eq=False)
class Change:
    """Sent into a fit: ``states.send(Change(...))``; the fit goes on from there.

    None leaves a thing as it is.

    Attributes
    ----------
    mesh
        The surface from now on: vertices elsewhere, or another triangulation of the same regions.
    pinned
        (V,) bool: vertices that stay where they are from now on; all False frees them.
    optics
        The PSF from now on; of the kind it had.
    effects
        All that are there from now on.
    settings
        Everything else; its levels must be those of the fit, or None.
    """

    mesh: Mesh | None = None
    pinned: np.ndarray | None = None
    optics: Optics | None = None
    settings: FitSettings | None = None
    effects: Effects | None = None

    def check(self, mesh: Mesh, optics: Optics, settings: FitSettings) -> None:
        """InputError if a fit of this mesh with these optics and settings cannot take it."""
        if self.mesh is not None and not np.array_equal(self.mesh.region_ids(), mesh.region_ids()):
            raise InputError("the changed mesh has other regions than that of the fit")
        n = len((mesh if self.mesh is None else self.mesh).vertices)
        if self.pinned is not None and np.shape(self.pinned) != (n,):
            raise InputError(
                f"pinned must have one value for each of the {n} vertices, not shape "
                f"{np.shape(self.pinned)}"
            )
        if self.optics is not None and type(self.optics) is not type(optics):
            raise InputError(
                f"the fit has a {type(optics).__name__}; it cannot go on with a "
                f"{type(self.optics).__name__}"
            )
        if self.optics is not None and self.optics.parameters().shape != optics.parameters().shape:
            raise InputError("the PSF has another number of parameters than that of the fit")
        if self.settings is not None and self.settings.levels not in (None, settings.levels):
            raise InputError("the levels of a fit cannot change while it runs")


def taken_over(settings: FitSettings, before: FitSettings) -> FitSettings:
    """What a fit goes on with: what new settings leave open stays as it was."""
    kept = {name: getattr(before, name) for name in _LEFT_OPEN if getattr(settings, name) is None}
    return settings.model_copy(update={**kept, "levels": before.levels})
