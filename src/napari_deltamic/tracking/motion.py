"""Finds where cells have gone since the last frame: the start of the next fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

from ..common.ball import ball_radius
from ..fitting.model.likelihood import match
from ..fitting.solvers.preconditioner import NEAR_JUNCTIONS, Preconditioner
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..runs.settings import NEAR_LEVELS, WIDE_LEVELS
from ..scene import Grid, render
from .track_rules import RULES

FloatArray = NDArray[np.float64]
_RULES = RULES.motion


@dataclass(frozen=True)
class Start:
    """A place where a fit may start.

    name : how it was found.
    mesh : um.
    left : um; about how far away the membranes may still be.
    loss : of the mesh as it is, on blurred images.
    """

    name: str
    mesh: Mesh
    left: float
    loss: float

    def levels(self, sigma: float) -> tuple[float, ...]:
        """Return the blurs of a fit that starts here, of which the first reaches the membranes."""
        wide = [b for b in WIDE_LEVELS if b * sigma < self.left]
        reach = WIDE_LEVELS[max(0, len(WIDE_LEVELS) - len(wide) - 1)]
        if reach < _RULES.near:
            return NEAR_LEVELS
        return tuple(b for b in WIDE_LEVELS if b <= reach)


def starts(
    mesh: Mesh,
    rendered: NDArray[np.float32],
    image: NDArray[np.float32],
    known: NDArray[np.bool_],
    grid: Grid,
    optics: Optics,
    velocities: Mapping[int, FloatArray],
) -> list[Start]:
    """Return where the fit of a frame may start, the best first.

    The mesh as it was; moved on at the velocity of each cell; or moved as the images say: all cells
    together by the peak of the cross-correlation of the last rendered image with the present one,
    then each cell by that of its surroundings.

    Parameters
    ----------
    mesh, rendered : of the last good frame.
    image : (Z, Y, X) of this frame, with any value where it is not known.
    velocities : um, expected displacement of each region since then; zero where unknown.
    """
    width = _RULES.blur * np.asarray(optics.sigma_um) / np.asarray(grid.voxel_size)
    level = float(np.median(image[known]))
    measured = gaussian_filter(np.where(known, image, level), width)
    template = gaussian_filter(rendered, width)
    regions = mesh.region_ids().tolist()
    still = {region: np.zeros(3) for region in regions}
    moving = {region: np.asarray(velocities.get(region, np.zeros(3))) for region in regions}
    seen = _seen_shifts(mesh, template, measured, grid)
    score = _Score(image, known, grid, optics)
    found = []
    for name, shifts in (("as it was", still), ("velocity", moving), ("images", seen)):
        if name != "as it was" and not any(np.any(s) for s in shifts.values()):
            continue
        left = max(float(np.linalg.norm(seen[r] - shifts[r])) for r in regions)
        moved = shifted(mesh, shifts)
        found.append(Start(name, moved, left + min(grid.voxel_size), score(moved)))
    # A mesh is moved only where that explains the image clearly better.
    worth = _RULES.better * found[0].loss
    return sorted(found, key=lambda s: (s is not found[0] and s.loss >= worth, s.loss))


def shifted(mesh: Mesh, shifts: Mapping[int, FloatArray]) -> Mesh:
    """Move each region of a mesh (um), smoothly where regions meet that move differently."""
    size = int(mesh.regions.max()) + 1
    table, counts = np.zeros((size, 3)), np.zeros(size)
    for region, shift in shifts.items():
        table[region], counts[region] = shift, 1
    total, weight = np.zeros((len(mesh.vertices), 3)), np.zeros(len(mesh.vertices))
    for side in (0, 1):
        sides = np.repeat(mesh.regions[:, side], 3)
        np.add.at(total, mesh.faces.ravel(), table[sides])
        np.add.at(weight, mesh.faces.ravel(), counts[sides])
    mean = total / np.maximum(weight, 1)[:, None]
    if not mean.any():
        return mesh
    smoother = Preconditioner(mesh, _RULES.smoothing, at_junctions=NEAR_JUNCTIONS)
    smooth = smoother.solve(torch.from_numpy(mean)).numpy()
    return mesh.with_vertices(mesh.vertices_numpy() + smooth)


class _Score:
    """Computes the loss of a mesh as it is, on blurred images."""

    def __init__(
        self, image: NDArray[np.float32], known: NDArray[np.bool_], grid: Grid, optics: Optics
    ) -> None:
        self._grid, self._optics = grid, optics
        extra = (
            np.sqrt(_RULES.blur**2 - 1) * np.asarray(optics.sigma_um) / np.asarray(grid.voxel_size)
        )
        self._extra = extra
        level = float(np.median(image[known]))
        blurred = gaussian_filter(np.where(known, image, level), extra)
        self._index = torch.from_numpy(np.flatnonzero(known))
        self._measured = torch.from_numpy(blurred.astype(np.float64)).reshape(-1)[self._index]
        self._ones = torch.ones_like(self._measured)

    def __call__(self, mesh: Mesh) -> float:
        with torch.no_grad():
            image = render(mesh, self._grid, self._optics, _RULES.accuracy).numpy()
        blurred = torch.from_numpy(gaussian_filter(image, self._extra).astype(np.float64))
        return match(blurred.reshape(-1)[self._index], self._measured, self._ones)[1].loss


def _seen_shifts(
    mesh: Mesh, template: NDArray[np.float32], measured: NDArray[np.float32], grid: Grid
) -> dict[int, FloatArray]:
    """Return how far (um) each region has moved, according to the images."""
    size = np.asarray(grid.voxel_size)
    reach = np.floor(_RULES.all_by * np.asarray(grid.shape)).astype(int)
    everywhere = _peak(template, measured, np.ones(template.shape, bool), reach)
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    found = {}
    for region, volume in mesh.volumes().items():
        radius = ball_radius(max(volume, 0))
        local = np.maximum(np.floor(_RULES.one_by * radius / size), 1).astype(int)
        found[region] = (
            everywhere + _local(labels == region, template, measured, everywhere, local)
        ) * size
    return found


def _local(
    own: NDArray[np.bool_],
    template: NDArray[np.float32],
    measured: NDArray[np.float32],
    shift: FloatArray,
    reach: NDArray[np.int64],
) -> FloatArray:
    """Return (3,) voxels by which a cell has moved besides the shift of all."""
    if not own.any():
        return np.zeros(3)
    places = np.argwhere(own)
    low = np.maximum(places.min(0) - 3, 0)
    high = np.minimum(places.max(0) + 4, own.shape)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    near = gaussian_filter(own[box].astype(np.float32), _RULES.around) > _RULES.edge
    moved = [slice(a + int(s), b + int(s)) for a, b, s in zip(low, high, shift, strict=True)]
    if not near.any():
        return np.zeros(3)  # too small to be seen
    if any(s.start < 0 or s.stop > n for s, n in zip(moved, own.shape, strict=True)):
        return np.zeros(3)  # partly out of view: nothing to compare
    room = [
        (min(int(r), s.start), min(int(r), n - s.stop))
        for r, s, n in zip(reach, moved, own.shape, strict=True)
    ]
    wide = tuple(slice(s.start - a, s.stop + b) for s, (a, b) in zip(moved, room, strict=True))
    return _peak(template[box], measured[wide], near, np.array(reach), room)


def _peak(
    template: NDArray[np.float32],
    measured: NDArray[np.float32],
    mask: NDArray[np.bool_],
    reach: NDArray[np.int64],
    room: list[tuple[int, int]] | None = None,
) -> FloatArray:
    """Return the shift (3,), voxels, of the template that correlates best with the measured image.

    room : by how much the measured image is larger on both sides of each axis; without it both have
        the same size, and what a shift brings in from beyond the border counts as empty.
    """
    pads = room if room is not None else [(int(r), int(r)) for r in reach]
    inside = np.ones(measured.shape, np.float32)
    if room is None:
        measured = np.pad(measured - measured.mean(), pads)
        inside = np.pad(inside, pads)
    weights = mask.astype(np.float64)
    flip = (slice(None, None, -1),) * 3

    def over(image: NDArray[np.float32], kernel: FloatArray) -> FloatArray:
        total: FloatArray = fftconvolve(image.astype(np.float64), kernel[flip], mode="valid")
        return total

    # Below a thousandth it is only rounding of the transform, and must not be a divisor.
    n = np.maximum(over(inside, weights), 1e-3 * weights.sum())
    t, t2 = over(inside, weights * template), over(inside, weights * template**2)
    m, m2 = over(measured, weights), over(measured**2, weights)
    cross = over(measured, weights * template)
    spread = (t2 - t * t / n) * (m2 - m * m / n)
    value = (cross - t * m / n) / np.sqrt(np.maximum(spread, 1e-12 * np.abs(spread).max() + 1e-30))
    value = np.where(n > _RULES.overlap * weights.sum(), value, -1.0)
    axes = np.meshgrid(*(np.arange(-a, b + 1) for a, b in pads), indexing="ij")
    offsets = np.stack(axes, axis=-1).astype(np.float64)
    # Cells look alike: of two shifts that are almost as good, the shorter one.
    value -= _RULES.far * ((offsets / np.maximum(reach, 1)) ** 2).sum(axis=-1)
    best: FloatArray = offsets[np.unravel_index(int(value.argmax()), value.shape)]
    return best
