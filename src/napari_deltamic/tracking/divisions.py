"""Finds cells that have divided: an unexplained bright wall inside one suggests two daughters."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from ..fitting.model.likelihood import voxel_noise
from ..fitting.model.state import FitState
from ..geometry.labels.voxels import depths, voxel_labels
from ..geometry.mesh import Mesh
from ..scene import Grid
from .track_rules import RULES

FloatArray = NDArray[np.float64]
_RULES = RULES.divisions


@dataclass(frozen=True)
class Proposal:
    """A plane through a cell (um) where the residual shows a wall.

    brightness : relative to a wall of two membranes.
    evidence : in standard deviations of the noise.
    """

    cell: int
    point: FloatArray
    normal: FloatArray
    brightness: float
    evidence: float


class Residual:
    """Measured minus rendered image of a fit, and where each cell lies in it."""

    def __init__(
        self, image: NDArray[np.float32], known: NDArray[np.bool_], grid: Grid, state: FitState
    ) -> None:
        self.grid = grid
        self.known = known
        self.values = np.where(known, image - state.rendered(), 0.0)
        self.noise = max(voxel_noise(image, known), 1e-30)
        self.sigma = np.asarray(state.optics.sigma_um)
        self.labels = voxel_labels(state.mesh, grid.shape, grid.voxel_size, grid.origin)
        volume = float(np.prod(grid.voxel_size))
        # Peak intensity of a flat wall between two cells, across the widest axis of the PSF.
        self.wall = 2 * state.amplitude * volume / (sqrt(2 * pi) * float(self.sigma.max()))

    def deep(self, cell: int, box: tuple[slice, ...]) -> NDArray[np.bool_]:
        """Return which voxels of a box lie in a cell, beyond the blur of its surface."""
        widths = np.asarray(self.grid.voxel_size) / self.sigma
        found: NDArray[np.bool_] = depths(self.labels[box] == cell, widths) > _RULES.interior
        return found

    def squared(self, own: NDArray[np.bool_]) -> float:
        """Return the sum of the squared residual over some voxels."""
        return float((self.values[own & self.known] ** 2).sum())


def proposals(residual: Residual, mesh: Mesh) -> list[Proposal]:
    """Return a plane for each cell whose residual shows a wall, the surest first."""
    found = [_proposal(residual, cell) for cell in mesh.region_ids().tolist()]
    return sorted((p for p in found if p is not None), key=lambda p: -p.evidence)


def explains(before: Residual, after: Residual, cell: int, folded: bool = False) -> bool:
    """Whether a wall that was put into a cell explains enough of its residual.

    The gain in squared residual must be beyond chance, and a fair share of the whole. A single cell
    that has folded in along the wall (:func:`has_folded`) has the same image as two: then it is
    enough that two explain it about as well.
    """
    own = before.labels == cell
    old, new = before.squared(own), after.squared(own)
    if folded:
        return new < (1 + _RULES.folded) * old
    return old - new > max(_RULES.gain * old, _RULES.sure**2 * before.noise**2)


def has_folded(start: Residual, end: Residual, wall: Proposal) -> bool:
    """Whether a cell that was whole at the start of a fit has folded in along a wall at its end.

    If a start is off, a gradient in a cell also looks like a wall, but then the cell does not fold.
    """
    grid, box = start.grid, _box(np.argwhere(start.labels == wall.cell))
    inner = np.argwhere(start.deep(wall.cell, box))
    um = (inner + [s.start for s in box]) * grid.voxel_size + grid.origin
    away = (um - wall.point) @ wall.normal
    near = inner[np.abs(away) < np.sqrt(((start.sigma * wall.normal) ** 2).sum())]
    still = end.deep(wall.cell, box)[tuple(near.T)]
    return bool(len(near)) and float(still.mean()) < 1 - _RULES.along


def are_daughters(mesh: Mesh, pair: tuple[int, int]) -> bool:
    """Whether both cells are there after the fit, neither much smaller than the other."""
    if not set(pair) <= set(mesh.region_ids().tolist()):
        return False
    volumes = mesh.volumes()
    sizes = [abs(volumes[cell]) for cell in pair]
    return min(sizes) > _RULES.smallest * sum(sizes)


def _proposal(residual: Residual, cell: int) -> Proposal | None:
    grid = residual.grid
    places = np.argwhere(residual.labels == cell)
    if not len(places):
        return None
    box = _box(places)
    inner = residual.deep(cell, box) & residual.known[box]
    if int(inner.sum()) < _RULES.fewest:
        return None
    um = (np.argwhere(inner) + [s.start for s in box]) * grid.voxel_size + grid.origin
    values = residual.values[box][inner]
    center = ((places * grid.voxel_size) + grid.origin).mean(0)
    whole = (places * grid.voxel_size) + grid.origin - center
    best = _best_plane(um - center, values, residual)
    if best is None:
        return None
    normal, offset, height, evidence = best
    share = float((whole @ normal < offset).mean())
    brightness = height / residual.wall
    (dimmest, brightest), least = _RULES.wall, _RULES.smallest
    reasonable = dimmest <= brightness <= brightest and least < share < 1 - least
    if evidence < _RULES.sure or not reasonable:
        return None
    if not _all_around(um - center, values, residual, normal, offset, height):
        return None
    return Proposal(cell, center + offset * normal, normal, brightness, evidence)


def _box(places: NDArray[np.signedinteger]) -> tuple[slice, ...]:
    """Return the box around some voxels, and one voxel more on each side within the image."""
    low, high = np.maximum(places.min(0) - 1, 0), places.max(0) + 2
    return tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))


def _best_plane(
    places: FloatArray, values: FloatArray, residual: Residual
) -> tuple[FloatArray, float, float, float] | None:
    """Return normal, offset (um), brightness and evidence of the wall that explains most.

    A wall adds a ridge of Gaussian section. Its best height at an offset is a ratio of two sums,
    both of which are convolutions of profiles along the normal.
    """
    best = None
    for normal in _half_sphere(_RULES.directions):
        width = float(np.sqrt(((residual.sigma * normal) ** 2).sum()))
        along = places @ normal
        step = width / 3
        index = np.floor((along - along.min()) / step).astype(int)
        count = np.bincount(index).astype(np.float64)
        total = np.bincount(index, values).astype(np.float64)
        kernel = np.exp(-0.5 * (np.arange(-9, 10) / 3) ** 2)
        projected, norm = _blurred(total, kernel), _blurred(count, kernel**2)
        score = projected / np.sqrt(np.maximum(norm, 1.0)) / residual.noise
        k = int(score.argmax())
        if best is None or score[k] > best[3]:
            offset = float(along.min() + (k + 0.5) * step)
            best = (normal, offset, float(projected[k] / max(norm[k], 1e-12)), float(score[k]))
    return best


def _blurred(profile: FloatArray, kernel: FloatArray) -> FloatArray:
    """Convolve a profile; the result is as long as the profile."""
    half = len(kernel) // 2
    found: FloatArray = np.convolve(profile, kernel)[half : half + len(profile)]
    return found


def _all_around(
    places: FloatArray,
    values: FloatArray,
    residual: Residual,
    normal: FloatArray,
    offset: float,
    height: float,
) -> bool:
    """Whether a wall is bright in every direction from its middle, unlike an edge or a spot."""
    width = float(np.sqrt(((residual.sigma * normal) ** 2).sum()))
    away = places @ normal - offset
    near = np.abs(away) < 2 * width
    if near.sum() < 4 * _RULES.sectors:
        return False
    flat = places[near] - np.outer(places[near] @ normal, normal)
    flat -= flat.mean(axis=0)
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    angle = np.arctan2(flat @ np.cross(normal, across), flat @ across)
    sector = np.floor((angle / (2 * pi) + 0.5) * _RULES.sectors).astype(int) % _RULES.sectors
    shape = np.exp(-0.5 * (away[near] / width) ** 2)
    lit = np.bincount(sector, values[near] * shape, _RULES.sectors)
    norm = np.bincount(sector, shape**2, _RULES.sectors)
    heights = lit / np.maximum(norm, 1e-12)
    # In a sector of few voxels, noise alone may make it dark.
    slack = 2 * residual.noise / np.sqrt(np.maximum(norm, 1e-12))
    return bool((heights + slack > _RULES.least_sector * height).all())


def _half_sphere(n: int) -> FloatArray:
    """Return (n, 3) unit vectors spread evenly over half a sphere (spherical Fibonacci lattice)."""
    k = np.arange(n) + 0.5
    z = 1 - k / n
    angle = pi * (1 + sqrt(5)) * k
    r = np.sqrt(1 - z**2)
    return np.stack([z, r * np.cos(angle), r * np.sin(angle)], axis=1)
