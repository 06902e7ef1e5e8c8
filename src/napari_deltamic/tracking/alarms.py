"""Checks whether cells have kept their identity, and which ones have gone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..common.ball import ball_radius
from ..fitting.surface.growth_alarm import shrunken
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import OUTSIDE, Mesh
from ..scene import Grid
from .track_rules import RULES


@dataclass(frozen=True)
class CellLook:
    """Volume (um^3) and centre (um) of a cell."""

    volume: float
    center: NDArray[np.float64]

    @property
    def radius(self) -> float:
        """Radius of the sphere of the same volume, um."""
        return float(ball_radius(max(self.volume, 0.0)))


def looks(mesh: Mesh) -> dict[int, CellLook]:
    """Return volume and centre of every cell."""
    found = {}
    vertices, per_face = mesh.vertices_numpy(), mesh.signed_volumes()
    middle = vertices.mean(axis=0)
    # A face and the mean vertex span a tetrahedron; this is its centre.
    centers = middle + (vertices[mesh.faces] - middle).sum(axis=1) / 4
    for cell in mesh.region_ids().tolist():
        inner, outer = (mesh.regions == cell).T
        weights = per_face * (inner.astype(np.float64) - outer)
        volume = float(weights.sum())
        own = np.unique(mesh.faces[inner | outer])
        center = weights @ centers / volume if volume > 0 else vertices[own].mean(axis=0)
        found[cell] = CellLook(volume, center)
    return found


def alarms(mesh: Mesh, expected: Mesh, before: dict[int, CellLook], grid: Grid) -> dict[int, str]:
    """Return the cells that may have lost their identity, and why, in plain words.

    Parameters
    ----------
    mesh, expected : the mesh after the fit, and where the fit started.
    before : the cells of the last good frame.
    """
    now, then = looks(mesh), looks(expected)
    shape = (grid.shape, grid.voxel_size, grid.origin)
    own, start = voxel_labels(mesh, *shape), voxel_labels(expected, *shape)
    found = {}
    least, most = RULES.alarms.volume
    for cell, look in now.items():
        if cell not in then:
            continue
        old = before.get(cell, then[cell])
        places = start[own == cell]
        others = places[(places != cell) & (places != OUTSIDE)]
        ratio = look.volume / max(old.volume, 1e-30)
        jump = float(np.linalg.norm(look.center - then[cell].center))
        if len(places) and len(others) > RULES.alarms.slid * len(places):
            taken = int(np.bincount(others).argmax())
            found[cell] = f"it is where cell {taken} should be"
        elif not least < ratio < most:
            found[cell] = f"its volume is {ratio:.2g} times what it was"
        elif jump > RULES.alarms.jump * then[cell].radius:
            found[cell] = f"it lies {jump:.2g} um from where it was expected"
    return found


@dataclass
class Volumes:
    """Volumes of the cells in the last good frames, um^3, from which usual changes are known."""

    _of: dict[int, list[float]] = field(default_factory=dict)
    _changes: list[float] = field(default_factory=list)

    def add(self, now: dict[int, CellLook]) -> None:
        """Add the cells of a good frame."""
        for cell, look in now.items():
            off = self._off(cell, look)
            self._changes += [] if off is None else [abs(off)]
            self._of[cell] = [*self._of.get(cell, []), look.volume][-RULES.alarms.remembered :]

    def jumps(self, now: dict[int, CellLook]) -> dict[int, str]:
        """Return the cells whose volume changes as none has before, and how, in plain words."""
        if len(self._changes) < RULES.alarms.known:
            return {}
        usual = RULES.alarms.unusual * float(np.median(self._changes))
        least, found = max(usual, np.log(RULES.alarms.change)), {}
        for cell, look in now.items():
            off = self._off(cell, look)
            if off is not None and abs(off) > least:
                found[cell] = f"its volume is {np.exp(off):.2g} times that of the frames before"
        return found

    def _off(self, cell: int, look: CellLook) -> float | None:
        """Return the log of volume over usual volume; None if one of them is unknown or zero."""
        before = self._of.get(cell)
        usual = float(np.median(before)) if before else 0.0
        return float(np.log(look.volume / usual)) if min(usual, look.volume) > 0 else None


def gone(mesh: Mesh, largest: dict[int, float], grid: Grid, width: float) -> dict[int, str]:
    """Return the cells that have vanished or left the field of view, and why.

    Parameters
    ----------
    largest : um^3, the largest volume that each cell has had.
    width : um, of the PSF.
    """
    found = dict.fromkeys(shrunken(mesh, width), "it has shrunk to a point")
    first, last = (np.asarray(corner) for corner in grid.extent)
    inside = np.all((mesh.vertices_numpy() >= first) & (mesh.vertices_numpy() <= last), axis=1)
    volumes = mesh.volumes()
    for cell, rows in mesh.faces_by_region().items():
        own = np.unique(mesh.faces[rows])
        if cell in found:
            continue
        if inside[own].mean() < RULES.alarms.in_view:
            found[cell] = "it has left the field of view"
        elif volumes[cell] < RULES.alarms.gone * largest.get(cell, 0.0):
            share = max(volumes[cell], 0.0) / largest[cell]
            found[cell] = f"it has shrunk to {share:.0%} of its largest volume"
    return found
