"""Two PSFs as one, for renderings that are planned for both."""

from __future__ import annotations

from math import log, sqrt
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ..common.triple import Triple, triple
from ..fourier.falloff import Falloff
from ..fourier.plan import Cutoff
from .gaussian import GaussianPSF

if TYPE_CHECKING:
    from . import Optics


class Sharpest:
    """Optics for a plan: as sharp as the sharper and as wide as the wider of two PSFs.

    Parameters
    ----------
    first, second
        The two PSFs; the second is Gaussian.
    """

    def __init__(self, first: Optics, second: GaussianPSF) -> None:
        self._first, self._second = first, second
        self.diagonal = first.diagonal and second.diagonal

    def reach(self, accuracy: float) -> Triple:
        """Return the reach (um) of the wider one along Z, Y, X."""
        return triple(np.maximum(self._first.reach(accuracy), self._second.reach(accuracy)))

    def width(self) -> Triple:
        """Return the width (um) of the sharper one along Z, Y, X."""
        return triple(np.minimum(self._first.width(), self._second.width()))

    def otf(self, axes: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """Return the larger |OTF| of both at each wavevector."""
        return torch.maximum(self._first.otf(axes).abs(), self._second.otf(axes).abs())

    def cutoff(self, blur: Triple = (0.0, 0.0, 0.0)) -> Cutoff | None:
        """Return where the OTFs of both end; None if both are Gaussian."""
        first = self._first.cutoff(blur)
        if first is None:
            return None

        def found(error: float, falloff: Falloff) -> tuple[Triple, float]:
            radius, at_edge = first(error, falloff)
            second = sqrt(2 * log(1 / at_edge)) / np.hypot(self._second.width(), blur)
            return triple(np.maximum(radius, second)), at_edge

        return found
