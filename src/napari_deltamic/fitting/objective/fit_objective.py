"""The objective at a level as it was posed, and the way down it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from ...common.freed_memory import SPARE
from ...common.kept import Kept
from ...geometry.mesh import FloatArray
from ...geometry.vectors import lengths
from ...runs.settings import FitSettings
from ..model.amplitudes import inside_over_membrane
from ..model.density import RULES as DENSITY
from ..model.density import Density
from ..model.fitted import Fitted
from ..model.imaging import Imaging
from ..model.level import Level
from ..model.likelihood import total
from ..model.noise_blur import is_sharpened
from ..model.tempering import block_centres, block_sums
from ..solvers.preconditioner import NEAR_JUNCTIONS, Preconditioners
from ..surface.collisions import CollisionGuard
from .convergence import Patches, Remaining, drifted, vertex_normals
from .deep_insides import RULES as DEEP
from .deep_insides import (
    UNKNOWN,
    Cells,
    cells_in_their_box,
    dark_insides_shown,
    deep_brightness,
    variation,
)
from .descent import Descent
from .limits import Limits
from .metric import Metric
from .pose import pose
from .posed import squares_left
from .posterior import Evaluation
from .prediction import View, as_floats
from .schedule import Schedule
from .structure_choice import Chosen, chosen

_STRAYED = 0.97  # of as far as vertices may go: only rounding and the guard keep it from all of it


@dataclass(frozen=True)
class Terms:
    """What an objective is posed with.

    Attributes
    ----------
    level, second
        Of the image, and of a second one.
    settings, schedule
        Of the fit.
    density_fitted, imaging_fitted
        Whether densities are unknowns; whether PSF and effects may be.
    last
        Whether it is the last level.
    """

    level: Level
    second: Level | None
    settings: FitSettings
    schedule: Schedule
    density_fitted: bool
    imaging_fitted: bool
    last: bool


class Objective:
    """Minus the log posterior near what is fitted, and the steps down it.

    Parameters
    ----------
    terms
        See :class:`Terms`.
    fitted
        Where it is posed.
    guard, factored
        Against collisions; factors of the metric that are there already.
    held
        Views of the objective before, see :func:`~.pose.pose`.

    Attributes
    ----------
    fitted
        Where the descent is.
    """

    def __init__(
        self,
        terms: Terms,
        fitted: Fitted,
        guard: CollisionGuard,
        factored: Preconditioners,
        held: Sequence[View] = (),
    ) -> None:
        self.terms, self._guard, self._factored = terms, guard, factored
        level, settings, width = terms.level, terms.settings, min(fitted.optics.sigma_um)
        free = terms.imaging_fitted and level.factor <= terms.schedule.imaging_below
        shining = inside_over_membrane(fitted.light, fitted.optics.sigma_um)
        differ = fitted.structure == "both" and shining > DENSITY.walls_first
        self._density = Density(fitted.mesh, fitted.shape.model, width, differ)
        self._imaging = Imaging(
            fitted.optics,
            fitted.effects,
            fitted.first_optics,
            settings.fit_psf and free,
            free,
            level.range,
        )
        SPARE.give_back()
        self.posed = pose(
            (level, terms.second),
            fitted,
            self._density,
            self._imaging,
            terms.density_fitted,
            terms.last,
            held,
        )
        self.fitted = fitted.moved(self.posed.at, self._imaging, terms.density_fitted)
        guard.watch(fitted.mesh)
        self._patches = Patches(fitted.mesh, min(self.fitted.optics.sigma_um))
        learnt = fitted.learnt
        known = learnt if learnt and learnt.fits(len(self.posed.at.flat())) else None
        at = self.posed.at
        limits = Limits(at.vertices, self._farthest, self._imaging, guard)
        metric = self._metric(factored)
        self._descent = Descent(self.posed.posterior, at, metric, level.width, limits, known)
        self._passed = deque([at.vertices], maxlen=terms.schedule.window + 1)
        self.fitted = self.fitted.shining(self.now.light)
        self._varies = Kept[tuple[float, float]](1)

    def _metric(self, factored: Preconditioners) -> Metric:
        level = self.terms.level
        return Metric(
            factored,
            self.fitted.shape,
            level.smoothing,
            self.terms.settings.bending,
            self.posed.firmness,
            level.width,
            NEAR_JUNCTIONS if level.factor == 1 else 1.0,
            self.terms.density_fitted,
        )

    @property
    def _farthest(self) -> float:
        """um that a vertex may go until the next objective."""
        return self.terms.schedule.strayed_far * self.terms.level.width

    @property
    def now(self) -> Evaluation:
        """Where the descent is."""
        return self._descent.now

    @property
    def left(self) -> float:
        """Like :attr:`Posed.left`, where the descent is."""
        return squares_left(self.now.match, self.posed.posterior.views[0].voxels)

    @property
    def face_densities(self) -> np.ndarray:
        """(F,) relative to the mean."""
        return self._density.faces_numpy(self._descent.at.density)

    def nats_left(self, other: Objective, evened: bool) -> FloatArray:
        """(2, B) nats that are left of the image here and where another descent is, by block.

        Over the voxels that count here, amplitude and background fitted for either. Blocks are
        those of the PSF that the fit began with (:mod:`.tempering`). evened : whether insides are
        as even as they are modelled here, or as they were measured.
        """
        index = self.posed.posterior.views[0].voxels.index.cpu().numpy()
        left = (self.posed.nats_left_by(one.now.rendered, evened) for one in (self, other))
        return np.stack([block_sums(as_floats(one), index, *self._blocks()) for one in left])

    def cells_of_blocks(self) -> NDArray[np.int64]:
        """(B,) the cell with the vertex nearest to each of these blocks."""
        grid, mesh = self.terms.level.grid, self.fitted.mesh
        centres = np.asarray(grid.origin) + block_centres(*self._blocks()) * grid.voxel_size
        owner = np.zeros(len(mesh.vertices), np.int64)
        owner[np.asarray(mesh.faces)] = mesh.regions.max(axis=1)[:, None]  # one of them at walls
        return np.asarray(owner[cKDTree(mesh.vertices_numpy()).query(centres)[1]])

    def _blocks(self) -> tuple[tuple[int, int, int], tuple[float, ...]]:
        """Shape of the image, and widths of the first PSF in voxels."""
        grid = self.terms.level.grid
        widths = self.terms.level.factor * np.asarray(self.fitted.first_optics.sigma_um)
        return grid.shape, tuple(widths / np.asarray(grid.voxel_size))

    def leaves_over(self, other: Objective) -> float:
        """What this leaves over what another does, as a mean over the voxels of each.

        Over its own voxels alone, each may be the better one. Measured on nuclei of a cleared
        brain, 4 voxels wide: an objective's PSF left 0.69 times as much as the Gaussian over its
        own voxels, 1.69 times as much over the others.
        """
        here = self.left / max(self.posed.left_by(other.now.rendered)[0], 1e-300)
        there = other.posed.left_by(self.now.rendered)[0] / max(other.left, 1e-300)
        return sqrt(here * there)

    def leaves_of_measured(self, other: Objective) -> float:
        """The same of the image as measured, where insides shine in one of them alone.

        An image that was evened for the one would deny the other. Measured on a membrane, of which
        a fit of both through a worse PSF had evened the light inside: 1.25 times as much over its
        voxels, 0.75 times as measured.
        """
        if (self.fitted.structure == "membrane") == (other.fitted.structure == "membrane"):
            return self.leaves_over(other)
        ratio = 1.0
        for posed in (self.posed, other.posed):
            mine, its = (
                float(total(posed.nats_left_by(one.now.rendered, False))) for one in (self, other)
            )
            ratio *= mine / max(its, 1e-300)
        return sqrt(ratio)

    def unevenness(self) -> float:
        """Squares left of insides as they were measured, over those of evened ones."""
        measured, evened = (
            float(total(self.posed.nats_left_by(self.now.rendered, even))) for even in (False, True)
        )
        return measured / max(evened, 1e-300)

    def evaluations(self) -> int:
        """Since this was last asked."""
        return self._descent.taken()

    def step(self) -> bool:
        """Go down; False where no way was found. Raises FloatingPointError for NaN."""
        moved = self._descent.step()
        self._passed.append(self._descent.at.vertices)
        if not np.isfinite(self.now.value):
            raise FloatingPointError("the fit met a number that is not finite")
        found = self.fitted.moved(self._descent.at, self._imaging, self.terms.density_fitted)
        self.fitted = found.shining(self.now.light).taught(self._descent.learnt())
        return moved

    def anew(self) -> Objective:
        """Posed anew where the descent is."""
        return Objective(self.terms, self.fitted, self._guard, self._factored)

    def strayed(self) -> bool:
        """Whether many vertices are as far as they may go."""
        away = self._descent.at.vertices - self.posed.at.vertices
        there = lengths(away) > _STRAYED * self._farthest
        return float(there.mean()) > self.terms.schedule.strayed

    def structure(self) -> Chosen:
        """What the image says that shines, of what may."""
        return chosen(
            self.posed.posterior, self._descent.at, self.now, self.fitted.mesh, self._sharpened
        )

    def _sharpened(self) -> bool:
        """Whether the image was deconvolved; a blurred one does not tell."""
        level, optics = self.terms.level, self.fitted.optics
        if level.factor != 1:
            return False
        seen, shown = self.seen_and_shown()
        return is_sharpened(seen - shown, optics.sigma_um, level.grid.voxel_size)

    def dark_insides_denied(self) -> bool:
        """Whether insides are darker than the medium, and the image shows that of few of them."""
        if self.now.light.interior >= 0:
            return False
        counted = self.terms.level.counted.cpu().numpy()
        shares = dark_insides_shown(self._cells(), *self.seen_and_shown(), counted).values()
        return bool(shares) and median(shares) < DEEP.shown

    def deep_brightness(self) -> float | None:
        """The median over cells of :func:`~.deep_insides.deep_brightness`; None where unknown."""
        counted = self.terms.level.counted.cpu().numpy()
        found = deep_brightness(self._cells(), self._seen().detach().cpu().numpy(), counted)
        return median(found.values()) if found else None

    def _cells(self) -> Cells:
        return Cells(self.fitted.mesh, self.fitted.optics, self.terms.level.grid)

    def insides_vary(self) -> tuple[float, float]:
        """Variation of brightness deep inside, relative to the peak of a membrane's image.

        At least, and at most; where few voxels are deep enough, or some were cut: ``UNKNOWN``.
        """
        return self._varies.get(self.now, self._variation)

    def _variation(self) -> tuple[float, float]:
        level, fitted = self.terms.level, self.fitted
        if self.posed.whole.full is not None:
            return UNKNOWN
        cells, box = cells_in_their_box(fitted.mesh, fitted.optics, level.grid)
        seen = self._seen()[box].detach().cpu().numpy()
        counted = level.counted[box].cpu().numpy()
        least, most = variation(cells, seen, self.now.match.background, counted)
        over = inside_over_membrane(self.now.light, fitted.optics.sigma_um)
        return least * over, most * over

    def seen_and_shown(self) -> tuple[np.ndarray, np.ndarray]:
        """(Z, Y, X) images: measured, without what effects add, and as the descent has it."""
        found = self.now.match
        shown = found.amplitude * self.now.rendered + found.background
        return self._seen().detach().cpu().numpy(), shown.detach().cpu().numpy()

    def own_light(self) -> NDArray[np.floating]:
        """(Z, Y, X) what the scene adds to the measured image, without background."""
        shown: NDArray[np.floating] = (self.now.match.amplitude * self.now.rendered).cpu().numpy()
        return shown

    def _seen(self) -> Tensor:
        """(Z, Y, X) measured, without what effects add."""
        level = self.terms.level
        added = level.offset(self.fitted.effects)
        return level.target if added is None else level.target - added.to(level.target)

    def remaining(self, tolerance: float) -> Remaining:
        """What is still to come where most is; tolerance : um."""
        schedule, at, step = self.terms.schedule, self._descent.at, self._descent.direction()
        # What the guard holds back has come as far as it can.
        free = (self._guard.held < schedule.held)[:, None]
        gradient = free * self.now.gradient.vertices
        normals = vertex_normals(at.vertices, self.fitted.mesh.faces)
        found = self._patches.worst(
            normals, free * step.vertices, gradient, tolerance, schedule.gain
        )
        moved = at.vertices - self._passed[0]
        return replace(found, drift=drifted(moved, normals, self.fitted.mesh))
