"""The regions that meet in vertices and edges, as sets that are fast to compare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..mesh import IntArray, Mesh

Keys = NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class RegionSets:
    """Sets of regions, one for each of many items, such as vertices or edges.

    Attributes
    ----------
    key
        (n,) uint64: a number that is the same for equal sets, and different for different ones but
        for a chance of one in 2^64.
    size
        (n,) number of regions in each set.
    members
        (m, 2) item and region, sorted.
    """

    key: Keys
    size: IntArray
    members: IntArray

    @staticmethod
    def gathered(things: IntArray, regions: IntArray, count: int) -> RegionSets:
        """Make sets from pairs of item and region, in any order and possibly repeated."""
        base = int(regions.max(initial=0)) + 1
        found = np.unique(things.reshape(-1) * base + regions.reshape(-1))
        thing, region = np.divmod(found, base)
        size = np.bincount(thing, minlength=count)
        key = np.zeros(count, np.uint64)
        first = np.flatnonzero(np.diff(thing, prepend=-1))
        if len(first):
            key[thing[first]] = np.add.reduceat(scrambled(region), first)
        return RegionSets(key, size, np.column_stack([thing, region]))

    @staticmethod
    def of_rows(regions: IntArray) -> RegionSets:
        """Return the set of regions in each row, (n, k)."""
        things = np.repeat(np.arange(len(regions)), regions.shape[1])
        return RegionSets.gathered(things, regions.reshape(-1), len(regions))

    def of(self, thing: int) -> tuple[int, ...]:
        """Return the sorted regions of one item."""
        first, last = np.searchsorted(self.members[:, 0], [thing, thing + 1])
        return tuple(self.members[first:last, 1].tolist())


def vertex_sets(mesh: Mesh) -> RegionSets:
    """Return the regions that meet in each vertex."""
    regions = np.repeat(mesh.regions, 3, axis=0)
    things = np.repeat(mesh.faces.reshape(-1), 2)
    return RegionSets.gathered(things, regions.reshape(-1), len(mesh.vertices))


def edge_sets(mesh: Mesh) -> RegionSets:
    """Return the regions that meet in each edge."""
    regions = np.repeat(mesh.regions, 3, axis=0)
    things = np.repeat(mesh.face_edges().reshape(-1), 2)
    return RegionSets.gathered(things, regions.reshape(-1), len(mesh.edges()))


def scrambled(regions: IntArray) -> Keys:
    """Return a 64-bit hash of each region's number (splitmix64).

    G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators",
    OOPSLA 2014.
    """
    z = (regions.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: Keys = z ^ (z >> np.uint64(31))
    return mixed
