"""Steps that never make surfaces cross."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np

from ...geometry.compiled import native
from ...geometry.mesh import Mesh
from ...geometry.topology.crossings import CrossingWalls
from ...geometry.vectors import lengths

# As shares of the median edge:
_LONG = 2.0  # longer steps are checked in parts, whose swept boxes overlap fewer others
# Pairs further apart do not matter, and at most half of it is moved without a look; or of the
# longest edge at a vertex, where that is shorter. It only decides how often pairs are looked for.
_NEAR = 0.25
_CONTACT = 1e-3  # surfaces this near that approach each other stop, or the gap would go to nothing
_TOUCH = 1e-9  # as good as crossing: nearer than rounding would tell
# Of the way to where it should go: a vertex that is left with more has been held back. Half and
# twice change nothing in small fits, as measured.
_SHORT = 0.1
# Counts:
_PARTS = 8  # at most; what is longer still is cut, since every part is a look
# Steps after which it is asked anew whether a surface crosses: looks at all pairs would be many.
_AGAIN = 10


class CollisionGuard:
    """Shortens the steps of vertices whose faces would otherwise run into others.

    Where the step is free of collisions it is taken to the bit; else the vertices of each pair
    that collides stop before that, and the rest goes on: one vertex in a narrow place does not hold
    back the others. Only vertices that have used up what they may move freely, half of the distance
    to the nearest pair, are looked at (``csrc/proximity.h``).

    Surfaces that cross already are left alone, that is the pairs of walls that do; all others are
    guarded. Without the compiled extension nothing is.

    Parameters
    ----------
    active
        False: leave all steps alone.

    Attributes
    ----------
    held
        (V,) steps in a row in which each vertex was held back.
    """

    def __init__(self, active: bool = True) -> None:
        self._library: Any = native() if active else None
        self._told: set[tuple[int, ...]] = set()
        self._remark = ""
        self.held = np.zeros(0, np.int64)

    def watch(self, mesh: Mesh) -> None:
        """Go on with this mesh, which may cross itself."""
        if len(self.held) != len(mesh.vertices):
            self.held = np.zeros(len(mesh.vertices), np.int64)
        if self._library is None:
            return
        self._steps = 0
        self._mesh = mesh
        self._edge = max(mesh.median_edge(), 1e-9)  # only no division by 0
        self._crossing = CrossingWalls(mesh)
        self._guard = self._library.Guard(
            np.ascontiguousarray(mesh.edges(), np.int64),
            np.ascontiguousarray(mesh.faces, np.int64),
            _NEAR * np.minimum(_longest_edges(mesh), self._edge),
            _CONTACT * self._edge,
            _TOUCH * self._edge,
            self._crossing.wall,
            np.ascontiguousarray(self._crossing.pairs.reshape(-1), np.uint8),
        )
        new = self._crossing.regions - self._told
        if new:
            self._told |= new
            self._remark = _sentence(new)

    @property
    def work(self) -> int:
        """Couples of boxes and distances looked at since it began to watch the mesh."""
        return int(self._guard.work)

    def remark(self) -> str:
        """What there is to tell, once: which regions cross."""
        told, self._remark = self._remark, ""
        return told

    def allows(self, mesh: Mesh) -> bool:
        """Whether another triangulation crosses no more than the present one does."""
        if self._library is None:
            return True
        return CrossingWalls(mesh).regions <= self._crossing.regions

    def limited(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """The point nearest to the end that each vertex may reach from the start.

        Parameters
        ----------
        start, end
            (V, 3) um, of the mesh that is watched.

        Returns
        -------
        (V, 3) um; ``end`` itself where nothing collides.
        """
        if self._library is None or not np.isfinite(end).all():
            return end
        self._steps += 1
        if self._crossing and self._steps % _AGAIN == 0:
            self.watch(self._mesh.with_vertices(start))
        length = lengths(end - start)
        parts = ceil(float(length.max()) / (_LONG * self._edge))
        aim = end
        if parts > _PARTS:
            parts = _PARTS
            longest = _PARTS * _LONG * self._edge
            share = np.minimum(1.0, longest / np.maximum(length, longest))
            aim = start + share[:, None] * (end - start)
        place, free = start, aim is end
        for left in range(max(parts, 1), 0, -1):
            next_place = aim if left == 1 and free else place + (aim - place) / left
            reached, count = self._guard.limit(
                np.ascontiguousarray(place), np.ascontiguousarray(next_place)
            )
            free = free and count == 0
            place = reached if count else next_place
        if free:
            self.held[:] = 0
            return end
        stopped = (np.abs(place - aim) > _SHORT * np.abs(aim - start)).any(1)
        self.held = np.where(stopped, self.held + 1, 0)
        return place


def _longest_edges(mesh: Mesh) -> np.ndarray:
    """(V,) um."""
    longest = np.zeros(len(mesh.vertices))
    np.maximum.at(longest, mesh.edges().ravel(), np.repeat(mesh.edge_lengths(), 2))
    return longest


def _sentence(regions: set[tuple[int, ...]]) -> str:
    """Tell the user which regions cross."""
    alone = ", ".join(str(r[0]) for r in sorted(regions) if len(r) == 1)
    pairs = ", ".join(f"{r[0]} and {r[1]}" for r in sorted(regions) if len(r) == 2)
    parts = [f"the surface of region {alone} crosses itself"] if alone else []
    parts += [f"the surfaces of regions {pairs} cross"] if pairs else []
    return " and ".join(parts) + ": the fit goes on, but does not keep them apart"
