"""Membranes or insides of cells so small that their light is spread alike.

A membrane lies at 0.77 of the radius of an inside whose image is like its own: there the other of
the two begins, and takes a few steps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...common.ball import ball_radius
from ...common.choices import DensityModel, Structure
from ...geometry.mesh import FloatArray, Mesh
from ..model.fitted import Fitted
from ..objective.fit_objective import Terms
from ..solvers.preconditioner import Preconditioners
from .gains import gains_over
from .rival_structures import RULES, begun, descend_and_pose_anew, gains_exceed_error, moved_in

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
