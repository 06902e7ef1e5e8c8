"""Membranes or insides of cells so small that their light is spread alike.

A membrane lies at 0.77 of the radius of an inside whose image is like its own: there the other of
the two begins, and takes a few steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...common.ball import ball_radius
from ...common.choices import DensityModel, Structure
from ...geometry.mesh import FloatArray, Mesh
from ..model.amplitudes import all_small
from ..model.fitted import Fitted
from ..objective.fit_objective import Objective, Terms
from ..solvers.preconditioner import Preconditioners
from .gains import gains_over
from .rival_structures import RULES, begun, descend_and_pose_anew, gains_exceed_error, moved_in

# Of what insides are tried instead of membranes for: radius over 2.5 widths of the PSF, and widths
# of the PSF in plane, voxels. Chosen; measured: 0.7 to 1.12 and 1.0 to 2.0 in fits of nuclei that
# had ended as membranes, 1.35 and more in most membranes.
_SMALL, _FINEST = 1.2, 2.0
_LEGS = 2  # of RULES.steps; chosen: further ones changed what is left by 1 to 3 %
_AS_MUCH = 1.0  # by definition: times what membranes leave
_ALIKE = (3 / 5) ** 0.5  # exact: of a ball and a sphere with equal second moments


def nearer_of(terms: Terms, fitted: Fitted) -> Structure:
    """Membranes or insides of equal brightness: whose image comes nearer, with the shape as it is.

    For cells so small that either, with a shape of its own, explains the image as well; where they
    start is what is known of their size. terms, fitted : as they begin.
    """
    terms = replace(terms, imaging_fitted=False, density_fitted=False)
    plain, factored = fitted.with_density("uniform"), Preconditioners()
    alone: tuple[Structure, ...] = ("membrane", "interior")
    left = []
    for structure in alone:
        left.append(begun(terms, plain.with_structure(structure), factored).posed.left)
    return alone[int(np.argmin(left))]


def other_of_small(terms: Terms, fitted: Fitted) -> tuple[Fitted | None, int]:
    """The fit with the other of membranes and insides, if it surely explains more; evaluations.

    For small cells, whose light is spread alike where a membrane lies at 0.77 of the radius of an
    inside: there the other begins. Smooth membranes follow chromatin, so insides have to explain
    more with what is uneven taken out; evened insides follow a membrane, so membranes have to
    explain more of what was measured, where that needed much evening.

    Measured on twelve fits from membranes: two of nuclei that began too small and had become
    membranes at a quarter of their volumes, 3.9 and 4.9 errors; three of nuclei that stay so, 2.1,
    2.3 and -1.3; at most 0.6 in the others. Of eight from insides, one of membranes at twice their
    volume: 2.8; the others had at most 2.5, and insides that need no evening (1.0 to 1.1).
    """
    factored = Preconditioners()
    stay, taken = descend_and_pose_anew(begun(terms, fitted, factored))
    rival, more = descend_and_pose_anew(begun(terms, other_alone(terms, fitted), factored))
    evened, measured = gains_over(rival, stay)
    if fitted.structure == "interior":
        surely = stay.unevenness() > RULES.hollow and gains_exceed_error([measured], RULES.clear)
    else:
        surely = gains_exceed_error([evened], RULES.errors)
    return (rival.fitted if surely else None), taken + more


def may_be_insides(fitted: Fitted, voxel_size: Sequence[float]) -> bool:
    """Whether cells fitted with membranes are so small that insides could look alike.

    Not through PSFs wider than microscopes sample: there the image does not tell. Of nine such
    membranes, of 1.5 to 2.2 PSF widths in radius, insides left 0.95 to 1.0 times as much in three.
    """
    across = np.sqrt(np.prod(fitted.optics.sigma_um[1:]) / np.prod(voxel_size[1:]))
    return bool(across <= _FINEST) and all_small(fitted.mesh, fitted.optics, _SMALL)


def insides_as_well(terms: Terms, objective: Objective) -> tuple[Fitted | None, int]:
    """At rest, insides instead of the membranes of small cells, if they may do; and evaluations.

    A membrane seen through a wider PSF looks like an inside, but not the other way round. So where
    nobody has said how wide the PSF is, insides begin anew where their light is spread alike, and
    are taken if they leave no more. Measured at rest, after two legs: 0.81 to 0.99 times as much in
    14 fits of nuclei that had ended as membranes with 0.3 to 0.4 of their volume, 1.002 to 1.7 in
    20 of membranes. Nuclei with chromatin can leave more: 1.05 and 1.06 in two that stay membranes.
    """
    stay, factored, taken = objective.anew(), Preconditioners(), 0
    rival = begun(terms, other_alone(terms, objective.fitted), factored)
    for _ in range(_LEGS):
        rival, more = descend_and_pose_anew(rival)
        taken += more
    may = rival.leaves_over(stay) <= _AS_MUCH
    return (rival.fitted if may else None), taken + stay.evaluations()


def other_alone(terms: Terms, fitted: Fitted) -> Fitted:
    """The other of membranes and insides, where its light is spread as that of this one is.

    Membranes are compared with one brightness for each wall, or for all: a smooth one follows
    chromatin. Measured on fifteen nuclei, 6 voxels wide: it ended with 0.36 of their volumes, and
    99 % explained. What goes on has the density that was asked for.
    """
    outer = fitted.structure == "interior"
    depth = _radii(fitted.mesh) * (1 - (_ALIKE if outer else 1 / _ALIKE))
    vertices = moved_in(fitted.shape, depth, terms.settings.collisions)
    moved = fitted.displaced(vertices, fitted.first_optics)
    if outer:
        even: DensityModel = "uniform" if terms.settings.density == "uniform" else "interface"
        return moved.with_structure("membrane").with_density(even)
    return moved.with_structure("interior")


def _radii(mesh: Mesh) -> FloatArray:
    """(V, 1) um: of the ball as large as the smallest cell at each vertex."""
    volumes = mesh.volumes()
    names = np.array(sorted(volumes))
    radius = ball_radius([abs(volumes[name]) for name in names.tolist()])
    # Of the outside, 0, the search finds the first cell.
    beside = np.where(mesh.regions > 0, radius[np.searchsorted(names, mesh.regions)], np.inf)
    found = np.full(len(mesh.vertices), np.inf)
    for corner in range(3):
        np.minimum.at(found, mesh.faces[:, corner], beside.min(1))
    return found[:, None]
