"""What a user changes while a fit runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..settings import FitSettings


@dataclass(frozen=True, eq=False)
class Change:
    """Sent into a fit: ``states.send(Change(...))``; the fit goes on from there.

    None leaves a thing as it is.

    Attributes
    ----------
    vertices
        (V, 3) um: new places of all vertices.
    pinned
        (V,) bool: vertices that stay where they are from now on; all False frees them.
    optics
        The PSF from now on; of the kind it had.
    settings
        Everything else; its levels must be those of the fit, or None.
    """

    vertices: np.ndarray | None = None
    pinned: np.ndarray | None = None
    optics: Optics | None = None
    settings: FitSettings | None = None

    def check(self, mesh: Mesh, optics: Optics, settings: FitSettings) -> None:
        """InputError if a fit of this mesh with these optics and settings cannot take it."""
        n = len(mesh.vertices)
        if self.vertices is not None:
            if np.shape(self.vertices) != (n, 3):
                raise InputError(
                    f"the mesh of the fit has {n} vertices; changed ones have shape "
                    f"{np.shape(self.vertices)}"
                )
            if not np.isfinite(self.vertices).all():
                raise InputError("changed vertices must be finite")
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
