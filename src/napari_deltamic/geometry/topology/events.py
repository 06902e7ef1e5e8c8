"""What happened to the topology of a mesh, in words."""

from __future__ import annotations

from ..connected import pieces
from ..mesh import OUTSIDE, Mesh
from .submesh import Census
from .thin_places import ThinPlace

Shape = tuple[int, int]  # pieces of a surface, and its Euler characteristic
Shapes = tuple[Shape, Shape]  # before and after


def change_events(
    before: Census, after: Census, place: ThinPlace, shapes: Shapes | None
) -> tuple[str, ...]:
    """Say what a change of topology has done; nothing if neighbours and shapes are as before.

    Parameters
    ----------
    before, after
        Census of the mesh.
    place
        Where it has changed.
    shapes
        Shapes before and after of a cell with a neck or a hole at the place.
    """
    lost, gained = before.contacts - after.contacts, after.contacts - before.contacts
    said = []
    if lost and gained:
        said.append(f"neighbours exchanged: {_listed(lost)} lost, {_listed(gained)} gained")
    elif gained:
        said += [f"cell {a} touches cell {b}" for a, b in sorted(gained)]
    elif lost:
        said += [f"cell {a} lets go of cell {b}" for a, b in sorted(lost)]
    was, is_now = before.at_surface, after.at_surface
    said += [f"cell {k} comes to the surface" for k in sorted(is_now - was)]
    said += [f"cell {k} leaves the surface" for k in sorted(was - is_now)]
    if shapes is not None:
        (parts, euler), (parts_now, euler_now) = shapes
        cell = place.regions[0] or place.sides[0]
        if parts_now > parts:
            said.append(f"cell {cell} was pinched off into {parts_now} pieces")
        elif euler_now > euler:
            said.append(f"a hole in cell {cell} has closed")
    if place.volume:
        around = ", ".join(str(s) for s in place.sides if s != OUTSIDE)
        what = f"a piece of cell {place.regions[0]}" if place.regions[0] else "a gap"
        said.append(
            f"{what} between cells {around} has closed" if around else f"{what} has vanished"
        )
    if not said and len(place.regions) == 2:
        said.append("cells {1} and {0} part in one place".format(*place.regions))
    if not said and (place.is_gap or len(place.regions) == 3) and place.sides[0]:
        said.append("cells {} and {} touch in another place".format(*place.sides))
    return tuple(said)


def untangled_events(before: Census, after: Census, crossings: int) -> tuple[str, ...]:
    """Say what has become of crossing surfaces."""
    said = [
        f"cells {a} and {b} overlapped and now share a wall"
        for a, b in sorted(after.contacts - before.contacts)
    ]
    where = f"{crossings} crossing{'s' * (crossings > 1)} of surfaces removed"
    return tuple([where, *said])


def surface_shape(mesh: Mesh, region: int) -> Shape:
    """Return the number of pieces of a region's surface, and its Euler characteristic."""
    surface = mesh.region_surface(region)
    euler = len(surface.vertices) - len(surface.edges()) + len(surface.faces)
    return int(pieces(surface).max()) + 1, euler


def _listed(pairs: set[tuple[int, int]]) -> str:
    return ", ".join(f"{a}-{b}" for a, b in sorted(pairs))
