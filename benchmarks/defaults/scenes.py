"""The scenes: what there is, what the command is told of it, and what is true."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam

from .imaging import (
    FINE,
    Array,
    Field,
    counted_photons,
    effective_sigma,
    imaged,
    inside,
    surface_light,
)
from .processing import Stack, processed

SeedKind = Literal["labels", "spheres", "points", "mesh", "auto"]
_EDGE = 1.2  # voxels; of the true meshes
_OFFSET = 100  # of a camera, where padding is to be seen


@dataclass(frozen=True)
class Recipe:
    """What one image shows; lengths in voxels of the smallest side, light relative to membranes."""

    cells: tuple[tuple[float, float, float, float], ...] = ((0, 0, 0, 11),)  # offset Z Y X, radius
    seeded: tuple[int, ...] = (1,)  # cells that have a seed, from 1
    together: bool = False  # cells share walls
    roughness: float = 0.12
    shape: tuple[int, int, int] = (40, 40, 40)
    aspect: float = 1.0  # Z over lateral voxel side
    psf: tuple[float, float] = (1.2, 1.2)  # standard deviation along Z (of its voxels) and in plane
    photons: float = 60.0
    dark: float = 6.0
    membrane: float = 1.0
    interior: float = 0.0  # of the brightness of the membrane in the image
    uneven: float = 0.0  # standard deviation of the log density, smooth over the cell
    textured: float = 0.0  # the same, over a few voxels
    haze: float = 0.0  # light outside, of the membrane's brightness
    specks: int = 0
    thickness: float = 0.0
    unequal: float = 0.0  # standard deviation of the log brightness from cell to cell
    grain: float = 0.0  # the same inside cells, over a few voxels: chromatin
    fading: float = 1.0  # brightness of the last slice, of that of the first
    tilted: tuple[float, float] = (
        0.0,
        0.0,
    )  # how the background rises along X, and squared; photons
    padded: float = 0.0  # share of the sum of Z and X below which nothing was measured
    seeds: SeedKind = "spheres"
    start: tuple[float, float] = (0.9, 0.1)  # radius of spheres and meshes, offset, in radii
    told: tuple[str, ...] = ()  # what the command that knows all is told besides the PSF


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
    scene = scene_of(f"{name}-{draw}", KINDS[kind](rng), rng)
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
    if recipe.haze:
        light += recipe.haze * _haze(space, rng) * (1 - sum(solid.values()))
    if recipe.fading != 1:
        deep = (np.arange(space.fine_shape[0]) / FINE - space.rim) / recipe.shape[0]
        light *= (recipe.fading**deep)[:, None, None]
    clean = imaged(light, space, sigma)
    if recipe.specks:
        clean += _specks(recipe, space, solid, rng)
    image = counted_photons(clean, recipe.photons, recipe.dark, rng)
    if recipe.tilted != (0.0, 0.0):
        across, (rise, bend) = np.linspace(-1, 1, recipe.shape[2]), recipe.tilted
        image += rng.poisson(abs(rise) + abs(bend) + rise * across + bend * across**2, image.shape)
    if recipe.padded:
        z, _, x = np.indices(image.shape) / np.array(image.shape).reshape(3, 1, 1, 1)
        image = np.where(z + x < recipe.padded, 0, image + _OFFSET).astype(np.float32)
    strangers = tuple(k for k in centres if k not in recipe.seeded)
    every = np.zeros(recipe.shape, np.int32)
    for k, occupied in solid.items():
        every[space.binned(occupied) > 0.5] = k
    labels = np.where(np.isin(every, recipe.seeded), every, 0).astype(np.int32)
    given = (truth, strangers, centres, radii, _careless(labels, rng), every)
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
        v = _waved(ball, np.zeros(3), recipe.roughness, rng).vertices_numpy() + centre
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
    """Clumps of about four voxels, one on average."""
    noise = gaussian_filter(rng.normal(size=space.fine_shape), 1.7 * FINE)
    clumps = np.exp(recipe.grain * noise / noise.std())
    return np.asarray(clumps / clumps.mean())


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


def _careless(labels: NDArray[np.int32], rng: np.random.Generator) -> NDArray[np.int32]:
    """Labels as another tool draws them: borders a voxel or two off, smoothly so."""
    result = np.zeros_like(labels)
    wander = gaussian_filter(rng.normal(size=labels.shape), 4)
    wander *= 0.8 / wander.std()
    best = np.full(labels.shape, -np.inf)
    for k in np.unique(labels[labels > 0]):
        own = labels == k
        depth = distance_transform_edt(own) - distance_transform_edt(~own)
        mine = (depth + wander > 0) & (depth > best)
        result[mine], best[mine] = k, depth[mine]
    return result


# The kinds ------------------------------------------------------------------------------------


def _neighbours(rng: np.random.Generator, seeds: SeedKind) -> Recipe:
    """One cell with a seed among five without, a voxel or three apart."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    cells = [(0.0, 0.0, 0.0, 8.0)]
    for sign in (-1, 1):
        for axis in range(3):
            radius = rng.uniform(6, 8)
            place = sign * (8.0 + radius + rng.uniform(2.5, 4.5)) * turn[axis]
            cells.append((*place.tolist(), radius))
    return Recipe(tuple(cells[:6]), roughness=0.08, shape=(44, 44, 44), seeds=seeds)


def _tissue(rng: np.random.Generator, radius: float = 8.0) -> tuple[tuple[float, ...], ...]:
    """Centres of 4 cells that press on each other, radii."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    places = corners @ turn * radius * 0.95
    sizes = radius * rng.uniform(0.9, 1.1, 4)
    return tuple((*p.tolist(), s) for p, s in zip(places, sizes, strict=True))


def _labelled_tissue(rng: np.random.Generator) -> Recipe:
    """Four cells that share walls, all with labels."""
    cells, names, size = _tissue(rng), (1, 2, 3, 4), (44, 44, 44)
    return Recipe(cells, names, True, roughness=0.08, shape=size, seeds="labels")


def _crowd(rng: np.random.Generator, **others: Any) -> Recipe:
    """Eight cells of unequal brightness, side by side, all with labels."""
    corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    radii, cells = rng.uniform(5.5, 8, 8), []
    for corner, radius in zip(corners @ turn, radii, strict=True):
        cells.append((*(corner * (8.2 + rng.uniform(0.5, 1.5))).tolist(), float(radius)))
    names = tuple(range(1, 9))
    given = {"roughness": 0.08, "shape": (54, 54, 54), "seeds": "labels", "unequal": 0.4}
    return Recipe(tuple(cells), names, photons=rng.uniform(20, 200), **(given | others))


def _mixed(rng: np.random.Generator) -> Recipe:
    """One cell in which everything differs at once, and perhaps neighbours without a seed."""

    def sometimes(share: float, low: float, high: float) -> float:
        value = rng.uniform(low, high)
        return value if rng.random() < share else 0.0

    radius, aspect = float(np.exp(rng.uniform(np.log(5), np.log(26)))), rng.choice([1, 1, 2, 3, 5])
    side = int(2.9 * radius) + 12
    membrane = 0.0 if rng.random() < 0.25 else 1.0
    cells = [(0.0, 0.0, 0.0, radius)]
    for _ in range(rng.integers(0, 3) if radius < 15 else 0):
        away = rng.normal(size=3)
        other = radius * rng.uniform(0.6, 1.0)
        place = (radius + other + rng.uniform(2.5, 5)) * away / np.linalg.norm(away)
        if all(np.linalg.norm(place - np.array(c[:3])) > other + c[3] + 2 for c in cells):
            cells.append((*place.tolist(), other))
    widest = max(0.8, min(2.5, radius / 5))
    return Recipe(
        cells=tuple(cells),
        roughness=rng.uniform(0.0, 0.2),
        shape=(max(10, round(side / aspect)), side, side),
        aspect=float(aspect),
        psf=(max(0.6, rng.uniform(0.8, 2) * widest / aspect), rng.uniform(0.6, widest)),
        photons=float(np.exp(rng.uniform(np.log(5), np.log(500)))),
        dark=float(np.exp(rng.uniform(np.log(0.5), np.log(30)))),
        membrane=membrane,
        interior=sometimes(0.4, 0.1, 1.0) if membrane else 1.0,
        uneven=sometimes(0.5, 0.1, 0.7),
        textured=sometimes(0.3, 0.1, 0.4),
        haze=sometimes(0.2, 0.1, 0.6),
        specks=int(sometimes(0.2, 3, 12)),
        thickness=sometimes(0.15, 1.5, 5.0) if radius > 10 else 0.0,
        seeds=str(rng.choice(["labels", "spheres", "mesh"])),  # type: ignore[arg-type]
        start=(rng.uniform(0.7, 1.15), rng.uniform(0.0, 0.3)),
    )


PLAIN = Recipe()
KINDS: dict[str, Callable[[np.random.Generator], Recipe]] = {
    "plain": lambda rng: replace(
        PLAIN, photons=rng.uniform(30, 100), psf=(rng.uniform(1, 2.5), rng.uniform(0.9, 1.4))
    ),
    "dim": lambda rng: replace(PLAIN, photons=rng.uniform(3, 8), dark=1.0),
    "bright": lambda rng: replace(PLAIN, photons=1000.0, dark=50.0, roughness=0.2),
    "uneven": lambda rng: replace(PLAIN, uneven=0.6, told=("--density", "smooth")),
    "textured": lambda rng: replace(PLAIN, textured=0.5, told=("--density", "smooth")),
    "narrow": lambda rng: replace(PLAIN, psf=(0.6, 0.6), photons=100.0),
    "wide": lambda rng: replace(PLAIN, psf=(rng.uniform(2.4, 3), rng.uniform(2.4, 3))),
    "haze": lambda rng: replace(PLAIN, haze=0.8, told=("--structure", "both")),
    "nucleus": lambda rng: replace(
        PLAIN, membrane=0.0, interior=1.0, roughness=0.18, told=("--structure", "interior")
    ),
    "both": lambda rng: replace(
        PLAIN, interior=rng.uniform(0.3, 0.8), told=("--structure", "both")
    ),
    "thick": lambda rng: replace(
        PLAIN, thickness=rng.uniform(3, 8), cells=((0, 0, 0, 13.0),), shape=(48, 48, 48)
    ),
    "neighbours-labels": lambda rng: _neighbours(rng, "labels"),
    "neighbours-spheres": lambda rng: _neighbours(rng, "spheres"),
    "neighbours-mesh": lambda rng: _neighbours(rng, "mesh"),
    "neighbours-points": lambda rng: _neighbours(rng, "points"),
    "specks": lambda rng: replace(PLAIN, specks=12, seeds="labels"),
    "cut": lambda rng: replace(
        PLAIN, cells=((0, rng.uniform(9, 15), 3.0, 11.0),), seeds="labels", shape=(36, 36, 36)
    ),
    "cut-deep": lambda rng: replace(
        PLAIN, cells=((rng.uniform(10, 16), 13.0, 3.0, 11.0),), shape=(36, 36, 36)
    ),
    "tissue": _labelled_tissue,
    "tissue-spheres": lambda rng: replace(
        _labelled_tissue(rng), seeds="spheres", start=(0.95, 0.05)
    ),
    "crowd": _crowd,
    "crowd-nuclei": lambda rng: _crowd(rng, membrane=0.0, interior=1.0),
    "crowd-nuclei-spheres": lambda rng: _crowd(rng, membrane=0.0, interior=1.0, seeds="spheres"),
    "crowd-both": lambda rng: _crowd(rng, interior=rng.uniform(0.2, 0.8)),
    "crowd-bright": lambda rng: _crowd(rng, interior=rng.uniform(1.0, 2.5)),
    "tissue-both": lambda rng: replace(
        _labelled_tissue(rng), interior=rng.uniform(0.2, 0.8), unequal=0.4
    ),
    "tissue-partial": lambda rng: replace(_labelled_tissue(rng), seeded=(1, 2)),
    "grainy-nuclei": lambda rng: _crowd(
        rng, membrane=0.0, interior=1.0, grain=rng.uniform(0.2, 0.5)
    ),
    "fading": lambda rng: replace(PLAIN, fading=rng.uniform(0.2, 0.5)),
    "fading-tissue": lambda rng: replace(
        _labelled_tissue(rng), interior=rng.uniform(0.0, 0.5), fading=rng.uniform(0.2, 0.5)
    ),
    "tilted": lambda rng: replace(PLAIN, tilted=(rng.uniform(-40, 40), rng.uniform(-10, 10))),
    "tilted-nuclei": lambda rng: replace(
        _crowd(rng, membrane=0.0, interior=1.0), tilted=(rng.uniform(-60, 60), 0.0)
    ),
    "padded": lambda rng: replace(PLAIN, padded=rng.uniform(0.4, 0.7)),
    "padded-tissue": lambda rng: replace(_labelled_tissue(rng), padded=rng.uniform(0.4, 0.6)),
    "neighbours-nuclei": lambda rng: replace(
        _neighbours(rng, "labels"), membrane=0.0, interior=1.0, unequal=0.4
    ),
    "flat": lambda rng: replace(
        PLAIN, aspect=rng.uniform(3.5, 5), shape=(16, 44, 44), cells=((0, 0, 0, 13.0),)
    ),
    "mixed": _mixed,
    "wrong-start": lambda rng: replace(PLAIN, start=(0.6, 0.4)),
}
