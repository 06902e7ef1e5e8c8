"""Remeshing: edges of a wanted length and good triangles, on surfaces with junctions."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log2

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ..errors import InputError
from .compiled import native
from .mesh import FloatArray, IntArray, Mesh
from .topology.crossings import crosses, crossing_corners

_TOUCH = 1e-6  # of the wanted length: surfaces as near to each other touch
# In longest edges, around crossings: where operations are checked, and where faces lie with which
# they might collide. Less than two edges around a vertex change with it.
_GUARDED, _SEEN = 3.0, 5.0
_PASSES = 3  # bring any mesh of about the right edge length into shape

# Mesh, edge lengths, passes, what vertices carry, which are held, and whether they move.
_Wanted = tuple[Mesh, FloatArray, int, FloatArray, np.ndarray, bool]


@dataclass(frozen=True, eq=False)
class Remeshed:
    """A remeshed mesh and what its vertices carried along.

    Attributes
    ----------
    mesh
        Of the same regions and interfaces; each face's larger region number first.
    carried
        (V, C): the numbers given for each vertex; means of those that were merged or split.
    fixed
        (V,) bool: the vertices that had to stay.
    origin
        (V,) the given vertex that each one is, moved or not; -1 for those that are new. What is
        left of the given ones keeps their order.
    """

    mesh: Mesh
    carried: FloatArray
    fixed: np.ndarray
    origin: IntArray


def can_remesh() -> bool:
    """Whether remeshing is possible: it needs the compiled extension."""
    return native() is not None


def remesh(
    mesh: Mesh,
    edge_length: float | ArrayLike,
    passes: int | None = None,
    *,
    carried: ArrayLike | None = None,
    fixed: ArrayLike | None = None,
    sealed: ArrayLike | None = None,
    smooth: bool = True,
    apart: bool = False,
) -> Remeshed:
    """Bring edges near a length and triangles near equilateral; regions and junctions stay.

    Long edges are split, short ones collapsed, diagonals flipped, vertices moved within the
    surface, so that volumes hardly change. Junctions are resampled along themselves; the points
    where they meet do not move. The operations are those of M. Botsch and L. Kobbelt, "A remeshing
    approach to multiresolution modeling", SGP 2004, with the link condition of T. K. Dey et al.,
    "Topology preserving edge contraction", 1999.

    Parameters
    ----------
    mesh
        Closed surfaces, with or without shared walls; open ones keep their borders.
    edge_length
        um; one number, or (V,) for each vertex.
    passes
        1 keeps a good mesh good; None: as many as the longest edge needs.
    carried
        (V, C) or (V,) numbers that vertices take along.
    fixed
        (V,) bool: vertices that neither move nor vanish.
    sealed
        (V,) bool: vertices that are fixed, and edges between two of them stay: the border along
        which a part was cut out of a mesh.
    smooth
        Whether vertices may move at all.
    apart
        Whether operations that would make surfaces cross are left out.

    Raises
    ------
    InputError
        If the length is not positive, arrays do not fit the mesh, or the compiled extension is
        missing.
    """
    if not can_remesh():
        raise InputError("remeshing needs the compiled extension: reinstall with a C++ compiler")
    n = len(mesh.vertices)
    length = np.broadcast_to(np.asarray(edge_length, np.float64), (n,))
    if not (np.isfinite(length).all() and (length > 0).all()):
        raise InputError("the edge length must be a positive number (um)")
    loads = np.zeros((n, 0)) if carried is None else np.asarray(carried, np.float64)
    if loads.ndim not in (1, 2) or len(loads) != n:
        raise InputError(f"carried must have a row for each of the {n} vertices")
    held = np.zeros(n, np.uint8)
    for value, name, given in ((1, "fixed", fixed), (2, "sealed", sealed)):
        if given is not None:
            if np.shape(given) != (n,):
                raise InputError(f"{name} must have one value for each of the {n} vertices")
            held[np.asarray(given, bool)] = value
    if passes is None:
        longest = float(mesh.edge_lengths().max())
        passes = _PASSES + max(0, ceil(log2(longest / float(length.min()))))
    wanted = mesh, length, passes, loads, held, smooth
    done = _remeshed(wanted, np.zeros(n, np.uint8), 0.0)
    return _kept_apart(done, wanted) if apart else done


def _kept_apart(done: Remeshed, wanted: _Wanted) -> Remeshed:
    """Remesh once more if surfaces have come to cross, and check each operation near there."""
    mesh, length, _, loads, held, _ = wanted
    near = _TOUCH * float(length.min())
    trouble = crossing_corners(done.mesh, near)
    if not len(trouble) or crosses(mesh):
        return done
    vertices = mesh.vertices_numpy()
    longest = float(max(mesh.edge_lengths().max(), length.max()))
    for last in (False, False, True):
        away = cKDTree(trouble).query(vertices)[0] / longest
        guard = np.where(away < _GUARDED, 2, np.where(away < _SEEN, 1, 0)).astype(np.uint8)
        if last:
            guard[:] = 2
        done = _remeshed(wanted, guard, near)
        found = crossing_corners(done.mesh, 0.0)
        if not len(found):
            return done
        trouble = np.concatenate([trouble, found])
    # What still crosses does so by rounding: the mesh stays as it was.
    return Remeshed(mesh, loads, held > 0, np.arange(len(vertices)))


def _remeshed(wanted: _Wanted, guard: np.ndarray, apart: float) -> Remeshed:
    mesh, length, passes, loads, held, smooth = wanted
    library = native()
    assert library is not None
    try:
        done = library.remesh(
            np.ascontiguousarray(mesh.vertices_numpy(), np.float64),
            np.ascontiguousarray(mesh.faces, np.int64),
            np.ascontiguousarray(mesh.regions, np.int64),
            np.ascontiguousarray(length),
            held,
            np.ascontiguousarray(loads.reshape(len(length), -1)),
            guard,
            int(passes),
            bool(smooth),
            float(apart),
        )
    except ValueError as error:  # more faces than fit the memory
        raise InputError(str(error)) from error
    vertices, faces, regions, held_now, loads_now, origin, _ = done
    shape = (len(vertices), *loads.shape[1:])
    return Remeshed(
        Mesh(vertices, faces, regions),
        loads_now.reshape(shape),
        held_now[:, 0] > 0,
        origin[:, 0],
    )


def smallest_angles(mesh: Mesh) -> FloatArray:
    """Return (F,) the smallest angle of each face, degrees; 0 if it has no area."""
    corners = mesh.vertices_numpy()[mesh.faces]
    to_next = np.roll(corners, -1, axis=1) - corners
    to_last = np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(to_next, to_last), axis=2)
    angles: FloatArray = np.degrees(np.arctan2(sine, (to_next * to_last).sum(2))).min(axis=1)
    return angles
