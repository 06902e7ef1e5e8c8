"""Where a fit would have ended with another image: a few more steps of it, from where it is.

For surfaces whose second derivatives are too many to be written down (:mod:`.curvature`): what a
column of their inverse would tell is told by going down the objective of a changed image. All that
the fit looks for follows but the densities, which are held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ..geometry.mesh import FloatArray
from ..geometry.vectors import lengths
from ..runs.settings import FitSettings
from .descent import Descent
from .lbfgs import Learnt
from .metric import Metric
from .pose import Posed
from .preconditioner import NEAR_JUNCTIONS, Preconditioners
from .shape import Shape
from .unequal_insides import Insides
from .variables import Variables

# Of each refit. Means over patches as wide as the PSF then correlate with those of the exact second
# derivatives by 0.95 or more, and are 0.9 to 1.3 times as large (foams of 4 and 8 cells, 10 and 40
# photons); 16 and 24 steps come no nearer.
_STEPS = 10
_RANK = 1e-9  # of columns of an image: less is rounding, that is the same column again


class Refits:
    """Fits of changed images, each from where one has ended; see :class:`~.responses.Responses`.

    Parameters
    ----------
    posed
        The objective, where the fit has ended.
    shape, settings
        Of the fit there.
    """

    # Of the noise: large surfaces have many patches, and each draw takes a refit. Chosen so that
    # errors take less time than a fit of 150 evaluations.
    draws, most_draws = 3, 6

    def __init__(self, posed: Posed, shape: Shape, settings: FitSettings) -> None:
        self._posterior, self._at = posed.posterior, posed.at
        view, level = posed.posterior.views[0], posed.posterior.level
        self._width = level.width
        given = shape, level.smoothing, settings.bending, posed.firmness, level.width
        self._metric = Metric(Preconditioners(), *given, NEAR_JUNCTIONS, False)
        self._learnt: Learnt | None = None
        self._image = self._posterior.images(self._at)[0]
        self._amplitude = self._posterior(self._at).match.amplitude
        self._weights = view.voxels.weights.cpu().numpy().astype(np.float64) / view.variance
        measured = self._posterior.measured(self._at)[0]
        self.residual = self._unexplained(measured, [])
        self._pulled: FloatArray | None = None

    def after(self, change: FloatArray) -> FloatArray:
        """(V, 3) um: what the surface follows a change (N,) of the image by."""
        return self._moved(change - self.residual) - self.pulled()

    def settled(self) -> FloatArray:
        """(V, 3) um: what more iterations would move the surface by."""
        return self._moved(np.zeros(len(self.residual)))

    def pulled(self) -> FloatArray:
        """(V, 3) um: what the prior moves the surface by."""
        if self._pulled is None:
            self._pulled = self._moved(-self.residual)
        return self._pulled

    def amplitudes(self, columns: FloatArray) -> FloatArray:
        """(m,) how much of further columns (N, m) explains most of the residual; the surface stays.

        Brightness, background, PSF and effects follow.
        """
        further = self._posterior.imaging_columns(self._at)[0]
        rest = np.stack([self._unexplained(column, list(further.T)) for column in columns.T], 1)
        weighted = self._weights[:, None] * rest
        found = np.linalg.pinv(weighted.T @ rest, rcond=_RANK, hermitian=True)
        return np.asarray(found @ (weighted.T @ self.residual))

    def alternative(self, columns: FloatArray) -> tuple[float, FloatArray]:
        """What further columns (N, m) gain, nats, and (V, 3) um what the surface then moves by.

        Of several columns, as much of each as explains most while the surface stays.
        """
        column = columns @ self.amplitudes(columns)
        followed = self.after(column)
        there = replace(self._at, vertices=self._at.vertices + followed)
        seen = self._amplitude * (self._posterior.images(there)[0] - self._image)
        rest = self._unexplained(column - seen, [])
        inner = float(rest @ (self._weights * column))
        right = float(rest @ (self._weights * self.residual))
        share = right / inner if inner > 0 else 0.0
        return share * right / 2, -share * followed

    def _unexplained(self, column: FloatArray, further: Sequence[FloatArray]) -> FloatArray:
        """(N,) what is left of a column beside brightness, background and further columns."""
        own = [self._image, np.ones(len(column)), *further]
        size = [1.0 / np.sqrt(max(float(c @ (self._weights * c)), 1e-300)) for c in own]
        gram = [[float(a @ (self._weights * b)) for b in own] for a in own] * np.outer(size, size)
        right = [s * float(c @ (self._weights * column)) for s, c in zip(size, own, strict=True)]
        found = np.linalg.pinv(gram, rcond=_RANK, hermitian=True) @ right
        left = column
        for share, s, c in zip(found, size, own, strict=True):
            left = left - share * s * c
        return left

    def _moved(self, added: FloatArray) -> FloatArray:
        view = self._posterior.views[0]
        measured = view.voxels.measured + torch.from_numpy(added).to(view.voxels.measured)
        descent = Descent(self._metric, self._width, self._limited, self._learnt)
        descent.begin(self._posterior.with_measured(measured), self._at)
        for _ in range(_STEPS):
            if not descent.step():
                break
        self._learnt = descent.learnt()
        return descent.at.vertices - self._at.vertices

    def _limited(self, start: Variables, end: Variables) -> Variables:
        away = end.vertices - self._at.vertices
        far = lengths(away)[:, None] / self._width
        return Variables(
            self._at.vertices + away / np.maximum(far, 1.0),
            end.density,
            Insides.bounded(end.insides),
            *self._posterior.prior.imaging.bounded(end.optics, end.effects),
        )
