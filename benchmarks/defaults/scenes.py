"""The scenes: what there is, what the command is told of it, and what is true."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import remesh

from .anything import ANYTHING, anything
from .imaging import (
    FINE,
    Array,
    Field,
    counted_photons,
    effective_sigma,
    imaged,
    inside,
    seen_by,
    surface_light,
)
from .processing import Stack, processed
from .recipes import KINDS, Recipe

_EDGE = 1.2  # voxels; of the true meshes
_LEAST_LABEL = 0.25  # of the cell; a label that would be smaller is drawn as it should be
_OFFSET = 100  # of a camera, where padding is to be seen


@dataclass(frozen=True)
class Scene:
    """An image and the truth about it; regions of the truth are numbered as the seeds."""

    name: str
    recipe: Recipe
    image: NDArray[np.float32]
    voxel_size: tuple[float, float, float]
    sigma: tuple[float, ...]  # um; of all blur, voxels included
    truth: Mesh
    strangers: tuple[int, ...]  # cells without a seed
    centres: dict[int, Array]
    radii: dict[int, float]
    labels: NDArray[np.int32]
    all_labels: NDArray[np.int32] = field(repr=False)


def rng_of(name: str, draw: int, commit: str) -> np.random.Generator:
    """Even draws are always the same, odd ones follow from the commit that is measured."""
    text = f"{name} {draw} {commit if draw % 2 else ''}"
    return np.random.default_rng(list(hashlib.sha256(text.encode()).digest()))


def made(name: str, draw: int, commit: str) -> Scene:
    """The scene of a kind, or of ``KIND~PROCESSING``."""
    kind, _, processing = name.partition("~")
    rng = rng_of(kind, draw, commit)
    recipe = anything(rng) if kind == ANYTHING else KINDS[kind](rng)
    scene = scene_of(f"{name}-{draw}", recipe, rng)
    if not processing:
        return scene
    sigma = np.asarray(scene.sigma) / np.asarray(scene.voxel_size)
    return replace(scene, image=processed(Stack(scene.image, sigma, rng), processing))


def scene_of(name: str, recipe: Recipe, rng: np.random.Generator) -> Scene:
    """Render what a recipe says."""
    size = (recipe.aspect, 1.0, 1.0)
    unit = 0.2  # um; the engine must not depend on it
    voxel = (size[0] * unit, unit, unit)
    space = Field(recipe.shape, voxel, rim=6 if recipe.aspect > 2 else 10)
    middle = (np.asarray(recipe.shape) - 1) / 2 * np.asarray(voxel)
    truth, centres, radii = _cells(recipe, middle, unit, rng)
    light = np.zeros(space.fine_shape)
    sigma = (recipe.psf[0] * voxel[0], recipe.psf[1] * unit, recipe.psf[1] * unit)
    thickness = recipe.thickness * unit
    cell = dict.fromkeys(centres, 1.0)
    if recipe.unequal:
        cell = {k: float(np.exp(recipe.unequal * rng.normal())) for k in centres}
    density = _density(recipe, middle, unit, rng)
    shining = sum(
        brightness * surface_light(part, space, rng, density, thickness)
        for part, brightness in _alike(truth, cell)
    )
    peak = float(np.percentile(imaged(shining, space, sigma), 99.5))
    light += recipe.membrane * shining / peak
    solid = {k: inside(truth, k, space.fine_shape, space.fine_position) for k in centres}
    grain = _grain(recipe, space, rng) if recipe.grain else 1.0
    for k, occupied in solid.items():
        light += recipe.interior * cell[k] * occupied * grain
        for _ in range(recipe.nucleoli):
            light *= _nucleolus(space, centres[k], radii[k], rng)
        if recipe.nucleus:
            light *= _nucleus(space, centres[k], radii[k], recipe.nucleus, rng)
    if recipe.body[0]:
        light += (
            recipe.body[0] * _bodies(recipe, space, centres, radii, rng) * (1 - sum(solid.values()))
        )
    if recipe.haze:
        light += recipe.haze * _haze(space, rng) * (1 - sum(solid.values()))
    if recipe.fading != 1:
        deep = (np.arange(space.fine_shape[0]) / FINE - space.rim) / recipe.shape[0]
        light *= (recipe.fading**deep)[:, None, None]
    if recipe.microscope:
        how = recipe.aberrated, recipe.leaning
        clean = seen_by(recipe.microscope, light, space, sigma[2], *how)
    else:
        clean = imaged(light, space, sigma)
    if recipe.specks:
        clean += _specks(recipe, space, solid, rng)
    image = counted_photons(clean, recipe.photons, recipe.dark, rng)
    if recipe.tilted != (0.0, 0.0):
        across, (rise, bend) = np.linspace(-1, 1, recipe.shape[2]), recipe.tilted
        ground = abs(rise) + abs(bend) + rise * across + bend * across**2
        image += rng.poisson(np.maximum(ground, 0), image.shape)  # rounding: -1e-17 where it is 0
    if recipe.padded:
        z, _, x = np.indices(image.shape) / np.array(image.shape).reshape(3, 1, 1, 1)
        image = np.where(z + x < recipe.padded, 0, image + _OFFSET).astype(np.float32)
    known = tuple(centres) if recipe.all_labelled else recipe.seeded
    strangers = tuple(k for k in centres if k not in known)
    every = np.zeros(recipe.shape, np.int32)
    for k, occupied in solid.items():
        every[space.binned(occupied) > 0.5] = k
    labels = np.where(np.isin(every, known), every, 0).astype(np.int32)
    # Of flat cells, that much of a voxel along Z would be half of their height.
    sides = size if recipe.flattened != 1 else (1.0, 1.0, 1.0)
    given = (truth, strangers, centres, radii, _careless(labels, sides, rng), every)
    return Scene(name, recipe, image, voxel, effective_sigma(space, sigma), *given)


def _alike(mesh: Mesh, cell: dict[int, float]) -> list[tuple[Mesh, float]]:
    """Faces of one brightness each: walls have the mean of their cells."""
    if len(set(cell.values())) == 1:
        return [(mesh, next(iter(cell.values())))]
    parts = []
    for pair in np.unique(mesh.regions, axis=0):
        faces = mesh.faces[(mesh.regions == pair).all(1)]
        sides = [cell[int(k)] for k in pair if k > 0]
        part = Mesh(mesh.vertices_numpy(), faces, np.tile(pair, (len(faces), 1)))
        parts.append((part, float(np.mean(sides))))
    return parts


def _cells(
    recipe: Recipe, middle: Array, unit: float, rng: np.random.Generator
) -> tuple[Mesh, dict[int, Array], dict[int, float]]:
    cells = np.asarray(recipe.cells, float) * unit
    centres = {k: middle + c[:3] for k, c in enumerate(cells, 1)}
    radii = {k: float(c[3]) for k, c in enumerate(cells, 1)}
    if recipe.together:
        whole = foam(np.stack(list(centres.values())), cells[:, 3], _EDGE * unit)
        return _waved(whole, middle, recipe.roughness, rng), centres, radii
    parts = []
    for k, centre in centres.items():
        ball = sphere((0, 0, 0), radii[k], edge_length=_EDGE * unit)
        ball = _fingered(_waved(ball, np.zeros(3), recipe.roughness, rng), recipe.arms, rng)
        v = ball.vertices_numpy() * (recipe.flattened, 1.0, 1.0) + centre
        parts.append(Mesh(v, ball.faces, ball.regions * k))
    return Mesh.merge(parts), centres, radii


def _waved(mesh: Mesh, middle: Array, roughness: float, rng: np.random.Generator) -> Mesh:
    """Moved by a few random waves of the direction seen from the middle."""
    v = mesh.vertices_numpy() - middle
    reach = float(np.linalg.norm(v, axis=1).max())
    change = np.zeros(len(v))
    for _ in range(4):
        wave = rng.normal(size=3)
        wave *= rng.uniform(1.5, 4.0) / np.linalg.norm(wave)
        change += np.sin(v / reach @ wave + rng.uniform(0, 2 * np.pi))
    return mesh.with_vertices(v * (1 + roughness * change / 2.5)[:, None] + middle)


def _fingered(mesh: Mesh, count: int, rng: np.random.Generator) -> Mesh:
    """With fingers about as long as the radius and a third as wide, each to another side."""
    if not count:
        return mesh
    edge = mesh.median_edge()
    mesh = remesh(mesh, edge / 2).mesh
    v = mesh.vertices_numpy()
    ahead = v / np.linalg.norm(v, axis=1, keepdims=True)
    longer, taken = np.zeros(len(v)), list[Array]()
    while len(taken) < count:
        one = rng.normal(size=3)
        one /= np.linalg.norm(one)
        if all(one @ other < 0.3 for other in taken):
            taken.append(one)
            angle = np.arccos(np.clip(ahead @ one, -1, 1))
            longer += rng.uniform(0.6, 1.1) * np.exp(-0.5 * (angle / 0.15) ** 2)
    return remesh(mesh.with_vertices(v * (1 + longer)[:, None]), edge).mesh


def _density(
    recipe: Recipe, middle: Array, unit: float, rng: np.random.Generator
) -> Callable[[Array], Array] | None:
    if not recipe.uneven and not recipe.textured:
        return None
    waves = []
    for strength, length in ((recipe.uneven, 24.0), (recipe.textured, 5.0)):
        for _ in range(6):
            k = rng.normal(size=3)
            k *= 2 * np.pi / (length * unit) / np.linalg.norm(k)
            waves.append((strength / 3**0.5, k, rng.uniform(0, 2 * np.pi)))

    def density(points: Array) -> Array:
        log = sum(a * np.cos((points - middle) @ k + phase) for a, k, phase in waves)
        return np.asarray(np.exp(log))

    return density


def _grain(recipe: Recipe, space: Field, rng: np.random.Generator) -> Array:
    """Clumps of about two and a half times ``clump`` voxels, one on average."""
    clump = (recipe.clump / recipe.aspect, recipe.clump, recipe.clump)
    noise = gaussian_filter(rng.normal(size=space.fine_shape), FINE * np.asarray(clump))
    clumps = np.exp(recipe.grain * noise / noise.std())
    return np.asarray(clumps / clumps.mean())


def _nucleolus(space: Field, centre: Array, radius: float, rng: np.random.Generator) -> Array:
    """A third in a ball of about a fifth of a cell's radius, not near its border; else 1."""
    middle = centre + radius * rng.uniform(-0.35, 0.35, 3)
    within = _away(space, middle) < radius * rng.uniform(0.15, 0.25)
    return np.where(within, 1 / 3, 1.0)


def _nucleus(
    space: Field, centre: Array, radius: float, share: float, rng: np.random.Generator
) -> Array:
    """A quarter in a ball of that share of a cell's radius, somewhat off its middle; else 1."""
    middle = centre + (1 - share) * radius * rng.uniform(-0.3, 0.3, 3)
    return np.where(_away(space, middle) < share * radius, 1 / 4, 1.0)


def _bodies(
    recipe: Recipe,
    space: Field,
    centres: dict[int, Array],
    radii: dict[int, float],
    rng: np.random.Generator,
) -> Array:
    """1 within a ball around each cell, somewhat off its middle; else 0."""
    found = np.zeros(space.fine_shape, bool)
    for k, centre in centres.items():
        reach = recipe.body[1] * radii[k]
        middle = centre + (reach - radii[k]) * rng.uniform(-0.5, 0.5, 3)
        found |= _away(space, middle) < reach
    return found.astype(float)


def _away(space: Field, middle: Array) -> Array:
    """um, from there, of each fine voxel."""
    at = space.fine_position(middle)
    axes = [np.arange(n) - p for n, p in zip(space.fine_shape, at, strict=True)]
    each = np.meshgrid(*axes, indexing="ij", sparse=True)
    return np.sqrt(sum((a * d) ** 2 for a, d in zip(each, space.fine_size, strict=True)))


def _haze(space: Field, rng: np.random.Generator) -> Array:
    """Between 0.4 and 1, smooth over a third of the stack."""
    coarse = rng.normal(size=(6, 6, 6))
    grid = np.meshgrid(*(np.linspace(0, 5, n) for n in space.fine_shape), indexing="ij")
    field = map_coordinates(coarse, grid, order=3)
    field = (field - field.min()) / np.ptp(field)
    return np.asarray(0.4 + 0.6 * field)


def _specks(
    recipe: Recipe, space: Field, solid: dict[int, Array], rng: np.random.Generator
) -> Array:
    """Bright crumbs outside of the cells, as bright as two membranes."""
    away = distance_transform_edt(space.binned(sum(solid.values())) < 0.5)
    places = np.argwhere((away > 4) & (away < 12))
    out = np.zeros(space.shape)
    for place in rng.permutation(places)[: recipe.specks]:
        one = np.zeros(space.shape)
        one[tuple(place)] = 1
        width = rng.uniform(1.0, 2.0) * np.asarray([recipe.psf[0], recipe.psf[1], recipe.psf[1]])
        one = gaussian_filter(one, width)
        out += 2 * one / one.max()
    return out


def _careless(
    labels: NDArray[np.int32], sides: tuple[float, float, float], rng: np.random.Generator
) -> NDArray[np.int32]:
    """Labels as another tool draws them: borders a voxel or two off, smoothly so.

    sides : of voxels, as far as distances count.
    """
    result = np.zeros_like(labels)
    wander = gaussian_filter(rng.normal(size=labels.shape), 4)
    wander *= 0.8 / wander.std()
    best = np.full(labels.shape, -np.inf)
    for k in np.unique(labels[labels > 0]):
        own = labels == k
        depth = distance_transform_edt(own, sides) - distance_transform_edt(~own, sides)
        mine = (depth + wander > 0) & (depth > best)
        if mine.sum() < _LEAST_LABEL * own.sum():
            mine = own  # no tool draws what is hardly there
        result[mine], best[mine] = k, depth[mine]
    return result
