"""Bright things in an image that no cell explains: cells without seeds, or no cells at all."""

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
    """When a bright thing counts as one without a cell.

    Attributes
    ----------
    away
        Least distance from every surface, widths of the PSF: what lies nearer is a surface that is
        off. Light of a surface is blurred over three widths (``residual``).
    together
        Share of the diameter of a typical cell: places nearer to each other belong together, since
        a membrane without a cell is bright in many places.
    most
        Most things that the user is told of, the brightest first. Chosen, not measured.
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
        Where it is brightest, um, Z Y X.
    z
        Deviation there in standard deviations of the noise.
    middle
        Middle of what belongs to it, um, Z Y X; if that is the membrane of a cell, its inside.
    """

    position: tuple[float, float, float]
    z: float
    middle: tuple[float, float, float]


def strays(spots: Sequence[Spot], mesh: Mesh, optics: Optics) -> tuple[Stray, ...]:
    """The bright things among the spots of a residual that have no surface near or around them.

    What is bright within a cell, such as the chromatin of a nucleus, belongs to the cell.

    Parameters
    ----------
    spots
        Spots of the whole image, see :func:`.residual.analyse_residual`.
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
