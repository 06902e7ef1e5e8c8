"""Random cells for simulations: a foam that shares walls, or vesicles that keep apart."""

from __future__ import annotations

from math import pi
from typing import get_args

import numpy as np

from ..common.choices import CellKind
from ..errors import InputError
from ..geometry.foam import foam
from ..geometry.mesh import FloatArray, Mesh
from ..geometry.primitives import sphere
from .grid import Grid

MARGIN = 0.14  # of the field of view, left free on each side
_FILL = 0.9  # of the ellipsoid within the margins, taken by a foam
_TRIES = 2000  # places tried for a vesicle
_EDGE_IN_VOXELS = 2.5  # of the smallest side
_LEAST_RADIUS = 2.5  # voxels; smaller cells would be no more than a blob
_GAP = 1.5  # voxels between vesicles


def random_cells(
    count: int,
    grid: Grid,
    kind: CellKind = "foam",
    seed: int = 0,
) -> Mesh:
    """Make cells at random places within a grid; the same seed gives the same cells.

    A foam is a cluster of spheres of random sizes that overlap and share flat walls (a power
    diagram), as the cells of an early embryo do. Vesicles are ovals with a gap between them.

    Parameters
    ----------
    count
        Number of cells; they are regions 1 to count.
    grid
        Cells lie within it, a margin away from its sides.

    Raises
    ------
    InputError
        If the count is not positive, or there is no room for so many cells.
    """
    if kind not in get_args(CellKind):
        raise InputError(f"cells are 'foam' or 'vesicles', not {kind!r}")
    if count < 1:
        raise InputError(f"the number of cells must be 1 or more, not {count}")
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"a seed is a whole number from 0 on, not {seed!r}")
    rng = np.random.Generator(np.random.PCG64([seed, count]))
    first, last = grid.extent
    middle, half = (first + last) / 2, (last - first) / 2 * (1 - 2 * MARGIN)
    voxel = np.asarray(grid.voxel_size)
    least = _LEAST_RADIUS * float(voxel.max())
    edge = _EDGE_IN_VOXELS * float(voxel.min())
    radius = float((half.prod() * _FILL / count) ** (1 / 3))
    if min(radius, float(half.min())) < least:
        raise InputError(
            f"there is no room for {count} cells in {_shown(last - first)} um: fewer cells, a "
            "larger image, or smaller voxels"
        )
    if kind == "foam":
        return _foam(count, middle, half, radius, edge, rng)
    gap = _GAP * float(voxel.max())
    return _vesicles(count, middle, half, (least, radius), gap, edge, rng)


def _foam(
    count: int,
    middle: FloatArray,
    half: FloatArray,
    radius: float,
    edge: float,
    rng: np.random.Generator,
) -> Mesh:
    """Make a foam: centres spread evenly over an ellipsoid (Lloyd's method), then shaken."""
    inner = np.maximum(half - 0.8 * radius, 0.15 * half)
    cloud = rng.uniform(-1, 1, (4000, 3))
    cloud = cloud[(cloud**2).sum(1) < 1] * inner
    centres = cloud[:count]
    for _ in range(25):
        nearest = ((cloud[:, None] - centres) ** 2).sum(2).argmin(1)
        centres = np.array(
            [
                cloud[nearest == k].mean(0) if (nearest == k).any() else centres[k]
                for k in range(count)
            ]
        )
    centres = centres + rng.normal(0, 0.08 * radius, centres.shape)
    radii = radius * rng.uniform(0.92, 1.08, count)
    # Spheres that reach over the margin are moved back.
    limit = half * 1.15 - radii[:, None]
    return foam(middle + np.clip(centres, -np.maximum(limit, 0), np.maximum(limit, 0)), radii, edge)


def _vesicles(
    count: int,
    middle: FloatArray,
    half: FloatArray,
    radii: tuple[float, float],
    gap: float,
    edge: float,
    rng: np.random.Generator,
) -> Mesh:
    """Place ovals so that none touches another; all are made smaller if there is no room."""
    size = 0.9 * radii[1]
    while size >= radii[0]:
        axes = size * rng.uniform(0.75, 1.15, (count, 3))
        centres: list[FloatArray] = []
        for axis in axes:
            room = half - axis
            for _ in range(_TRIES if (room > 0).all() else 0):
                place = rng.uniform(-room, room)
                if all(
                    np.linalg.norm(place - c) > axis.max() + a.max() + gap
                    for c, a in zip(centres, axes, strict=False)
                ):
                    centres.append(place)
                    break
            else:
                break
        if len(centres) == count:
            return Mesh.merge(
                [
                    _oval(middle + c, a, min(edge, a.min() / 2), rng)
                    for c, a in zip(centres, axes, strict=True)
                ]
            )
        size *= 0.93
    raise InputError(f"there is no room for {count} vesicles: fewer, or a larger image")


def _oval(centre: FloatArray, axes: FloatArray, edge: float, rng: np.random.Generator) -> Mesh:
    """Make a randomly turned ellipsoid with shallow dents, within a ball of its largest axis."""
    ball = sphere((0, 0, 0), float(axes.max()), edge_length=edge)
    unit = ball.vertices_numpy() / float(axes.max())
    dents = np.zeros(len(unit))
    for _ in range(3):
        direction = rng.normal(size=3)
        wave = unit @ (direction / np.linalg.norm(direction))
        dents += rng.uniform(0, 0.05) * (1 + np.sin(pi * wave + rng.uniform(0, 2 * pi)))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    return ball.with_vertices((unit * axes * (1 - dents / 2)[:, None]) @ turn.T + centre)


def _shown(size: FloatArray) -> str:
    return " x ".join(f"{s:.3g}" for s in size)
