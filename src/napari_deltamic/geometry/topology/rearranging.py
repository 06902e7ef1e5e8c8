"""Changes topology: thin places give way, and small walls, junctions and pieces vanish.

Only a part of the mesh around each place is examined and changed; all other vertices stay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ..contacts import between_cells
from ..mesh import IntArray, Mesh
from .change_sizes import SIZES
from .events import Shapes, change_events, surface_shape
from .flips import flipped
from .small_pieces import absorbed
from .submesh import (
    Census,
    Change,
    Cutter,
    Submesh,
    evened_around,
    fits,
    narrowed,
    put_back,
    unchanged,
)
from .thin_places import ThinPlace
from .thinning import thinned


@dataclass(frozen=True, eq=False)
class Rearranged:
    """A mesh whose topology has changed.

    Attributes
    ----------
    mesh
        The mesh, of the same regions.
    events
        A sentence for each thing that happened; none if nothing has changed.
    hopeless
        The places that cannot give way: a region would vanish, surfaces would cross, or nothing
        would change. Places that are in neither were not tried one by one.
    origin
        (V,) the old vertex that each one equals, or -1 if it is new, by which values at vertices
        can be carried over. None if nothing has changed.
    """

    mesh: Mesh
    events: tuple[str, ...]
    hopeless: tuple[ThinPlace, ...] = ()
    origin: IntArray | None = None


def give_way(mesh: Mesh, places: Sequence[ThinPlace], edge: float) -> Rearranged:
    """Let thin places of a mesh give way, so that what lies on their two sides meets there.

    A gap between two cells becomes a wall, a hole closes, a neck is pinched off, and where a cell
    is thin between two others, these become neighbours. A small wall vanishes, the cells at the
    ends of a short junction come to touch, and a small piece goes to a neighbour. Nothing changes
    beyond a few edge lengths around the places.

    Parameters
    ----------
    mesh
        Closed regions that do not cross there.
    places
        From :func:`thin_places`, :func:`small_walls`, :func:`short_junctions` and
        :func:`small_pieces`.
    edge
        um: the edge length of the mesh.
    """
    if not places:
        return Rearranged(mesh, ())
    meant = {pair for place in places for pair in combinations(place.sides, 2)}
    state = _State(unchanged(mesh), Census.of(mesh), meant)
    # Thin places last: the others are known exactly, and may change with what they touch.
    waiting = sorted(places, key=lambda place: place.is_thin)
    while waiting:
        waiting = _round(state, waiting, edge)
    if not state.events:
        return Rearranged(mesh, (), tuple(state.hopeless))
    done = state.change
    events = tuple(dict.fromkeys(state.events))
    return Rearranged(done.mesh, events, tuple(state.hopeless), done.origin)


@dataclass
class _State:
    """What has been done so far; meant : contacts that may appear."""

    change: Change
    census: Census
    meant: set[tuple[int, int]]
    events: list[str] = field(default_factory=list)
    hopeless: list[ThinPlace] = field(default_factory=list)


def _round(state: _State, waiting: list[ThinPlace], edge: float) -> list[ThinPlace]:
    """Change places whose surroundings are unchanged in this round; return the others."""
    mesh = state.change.mesh
    cutter, taken = Cutter(mesh), np.zeros(len(mesh.faces), bool)
    later: list[ThinPlace] = []
    done: list[tuple[Submesh, Change]] = []
    for place in waiting:
        reach = (SIZES.around if place.is_thin else SIZES.around_known) * edge
        low, high = place.points.min(0) - reach, place.points.max(0) + reach
        rows = cutter.faces_in(low, high)
        if taken[rows].any():
            later.append(place)
            continue
        made = _given_way(state, cutter, rows, place, edge)
        if made is None:
            state.hopeless.append(place)
        else:
            done.append(made)
            taken[made[0].rows] = True
    if done:
        state.change = state.change.then(put_back(mesh, done))
    return later


def _given_way(
    state: _State, cutter: Cutter, rows: IntArray, place: ThinPlace, edge: float
) -> tuple[Submesh, Change] | None:
    """Let a place in some faces give way, if that changes what it should and nothing else."""
    if not len(rows):
        return None
    part = cutter.part(rows)
    for rough in _ways(part, place, edge):
        if not _wanted(state, place, state.census.with_part(part.mesh, rough.mesh)):
            continue
        change = evened_around(part, rough, place.points, edge)
        after = state.census.with_part(part.mesh, change.mesh)
        if min(after.volumes.values()) <= 0 or not fits(part, change):
            continue
        small = narrowed(part, change)
        shapes = _shapes(cutter.mesh, small, place)
        said = change_events(state.census, after, place, shapes)
        if said:
            state.census = after
            state.events += said
            return small
    return None


def _ways(part: Submesh, place: ThinPlace, edge: float) -> Iterator[Change]:
    """Yield what the part may become; triangles are not good yet."""
    if place.is_thin:
        return thinned(part, place, edge)
    return (absorbed if place.volume else flipped)(part, place, edge)


def _wanted(state: _State, place: ThinPlace, after: Census) -> bool:
    """Whether a change keeps every region and adds no contacts but those that may appear."""
    if after.regions != state.census.regions:
        return False
    gained = between_cells(after.walls.keys() - state.census.walls.keys())
    return not (place.is_thin and gained - state.meant)


def _shapes(mesh: Mesh, small: tuple[Submesh, Change], place: ThinPlace) -> Shapes | None:
    """Return the shape of a cell with a neck or a hole before and after; None for other places."""
    if not place.is_thin or len(place.sides) > 1:
        return None
    cell = place.regions[0] or place.sides[0]
    whole = put_back(mesh, [small]).mesh
    return surface_shape(mesh, cell), surface_shape(whole, cell)
