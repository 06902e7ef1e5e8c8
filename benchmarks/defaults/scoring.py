"""How far a fit is from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from napari_deltamic import Mesh
from napari_deltamic.measure.surface_distance import distance_to_surface

from .imaging import Array, inside, surface_points
from .scenes import Scene

_SAMPLES = 1500  # of the surface of one cell
_AXIAL = 0.7  # |cosine| of normal and Z from which on a place counts as axial
_SWALLOWED = 0.3  # of a neighbour's volume
# um along Z, within which an aberrated PSF may have its focus. Measured between its brightest plane
# and that of the least spread of phases, 0.09 at 0.6 rad and 0.16 at 0.77 (wavelength 1.3 um).
_FOCUS = 0.2
_LOST = 0.35  # volume common to both over that of either: less is another thing


@dataclass(frozen=True)
class Score:
    """Errors in voxels (geometric mean of the sides); volumes relative, as worst over cells."""

    surface: float
    lateral: float
    axial: float
    volume: float
    swallowed: int
    lost: int
    cells: int


def score(scene: Scene, mesh: Mesh | None) -> Score:
    """The fit against the truth, seeded cell by seeded cell; one not found is off by its radius."""
    voxel = float(np.prod(scene.voxel_size)) ** (1 / 3)
    shape, size = scene.recipe.shape, np.asarray(scene.voxel_size)
    if mesh is not None and scene.recipe.aberrated:
        mesh = _in_focus(scene, mesh)
    found = {} if mesh is None else {int(k) for k in mesh.region_ids()}
    rows, volumes, lost, swallowed = [], [], 0, set()
    for k in scene.recipe.seeded:
        radius = scene.radii[k] / voxel
        if mesh is None or k not in found:
            rows.append((radius, radius, radius))
            volumes.append(1.0)
            lost += 1
            continue
        solid = inside(mesh, k, shape, lambda p: p / size) > 0.5
        true = scene.all_labels == k
        volumes.append(_volume_error(scene, mesh, k))
        lost += (solid & true).sum() < _LOST * (solid | true).sum()
        for other in scene.strangers:
            theirs = scene.all_labels == other
            if (solid & theirs).sum() > _SWALLOWED * theirs.sum():
                swallowed.add(other)
        rows.append(tuple(e / voxel for e in _distances(scene, mesh, k)))
    table = np.ma.masked_invalid(np.array(rows))
    mean = table.mean(0).filled(np.nan)
    worst = float(max(volumes, key=abs))
    return Score(*map(float, mean), worst, len(swallowed), int(lost), len(rows))


def _in_focus(scene: Scene, mesh: Mesh) -> Mesh:
    """A fit moved along Z as a whole onto the truth, as far as a focus may be another.

    An aberrated PSF is not symmetric along Z: where it has its focus is a matter of definition.
    """
    common = [k for k in scene.recipe.seeded if k in set(mesh.region_ids())]
    if not common:
        return mesh
    true, found = ([_height(m.region_surface(k)) for k in common] for m in (scene.truth, mesh))
    away = np.clip(np.median(np.subtract(true, found)), -_FOCUS, _FOCUS)
    return mesh.with_vertices(mesh.vertices_numpy() + np.array([away, 0.0, 0.0]))


def _height(mesh: Mesh) -> float:
    """um along Z, of the middle of a surface."""
    middles = mesh.vertices_numpy()[np.asarray(mesh.faces)][:, :, 0].mean(1)
    return float(np.average(middles, weights=mesh.areas()))


def _volume_error(scene: Scene, mesh: Mesh, cell: int) -> float:
    """Relative; of a cut cell, of its part in the stack."""
    true, found = (abs(m.region_volume(cell)) for m in (scene.truth, mesh))
    low, high = scene.truth.region_surface(cell).bounds()
    end = (np.asarray(scene.recipe.shape) - 0.5) * np.asarray(scene.voxel_size)
    if (low < -0.5 * np.asarray(scene.voxel_size)).any() or (high > end).any():
        fine = 2
        shape = tuple(n * fine for n in scene.recipe.shape)
        size = np.asarray(scene.voxel_size)

        def place(points: Array) -> Array:
            return np.asarray((points / size + 0.5) * fine - 0.5)

        true, found = (inside(m, cell, shape, place).sum() for m in (scene.truth, mesh))
    return float(found / true - 1)


def _distances(scene: Scene, mesh: Mesh, cell: int) -> Sequence[float]:
    """um: mean over both ways; of places that face sideways; of those that face along Z."""
    rng = np.random.default_rng(0)
    end = (np.asarray(scene.recipe.shape) - 0.5) * np.asarray(scene.voxel_size)
    ways, axial = [], []
    for source, target in ((mesh, scene.truth), (scene.truth, mesh)):
        own, other = source.region_surface(cell), target.region_surface(cell)
        spacing = float(np.sqrt(own.areas().sum() / _SAMPLES))
        points, face, area = surface_points(own, spacing, rng)
        # Where a cell leaves the stack nothing is known of it, nor of the face that closes it.
        margin = np.asarray(scene.voxel_size)
        seen = ((points > 0.5 * margin) & (points < end - margin)).all(1)
        if not seen.any():  # a cell that has left the stack is as far off as it is
            seen = np.ones(len(points), bool)
        pick = rng.choice(len(points), _SAMPLES, p=area * seen / (area * seen).sum())
        ways.append(distance_to_surface(points[pick], other))
        axial.append(np.abs(own.normals()[face[pick], 0]) > _AXIAL)

    def mean(which: int) -> float:
        parts = []
        for distance, faces_z in zip(ways, axial, strict=True):
            chosen = distance[faces_z if which else ~faces_z]
            parts.append(chosen.mean() if len(chosen) else np.nan)
        return float(np.mean(parts))

    return float(np.mean([w.mean() for w in ways])), mean(0), mean(1)
