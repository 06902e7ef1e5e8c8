"""How the images of a fit change by displacements of single vertices along their normals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from ...geometry.mesh import FloatArray, IntArray
from ...scene import Grid
from ..model.variables import Variables
from ..objective.posterior import Posterior
from .directions import Directions

# Widths of the PSF, further than the triangles around a vertex reach. The standard deviation of the
# cow's volume (64^3, 40 photons) is 11.66 with 4 (238 colours), 11.67 with 3 (154), 11.77 with 2.5
# (120), 12.07 with 2 (97). Errors of surfaces in eight fits of 1 to 56 cells changed by 0.3 % at
# most from 3 to 2.5, which took 20 % less time.
_REACH = 2.5
# Widths of the PSF. A single vertex that leaves the surface adds area to second order: with 0.02
# that is a tenth of a column; the rounding of single precision is less than 1 % of it here.
_STEP = 0.004


@dataclass(frozen=True, eq=False)
class Colouring:
    """Vertices of one colour are so far apart that no voxel sees two of them.

    Attributes
    ----------
    colour
        (D,) from 0: of each direction of each vertex.
    reach
        Widths of the PSF: how far from a vertex voxels see it.
    places
        (D, 3) vertices in widths of the PSF.
    """

    colour: IntArray
    reach: float
    places: FloatArray

    @classmethod
    def of(
        cls,
        vertices: FloatArray,
        edges: IntArray,
        widths: FloatArray,
        each: IntArray | None = None,
    ) -> Colouring:
        """A greedy one.

        Parameters
        ----------
        vertices, edges
            (V, 3) um and (E, 2).
        widths
            (3,) um of the PSF, Z Y X.
        each
            (D,) vertices that get a colour, some several times; by default each once.
        """
        places = vertices / widths
        ends = places[edges]
        edge = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
        places = places if each is None else places[each]
        reach = _REACH + edge
        colour = np.full(len(places), -1, np.int64)
        for vertex, near in enumerate(cKDTree(places).query_ball_point(places, 2 * reach)):
            taken = colour[near]
            used = np.zeros(len(near) + 1, bool)
            used[taken[(taken >= 0) & (taken < len(used))]] = True
            colour[vertex] = int(np.argmin(used))
        return cls(colour, reach, places)

    @property
    def count(self) -> int:
        """How many colours there are."""
        return int(self.colour.max(initial=-1)) + 1


def normal_jacobian(
    posterior: Posterior, at: Variables, directions: Directions, colouring: Colouring
) -> list[sp.csr_matrix]:
    """(N, D) of each view: derivatives of its rendering by displacements along directions, 1/um.

    Vertices of one colour are moved together, and each voxel's change belongs to the one within
    reach: one rendering for each colour (A. R. Curtis, M. J. D. Powell, J. K. Reid, "On the
    estimation of sparse Jacobian matrices", 1974). Amplitude 1, what shines as it is there; rows
    are the voxels that count.

    Parameters
    ----------
    posterior, at
        The objective and where.
    directions
        Of the vertices there.
    colouring
        Of the directions.
    """
    light = posterior.light(at)
    base = posterior.images(at, light)
    widths = widest_psf(posterior)
    step = _STEP * float(widths.min())
    views = [
        _seen(posterior.level.grid, view.voxels.index.cpu().numpy(), widths, colouring)
        for view in posterior.views
    ]
    parts: list[list[FloatArray]] = [[] for _ in views]
    order = np.argsort(colouring.colour, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(colouring.colour))[:-1])
    for group in groups:
        vertices = at.vertices.copy()
        vertices[directions.vertex[group]] += step * directions.way[group]
        moved = posterior.images(replace(at, vertices=vertices), light)
        for part, seen, now, before in zip(parts, views, moved, base, strict=True):
            change = (now - before) / step
            part += [change[seen[one]] for one in group]
    return [
        _matrix(part, seen, order, len(before))
        for part, seen, before in zip(parts, views, base, strict=True)
    ]


def widest_psf(posterior: Posterior) -> FloatArray:
    """(3,) um: the widest of the blurred PSFs of all images along each axis."""
    own = posterior.prior.imaging.optics.sigma_um
    all_of_them = [own, *(v.optics.sigma_um for v in posterior.views if v.optics is not None)]
    return np.max(np.asarray(all_of_them, float), axis=0) * posterior.level.factor


def _seen(grid: Grid, index: IntArray, widths: FloatArray, colouring: Colouring) -> list[IntArray]:
    """For each direction, rows of the voxels that see its vertex."""
    at = np.stack(np.unravel_index(index, grid.shape), 1)
    centres = (at * np.asarray(grid.voxel_size) + np.asarray(grid.origin)) / widths
    found = cKDTree(centres).query_ball_point(colouring.places, colouring.reach)
    return [np.asarray(rows, np.int64) for rows in found]


def _matrix(
    parts: list[FloatArray], seen: list[IntArray], order: IntArray, rows: int
) -> sp.csr_matrix:
    counts = np.array([len(seen[vertex]) for vertex in order])
    column = np.repeat(order, counts)
    row = np.concatenate([seen[vertex] for vertex in order])
    shape = rows, len(order)
    return sp.coo_matrix((np.concatenate(parts), (row, column)), shape).tocsr()
