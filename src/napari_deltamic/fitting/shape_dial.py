"""The dial: how near to the true shape a fit is to come, and what it takes.

The mean distance of a fitted surface to the true one has six parts, which add in squares:

- the noise of the image, which moves surfaces further near rims, where walls meet,
- rims, which blur and prior make rounder even without noise,
- voxels: the error of the model of what they measure (no setting changes these three),
- flat triangles: with edges h, they lie ``0.028 h^2 k`` off a surface of curvature k; a fitted
  surface, which lies on both sides of the true one, is off by 0.6 of that,
- the rendering: an accuracy A moves the surface by ``0.03 (A / 0.1)^1.25`` voxels,
- iterations that are left out: 0.15 of the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from ..common.ball import ball_radius
from ..common.triple import geometric_mean
from ..errors import InputError
from ..geometry.mesh import Mesh
from ..geometry.remeshing import can_remesh, remesh
from ..runs.fit_settings import FitSettings, asked_error
from ..scene import Grid
from .model.default_accuracy import COARSEST, FINEST, preset_accuracy
from .surface.triangle_quality import RULES as TRIANGLES


@dataclass(frozen=True)
class DialRules:
    """What the parts are, and what the names stand for.

    Noise, rims, voxels and triangles were fitted to 264 errors of 88 scenes like those of
    benchmarks.dial, of 1 to 32 cells, at the three named choices: for each choice, 90 to 93 % were
    predicted within a factor of 1.25. With values fitted to half of the scenes, it was 89 to 95 %
    of each half.

    Attributes
    ----------
    noise
        Factor of the noise ratio times the root of voxel volume over PSF width, um. Measured as
        above.
    rims, noise_at_rims
        Factors of the PSF's width, and of the same product as ``noise``; each times the root of the
        share of the surface that lies within a PSF width of a rim. Measured as above.
    voxels
        Error in voxels. Measured as above.
    triangles
        Factor of the distance at which flat triangles lie from the surface. Measured as above.
    curvature
        Of 1 over the radius of a ball as large as the cell: cells are less round. Chosen, not
        measured.
    rendered, power
        Voxels at an accuracy of 0.1, and how they grow (docs/accuracy.md).
    unsettled
        Of tolerance times PSF width: tolerances and accuracies of 0.1 together added 3 to 6 nm.
    quick_edges, quick_tolerance, quick_trials
        Of the edges that seeds come with; widths of the PSF; whether other neighbours are tried at
        the end. Chosen: half the triangles. Trials took half of the time of twelve foams of 16 and
        32 cells, mended 17 of 69 wrong contacts, and brought the surface no nearer
        (benchmarks.clusters).
    flat, flattest
        Share of the noise that triangles may add where a surface is more curved than a ball; share
        of the PSF's width that they may be off where there is hardly any noise. Chosen: added in
        squares, the first adds 10 % to the noise.
    careful_share, careful_tolerance
        Share of the noise that triangles may add; widths of the PSF. Chosen: added in squares, the
        first adds 5 % to the noise.
    finest, longest
        Edges: of the PSF's narrowest width; of the radius of the cell.
    shares
        Of what a number leaves beside the noise: for triangles, rendering and tolerance.
    """

    noise: float = 0.9
    rims: float = 0.135
    noise_at_rims: float = 4.0
    voxels: float = 0.034
    triangles: float = 0.6
    curvature: float = 1.15
    rendered: float = 0.03
    power: float = 1.25
    unsettled: float = 0.15
    quick_edges: float = 1.5
    quick_tolerance: float = 0.1
    quick_trials: bool = False
    flat: float = 0.45
    flattest: float = 0.005
    careful_share: float = 0.315
    careful_tolerance: float = 0.01
    finest: float = 0.7
    longest: float = 0.35
    shares: tuple[float, float, float] = (0.8, 0.4, 0.4)


RULES = DialRules()
_TOLERANCES = 0.005, 0.1  # bounds; chosen, not measured
_RENDERED_AT = 0.1  # accuracy at which ``rendered`` was measured
_SAME_EDGES = 0.1  # chosen: triangles of one mesh differ by more


@dataclass(frozen=True)
class Dialled:
    """What a choice on the dial stands for.

    Attributes
    ----------
    edge
        um; of triangles.
    accuracy
        Of images.
    tolerance
        Widths of the PSF.
    predicted
        um: mean distance to the true surface that is to be expected.
    trials
        Whether other neighbours are tried at the end.
    flatness
        um: how far flat triangles may lie from the surface; None: edges are alike everywhere.
    """

    edge: float
    accuracy: float
    tolerance: float
    predicted: float
    trials: bool = True
    flatness: float | None = None


@dataclass(frozen=True)
class Situation:
    """What a prediction rests on: noise ratio, voxel size, PSF width, radius, edges; um.

    rims : share of the surface that lies within a PSF width of where walls meet.
    """

    noise: float
    voxel: float
    width: float
    radius: float
    edge: float
    rims: float = 0.0

    @classmethod
    def of(cls, mesh: Mesh, grid: Grid, sigma: tuple[float, ...], noise: float) -> Situation:
        """The situation of a start, and of an image with this noise ratio."""
        sizes = np.abs([v for v in mesh.volumes().values() if np.isfinite(v)])
        volume = float(np.median(sizes)) if len(sizes) and np.median(sizes) > 0 else np.inf
        voxel = geometric_mean(grid.voxel_size)
        radius = float(ball_radius(volume))
        width = geometric_mean(sigma)
        of_rims = float(mesh.edge_lengths()[mesh.edge_uses() > 2].sum())
        rims = min(1.0, of_rims * width / max(float(mesh.areas().sum()), 1e-300))
        return cls(noise, voxel, width, radius, mesh.median_edge(), rims)

    def floor(self) -> float:
        """um: what noise contributes, away from rims."""
        return RULES.noise * self._scatter

    def fixed(self) -> float:
        """um: all that no setting changes: noise, rims, and voxels."""
        s, share = RULES, sqrt(self.rims)
        at_rims = share * s.rims * self.width, share * s.noise_at_rims * self._scatter
        parts = self.floor(), *at_rims, s.voxels * self.voxel
        return float(np.sqrt(np.square(parts).sum()))

    @property
    def _scatter(self) -> float:
        """um: how far noise scatters a surface, up to a factor."""
        return self.noise * sqrt(self.voxel**3 / self.width)

    def predicted(self, edge: float, accuracy: float, tolerance: float) -> float:
        """um: mean distance to the true surface."""
        s = RULES
        parts = (
            self.fixed(),
            s.triangles * TRIANGLES.chord * edge**2 * s.curvature / self.radius,
            s.rendered * self.voxel * (accuracy / _RENDERED_AT) ** s.power,
            s.unsettled * tolerance * self.width,
        )
        return float(np.sqrt(np.square(parts).sum()))

    def edge_for(self, part: float) -> float:
        """um: edges whose triangles add no more than ``part``, um."""
        s = RULES
        wanted = sqrt(part * self.radius / (s.triangles * TRIANGLES.chord * s.curvature))
        return max(min(wanted, s.longest * self.radius), s.finest * self.width)


def dialled(choice: str, now: Situation) -> Dialled:
    """What quick, normal, careful, or a length such as 20nm stand for.

    Raises
    ------
    InputError
        For anything else.
    """
    s, asked = RULES, asked_error(choice)
    flatness: float | None = s.flat * now.floor() / s.triangles
    if asked is not None:
        edge, accuracy, tolerance, flatness = _for_length(asked, now)
    else:
        accuracy = preset_accuracy(choice, now.noise)
        edge, tolerance = now.edge, FitSettings().tolerance
        if choice == "quick":
            edge = max(edge, min(s.quick_edges * edge, s.longest * now.radius))
            tolerance, flatness = s.quick_tolerance, None
        elif choice == "careful":
            edge = min(edge, now.edge_for(s.careful_share * now.floor()))
            tolerance, flatness = s.careful_tolerance, s.careful_share * now.floor() / s.triangles
    predicted = now.predicted(edge, accuracy, tolerance)
    trials = choice != "quick" or RULES.quick_trials
    if flatness is not None:
        flatness = float(f"{max(flatness, s.flattest * now.width):.2g}")
    return Dialled(edge, accuracy, tolerance, predicted, trials, flatness)


def _for_length(asked: float, now: Situation) -> tuple[float, float, float, float]:
    s = RULES
    fixed = now.fixed()
    rest = sqrt(max(asked**2 - fixed**2, (s.careful_share * now.floor()) ** 2, 1e-18))
    triangles, rendering, settling = (share * rest for share in s.shares)
    accuracy = _RENDERED_AT * (rendering / (s.rendered * now.voxel)) ** (1 / s.power)
    accuracy = min(max(accuracy, FINEST), COARSEST)
    tolerance = settling / (s.unsettled * now.width)
    return (
        now.edge_for(triangles),
        float(f"{accuracy:.2g}"),
        float(f"{min(max(tolerance, _TOLERANCES[0]), _TOLERANCES[1]):.2g}"),
        triangles / s.triangles,
    )


def with_edges(mesh: Mesh, edge: float) -> Mesh:
    """The start with edges of about that length; itself where it has them, or cannot change."""
    now = mesh.median_edge()
    if not (can_remesh() and now > 0) or abs(edge / now - 1) < _SAME_EDGES:
        return mesh
    try:
        return remesh(mesh, edge, apart=True).mesh
    except InputError:
        return mesh
