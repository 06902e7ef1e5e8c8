"""Where a fit would have ended with another image: a few more steps of it, from where it is.

For surfaces whose second derivatives are too many to be written down (:mod:`.curvature`): what a
column of their inverse would tell is told by going down the objective of a changed image. All that
the fit looks for follows but the densities, which are held.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from ...geometry.mesh import FloatArray
from ...runs.settings import FitSettings
from ..model.shape import Shape
from ..objective.descent import Descent
from ..objective.limits import Limits
from ..objective.metric import Metric
from ..objective.posed import Posed
from ..objective.prediction import as_floats
from ..solvers.lbfgs import Learnt


@dataclass(frozen=True)
class ChangedImageRules:
    """How long refits go on, and which alternatives are tried and believed.

    Attributes
    ----------
    steps
        Of each. Measured in foams of 4 and 8 cells with 40 and 10 photons: means over patches
        as wide as the PSF then correlate by 0.95 to 0.98 with what the exact second derivatives
        give for the same noise, and are 1.0 to 1.3 times as large in each cell; 16 and 24 steps
        come no nearer.
    largest
        Times what a column explains while the surface stays. By definition: the surface then shows
        two thirds of it, and ten steps tell too roughly what is left.
    seen
        Standard deviations, over all voxels, of a change whose consequences are looked at: chosen,
        well above the rounding of images in single precision, and a small change of shape still.
    sure
        Nats: by definition three standard deviations; what gains less is no alternative.
    tried
        Alternatives at most: each takes a refit; chosen, not measured.
    patches, most_draws
        Of the noise, so many draws at most: with so many patches of two PSF widths for each cell,
        all draws together, its error is right to 1 / sqrt(2 patches), a tenth, by definition.
    """

    steps: int = 10
    largest: float = 3.0
    seen: float = 10.0
    sure: float = 4.5
    tried: int = 3
    patches: float = 50.0
    most_draws: int = 3


RULES = ChangedImageRules()
_RANK = 1e-9  # of columns of an image: less is rounding, that is the same column again


@dataclass(frozen=True, eq=False)
class Alternative:
    """Something that a model may lack.

    Attributes
    ----------
    name
        What it is.
    gain
        Nats.
    moved
        (V, 3) um: what the surface moves by with it.
    """

    name: str
    gain: float
    moved: FloatArray


@dataclass(frozen=True, eq=False)
class _Ended:
    """What a refit changed: the surface (V, 3), um, and the rendered image (N,)."""

    moved: FloatArray
    seen: FloatArray


class Refits:
    """Fits of changed images, each from where one has ended; see :class:`~.responses.Exact`.

    Parameters
    ----------
    posed
        The objective, where the fit has ended.
    shape, settings
        Of the fit there.
    """

    draws_of_one = (6, 6)  # chosen so that errors take less time than a fit of 150 evaluations

    def __init__(self, posed: Posed, shape: Shape, settings: FitSettings) -> None:
        self._posterior, self._at = posed.posterior, posed.at
        view, level = posed.posterior.views[0], posed.posterior.level
        self._width = level.width
        each = float(shape.mesh.areas().sum()) / len(shape.mesh.region_ids())
        wanted = RULES.patches * (2 * level.width) ** 2 / each
        self.draws = int(np.clip(np.ceil(wanted), 1, RULES.most_draws))
        self._metric = Metric.at_end(posed, shape, settings, density_fitted=False)
        self._learnt: Learnt | None = None
        now = self._posterior(self._at)
        self._image = as_floats(view.voxels.of(now.rendered))
        self._seen = now.match.amplitude * self._image + now.match.background
        self._weights = as_floats(view.voxels.weights) / view.variance
        self.residual = self._posterior.measured(self._at)[0] - self._seen

    def after(self, change: FloatArray) -> FloatArray:
        """(V, 3) um: what the surface follows a change (N,) of the image by."""
        return self._followed(change).moved

    def settled(self) -> FloatArray:
        """(V, 3) um: what more iterations would move the surface by."""
        return self._refitted(np.zeros(len(self.residual))).moved

    def pulled(self) -> FloatArray:
        """(V, 3) um: what the prior moves the surface by."""
        return self._unchanged.moved

    def amplitudes(self, columns: FloatArray) -> FloatArray:
        """(m,) how much of further columns (N, m) explains most of the residual; the surface stays.

        Brightness, background, PSF and effects follow.
        """
        return self._held(columns)[0]

    def alternatives(self, columns: Iterable[tuple[str, FloatArray]]) -> list[Alternative]:
        """What the model may lack, by further columns (N, m) of the image.

        Those that explain most while the surface stays; of several columns, as much of each as
        does. Others and those that explain next to nothing are not tried.
        """
        likely: list[tuple[float, str, FloatArray]] = []
        for name, each in columns:
            amplitudes, rest = self._held(each)
            column = rest @ amplitudes
            gain = float(column @ (self._weights * self.residual)) / 2
            if RULES.largest * gain >= RULES.sure:
                likely = sorted([*likely, (gain, name, column)], key=lambda one: -one[0])
                likely = likely[: RULES.tried]
        return [self._alternative(name, column) for _, name, column in likely]

    def instead(self, change: FloatArray) -> tuple[float, FloatArray]:
        """What another rendering, by a change (N,), gains, nats, and what it is followed by."""
        followed = self._followed(change)
        left = self._weights * (change - followed.seen)
        return float(left @ self.residual - left @ change / 2), -followed.moved

    def _alternative(self, name: str, column: FloatArray) -> Alternative:
        # What explains next to nothing would drown in the rounding of images.
        size = np.sqrt(max(float(column @ (self._weights * column)), 1e-300))
        enlarged = max(1.0, RULES.seen / size)
        column = enlarged * column
        followed = self._followed(column)
        left = self._weights * (column - followed.seen)
        inner, right = float(left @ column), float(left @ self.residual)
        # As much as explains most with the surface following, too.
        share = min(right / inner, RULES.largest / enlarged) if inner > 0 else 0.0
        return Alternative(name, share * (right - share * inner / 2), -share * followed.moved)

    def _held(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Amplitudes (m,) of columns, the surface held, and what of them is new (N, m)."""
        rest = np.stack([self._unexplained(column) for column in columns.T], 1)
        size = np.sqrt(np.maximum((self._weights[:, None] * rest**2).sum(0), 1e-300))
        one = rest / size
        weighted = self._weights[:, None] * one
        found = np.linalg.pinv(weighted.T @ one, rcond=_RANK, hermitian=True)
        return found @ (weighted.T @ self.residual) / size, rest

    def _followed(self, change: FloatArray) -> _Ended:
        """What surface and image follow a change by, without what the prior pulls."""
        unchanged, end = self._unchanged, self._refitted(change - self.residual)
        return _Ended(end.moved - unchanged.moved, end.seen - unchanged.seen)

    @cached_property
    def _unchanged(self) -> _Ended:
        """After a fit of the rendered image itself: what the prior does."""
        return self._refitted(-self.residual)

    @cached_property
    def _followers(self) -> tuple[list[FloatArray], FloatArray]:
        """Columns (N,) of brightness, background, PSF and effects; inverse of their normal matrix.

        Each column is scaled to a norm of 1.
        """
        imaging = self._posterior.imaging_columns(self._at)[0].T
        own = [self._image, np.ones(len(self._image)), *imaging.astype(np.float32)]
        own = [c / max(float(c @ (self._weights * c)), 1e-300) ** 0.5 for c in own]
        gram = np.array([[float(a @ (self._weights * b)) for b in own] for a in own])
        return own, np.linalg.pinv(gram, rcond=_RANK, hermitian=True)

    def _unexplained(self, column: FloatArray) -> FloatArray:
        """(N,) what is left of a column beside brightness, background, PSF and effects."""
        own, inverse = self._followers
        weighted = self._weights * column
        left = column
        for share, c in zip(inverse @ [float(c @ weighted) for c in own], own, strict=True):
            left = left - share * c
        return left

    def _refitted(self, added: FloatArray) -> _Ended:
        view = self._posterior.views[0]
        measured = view.voxels.measured + torch.from_numpy(added).to(view.voxels.measured)
        posterior = self._posterior.with_measured(measured)
        limits = Limits(self._at.vertices, self._width, self._posterior.prior.imaging)
        learnt = self._learnt
        descent = Descent(posterior, self._at, self._metric, self._width, limits, learnt)
        for _ in range(RULES.steps):
            if not descent.step():
                break
        self._learnt = descent.learnt()
        found = descent.now.match
        seen = found.amplitude * as_floats(view.voxels.of(descent.now.rendered)) + found.background
        return _Ended(descent.at.vertices - self._at.vertices, seen - self._seen)
