"""The lengths by which topology is changed, and why they are what they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ChangeSizes:
    """Sizes that decide how changes of topology are made; lengths are in edges.

    Attributes
    ----------
    around, around_known
        Cut out around a place: the part made anew (``free``), and beyond it more than what its
        pieces are compared with, so that a change looks at no other vertex. Walls, junctions and
        pieces are known face by face and compared with nothing: beyond ``free`` only the edge by
        which its vertices may move is looked at, and the longest face that may reach in there.
    free, passes
        Around a place in which triangles are made anew, and how often: less leaves slivers at the
        rim.
    most_walls
        That meet in an edge, unless more did before: where four meet, two junctions would be one
        (J. Plateau), which a fit has no way to part.
    opened
        Sides of an exchange are drawn apart by the first of these that makes no surfaces cross:
        the wider, the better the triangles. They were chosen by eye, each about half of the one
        before.
    counterpart
        What has none within is left where it is: no point of an even triangle is further than 0.58
        edges from a corner, so what is further has none.
    along
        Points of a junction edge in which the nearest is looked for: right to a sixteenth of it.
    across, facing
        Cosines: the way to the other side runs along its normal within 45 degrees, and both sides
        look away from each other by 120 degrees or more; else a fold would pass for a thin place.
    fewest
        Vertices that make a place: a single one is a spike, which smoothing takes.
    thinned
        How far from a thin place what faces each other goes, and how far apart the parts of the
        place are that go together: the first that works, the plainest first.
    growing
        Rounds in which a patch grows by a ring until its border is simple: a thin place that needs
        more is no small change.
    voxels, nodes
        Along an edge, of labels and of the mesh made of them: two nodes an edge are what an edge
        can show, and labels are finer so that walls do not follow their steps.
    most_voxels
        Of labels, or clusters with long edges would fill the memory (120 MB).
    room
        Around cells, so that no surface is cut off by the border of the labels.
    new, old
        Nearer than the first to a change the surface is new, beyond the second the old one: an edge
        in between, or the seam would have slivers.
    """

    around: float = 5.0
    around_known: float = 3.5
    free: float = 2.0
    passes: int = 2
    most_walls: int = 3
    opened: tuple[float, ...] = (0.3, 0.12, 0.06, 0.03)
    counterpart: float = 0.7
    along: int = 8
    across: float = 0.7
    facing: float = -0.5
    fewest: int = 2
    thinned: tuple[tuple[float, float], ...] = (
        (1.2, np.inf),
        (0.9, 2.5),
        (1.6, np.inf),
        (0.9, 1.0),
        (1.6, 1.0),
    )
    growing: int = 20
    voxels: float = 3.0
    nodes: float = 2.0
    most_voxels: int = 30_000_000
    room: float = 3.0
    new: float = 1.5
    old: float = 2.5


SIZES = ChangeSizes()
