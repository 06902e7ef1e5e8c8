"""What happened to the topology of a mesh, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from napari_deltamic.geometry.mesh import OUTSIDE, IntArray, Mesh
from napari_deltamic.geometry.topology.thin_places import ThinPlace

_CRUMB = 0.3  # edge lengths cubed: a piece not worth a word


def change_events(
    old: Mesh,
    new: Mesh,
    places: Sequence[ThinPlace],
    dropped: list[tuple[int, float]],
    edge: float,
) -> tuple[str, ...]:
    """What a change of topology has done; ``dropped``: regions of pieces, and their um^3."""
    lost, gained = contacts(old) - contacts(new), contacts(new) - contacts(old)
    said = []
    if lost and gained:
        said.append(f"neighbours exchanged: {_listed(lost)} lost, {_listed(gained)} gained")
    elif gained:
        said += [f"cell {a} touches cell {b}" for a, b in sorted(gained)]
    elif lost:
        said += [f"cell {a} lets go of cell {b}" for a, b in sorted(lost)]
    was, is_now = _at_surface(old), _at_surface(new)
    said += [f"cell {k} comes to the surface" for k in sorted(is_now - was)]
    said += [f"cell {k} leaves the surface" for k in sorted(was - is_now)]
    for cell in sorted({p.regions[0] or p.sides[0] for p in places if len(p.sides) == 1}):
        (pieces, euler), (pieces_now, euler_now) = _shape(old, cell), _shape(new, cell)
        if pieces_now > pieces:
            said.append(f"cell {cell} was pinched off into {pieces_now} pieces")
        elif euler_now > euler:
            said.append(f"a hole in cell {cell} has closed")
    for region, volume in dropped:
        if region != OUTSIDE and volume > _CRUMB * edge**3:
            said.append(f"a piece of cell {region} was pinched off and removed ({volume:.2g} um^3)")
    for place in places:
        if place.volume:
            around = ", ".join(str(s) for s in place.sides if s != OUTSIDE)
            what = f"a piece of cell {place.regions[0]}" if place.regions[0] else "a gap"
            gone = f"between cells {around} has closed" if around else "has vanished"
            said.append(f"{what} {gone}")
    if not said:
        parted = {p.regions for p in places if len(p.regions) == 2}
        said += [f"cells {a} and {b} part in one place" for b, a in sorted(parted)]
        joined = {p.sides for p in places if p.is_gap or len(p.regions) == 3}
        said += [f"cells {a} and {b} touch in another place" for a, b in sorted(joined) if a]
    return tuple(dict.fromkeys(said))


def untangled_events(old: Mesh, new: Mesh, found: IntArray) -> tuple[str, ...]:
    """What has come of crossings."""
    said = [
        f"cells {a} and {b} overlapped and now share a wall"
        for a, b in sorted(contacts(new) - contacts(old))
    ]
    where = f"{len(found)} crossing{'s' * (len(found) > 1)} of surfaces removed"
    return tuple([where, *said])


def _shape(mesh: Mesh, region: int) -> tuple[int, int]:
    """Pieces of a region's surface, and its Euler characteristic."""
    surface = mesh.region_surface(region)
    edges, n = surface.edges(), len(surface.vertices)
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(n, n))
    return int(connected_components(graph, directed=False)[0]), n - len(edges) + len(surface.faces)


def contacts(mesh: Mesh) -> set[tuple[int, int]]:
    """Pairs of cells that share a wall."""
    return {(int(min(p)), int(max(p))) for p in mesh.interfaces()[0] if min(p) != OUTSIDE}


def _at_surface(mesh: Mesh) -> set[int]:
    """Cells that meet the outside."""
    return {int(max(p)) for p in mesh.interfaces()[0] if min(p) == OUTSIDE}


def _listed(pairs: set[tuple[int, int]]) -> str:
    return ", ".join(f"{a}-{b}" for a, b in sorted(pairs))
