"""Bright things of an image that no cell explains: cells without a start, or none at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import cKDTree

from ..common.ball import ball_radius
from ..common.triple import triple
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from ..optics import Optics
from .residual import Spot


@dataclass(frozen=True)
class StrayRules:
    """What makes a bright thing one that has no cell.

    Attributes
    ----------
    away
        Widths of the PSF from every surface: what lies nearer is a surface that is off. Those of
        a surface are blurred over three widths (``residual``).
    together
        Of the diameter of the typical cell: places nearer to each other are of one thing, as a
        membrane without a cell is bright in many places.
    most
        Things told, the brightest first.
    """

    away: float = 3.0
    together: float = 1.0
    most: int = 20


RULES = StrayRules()


@dataclass(frozen=True)
class Stray:
    """A bright thing without a cell.

    Attributes
    ----------
    position
        um, Z Y X: where it is brightest.
    z
        Standard deviations of the noise there.
    middle
        um, Z Y X: of what belongs to it; the inside of a cell, where that is its membrane.
    """

    position: tuple[float, float, float]
    z: float
    middle: tuple[float, float, float]


def strays(spots: Sequence[Spot], mesh: Mesh, optics: Optics) -> tuple[Stray, ...]:
    """The bright things among the places of a residual that no surface lies near, or around.

    What is bright within a cell, such as the chromatin of a nucleus, is the cell's.

    Parameters
    ----------
    spots
        Of the whole image, see :func:`.residual.analyse_residual`.
    mesh
        The surfaces of the fit.
    optics
        The PSF.
    """
    bright = [spot for spot in spots if spot.z > 0]
    if not bright:
        return ()
    sigma = np.asarray(optics.sigma_um)
    places = np.array([spot.position for spot in bright])
    near, _ = cKDTree(mesh.vertices_numpy() / sigma).query(places / sigma)
    kept = np.array([k for k in np.flatnonzero(near > RULES.away) if not _within(mesh, places[k])])
    if not len(kept):
        return ()
    regions = np.unique(mesh.regions[mesh.regions > 0]).tolist()
    volume = float(np.median([abs(mesh.region_volume(region)) for region in regions]))
    reach = RULES.together * 2 * float(ball_radius(volume))
    groups = np.ones(1, int)
    if len(kept) > 1:
        groups = fcluster(linkage(places[kept], "single"), reach, "distance")
    found = []
    for group in np.unique(groups):
        own = kept[groups == group]
        brightest = max(own, key=lambda k: bright[k].z)
        middle = np.mean([bright[k].middle for k in own], axis=0)
        # Between things around a cell lies the cell.
        inner = places[brightest] if _within(mesh, middle) else middle
        found.append(Stray(triple(places[brightest]), bright[brightest].z, triple(inner)))
    return tuple(sorted(found, key=lambda stray: -stray.z)[: RULES.most])


def _within(mesh: Mesh, place: NDArray[np.float64]) -> bool:
    """Whether a place (3,) um lies in a cell."""
    z, y, x = place.tolist()
    return bool(voxel_labels(mesh, (1, 1, 1), (1.0, 1.0, 1.0), (z, y, x)).any())
