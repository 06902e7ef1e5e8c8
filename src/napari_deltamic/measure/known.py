"""What is known about a shape besides its mesh, and what follows for errors and borders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from ..geometry.border import ImageGrid
from ..geometry.judgement import Judgement
from ..geometry.mesh import FloatArray, Mesh
from ..geometry.replicas import Replicas


@dataclass(frozen=True, eq=False)
class Known:
    """What is known about a shape besides its mesh; None or empty for what is not known.

    grid : of the image that it was fitted to.
    density : (F,) fluorophores per um^2 of each membrane; any common factor does not matter.
    resolution : um; the geometric mean of the PSF's standard deviations along the three axes.
    replicas : surfaces as likely as the fit's result, from which errors are estimated.
    explained : by region, the share of the variation around it that the fit explains.
    judgements : by region, how good its shape is.
    """

    grid: ImageGrid | None = None
    density: FloatArray | None = None
    resolution: float = 0.0
    replicas: Replicas | None = None
    explained: Mapping[int, float] = field(default_factory=dict)
    judgements: Mapping[int, Judgement] = field(default_factory=dict)

    def checked(self, mesh: Mesh) -> Known:
        """Return itself.

        InputError if the densities are those of another mesh or not finite, or the resolution is
        no length.
        """
        if self.density is not None and np.shape(self.density) != (len(mesh.faces),):
            raise InputError(
                f"there are {np.size(self.density)} densities for {len(mesh.faces)} faces"
            )
        if self.density is not None and not np.isfinite(self.density).all():
            raise InputError("densities must be finite numbers")
        if not 0 <= self.resolution < np.inf:
            raise InputError(f"the resolution must be a length (um), not {self.resolution}")
        return self
