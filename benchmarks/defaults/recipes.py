"""What images show: the kinds of scenes, drawn at random."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

SeedKind = Literal["labels", "spheres", "points", "mesh", "auto"]
Microscope = Literal["", "widefield", "confocal", "sheet"]


@dataclass(frozen=True)
class Recipe:
    """What one image shows; lengths in voxels of the smallest side, light relative to membranes."""

    cells: tuple[tuple[float, float, float, float], ...] = ((0, 0, 0, 11),)  # offset Z Y X, radius
    seeded: tuple[int, ...] = (1,)  # cells that have a seed, from 1
    together: bool = False  # cells share walls
    flattened: float = 1.0  # height of each cell that shares none, of what it would be
    roughness: float = 0.12
    shape: tuple[int, int, int] = (40, 40, 40)
    aspect: float = 1.0  # Z over lateral voxel side
    psf: tuple[float, float] = (1.2, 1.2)  # standard deviation along Z (of its voxels) and in plane
    microscope: Microscope = ""  # of NA 1.2 in water, as wide in plane; else the PSF is a Gaussian
    aberrated: float = 0.0  # rad, root mean square, of spherical aberration of that microscope
    leaning: float = 0.0  # degrees from Z towards X, of its axis
    photons: float = 60.0
    dark: float = 6.0
    membrane: float = 1.0
    interior: float = 0.0  # of the brightness of the membrane in the image
    uneven: float = 0.0  # standard deviation of the log density, smooth over the cell
    textured: float = 0.0  # the same, over a few voxels
    haze: float = 0.0  # light outside, of the membrane's brightness
    body: tuple[float, float] = (0.0, 0.0)  # light around each, as far as so many times its radius
    arms: int = 0  # fingers of each cell, too thin for a dark inside
    specks: int = 0
    thickness: float = 0.0
    unequal: float = 0.0  # standard deviation of the log brightness from cell to cell
    grain: float = 0.0  # the same inside cells, over a few voxels: chromatin
    clump: float = 1.7  # voxels in plane over which that is smooth
    nucleoli: int = 0  # balls inside each cell that are a third as bright
    nucleus: float = 0.0  # radius of one that is a quarter as bright, of that of its cell
    fading: float = 1.0  # brightness of the last slice, of that of the first
    tilted: tuple[float, float] = (
        0.0,
        0.0,
    )  # how the background rises along X, and squared; photons
    padded: float = 0.0  # share of the sum of Z and X below which nothing was measured
    grown: int = 0  # voxels by which labels reach out too far
    shrunk: float = 1.0  # share of its depth that each label keeps, as one of a nucleus may
    topless: float = 0.0  # share of its height that each label lacks at the top
    seeds: SeedKind = "spheres"
    start: tuple[float, float] = (0.9, 0.1)  # radius of spheres and meshes, offset, in radii
    told: tuple[str, ...] = ()  # what the command that knows all is told besides the PSF
    all_labelled: bool = False  # cells without a seed have labels, too, but do not count


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


def _packed(rng: np.random.Generator, **others: Any) -> Recipe:
    """Small nuclei, close together, dim and bright, in a stack that they fill to a third."""
    shape, cells = (32, 48, 48), list[tuple[float, ...]]()
    for trial in range(20_000):  # the large ones first
        radius = rng.uniform(4.5, 8.0) if trial < 4000 else rng.uniform(4.0, 5.5)
        place = rng.uniform(-0.5, 0.5, 3) * (np.array(shape) - radius)
        if all(np.linalg.norm(place - np.array(c[:3])) > radius + c[3] + 0.5 for c in cells):
            cells.append((*place.tolist(), radius))
    names = tuple(range(1, len(cells) + 1))
    given = {"roughness": 0.06, "seeds": "labels", "unequal": 0.3, "membrane": 0.0, "interior": 1.0}
    light = {"psf": (rng.uniform(1.5, 2.5), 1.2), "photons": rng.uniform(120, 200), "dark": 120.0}
    return Recipe(tuple(cells), names, shape=shape, **(given | light | others))  # type: ignore[arg-type]


def _partly_seeded(rng: np.random.Generator) -> Recipe:
    """The same; of every three, one has no seed."""
    whole = _packed(rng)
    return replace(whole, seeded=tuple(k for k in whole.seeded if k % 3))


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


def _chromatin(rng: np.random.Generator, **others: Any) -> Recipe:
    """One nucleus of any size with chromatin, coarse or fine, and nucleoli."""
    radius, aspect = float(np.exp(rng.uniform(np.log(9), np.log(26)))), rng.choice([1, 1, 2, 3, 5])
    side, widest = int(2.9 * radius) + 12, max(0.9, min(2.5, radius / 6))
    given = {
        "cells": ((0.0, 0.0, 0.0, radius),),
        "shape": (max(10, round(side / aspect)), side, side),
        "aspect": float(aspect),
        "psf": (max(0.6, rng.uniform(0.8, 2) * widest / aspect), rng.uniform(0.8, widest)),
        "roughness": rng.uniform(0.05, 0.2),
        "photons": float(np.exp(rng.uniform(np.log(30), np.log(300)))),
        "membrane": 0.0,
        "interior": 1.0,
        "grain": rng.uniform(0.15, 0.5),
        "clump": rng.uniform(1.0, 3.0),
        "nucleoli": int(rng.integers(0, 5)),
        "seeds": str(rng.choice(["labels", "spheres"])),
        "told": ("--structure", "interior"),
    }
    return Recipe(**(given | others))  # type: ignore[arg-type]


def _cytoplasm(rng: np.random.Generator) -> Recipe:
    """One cell of any size whose cytoplasm shines and whose nucleus does not."""
    given = {"grain": rng.uniform(0.05, 0.3), "nucleoli": 0, "nucleus": rng.uniform(0.45, 0.65)}
    return _chromatin(rng, seeds=str(rng.choice(["labels", "spheres", "points"])), **given)


def _cut_chromatin(rng: np.random.Generator) -> Recipe:
    """The same in a few slices that begin or end within the nucleus."""
    whole = _chromatin(rng, aspect=float(rng.choice([3, 5])), seeds="labels")
    side, radius = whole.shape[1], whole.cells[0][3]
    slices = max(6, round(side / whole.aspect * rng.uniform(0.4, 0.7)))
    beyond = radius * rng.uniform(0.0, 0.5)
    place = (slices * whole.aspect / 2 - radius + beyond) * rng.choice([-1, 1])
    psf = (max(0.6, whole.psf[1] * rng.uniform(1.5, 3) / whole.aspect), whole.psf[1])
    return replace(whole, cells=((place, 0.0, 0.0, radius),), shape=(slices, side, side), psf=psf)


def _flat_nuclei(rng: np.random.Generator) -> Recipe:
    """Two flat nuclei, as of cells on glass, in a few slices that may cut them; with chromatin."""
    aspect, high = rng.choice([3.0, 5.0]), rng.uniform(2.5, 6.0)  # slices
    radii = rng.uniform(20.0, 34.0, 2)
    slices = max(5, round(high + rng.uniform(1.5, 4.0)))
    beyond = rng.uniform(0.0, 0.4) * high if rng.random() < 0.6 else -0.5  # cut by the first one
    depth = (high / 2 - beyond - (slices - 1) / 2) * aspect
    places = (-radii[0] - 1.5, radii[1] + 1.5)
    cells = [(depth, 0.0, float(x), float(r)) for x, r in zip(places, radii, strict=True)]
    return Recipe(
        tuple(cells),
        (1, 2),
        flattened=high * aspect / (2 * float(radii.mean())),
        roughness=rng.uniform(0.05, 0.12),
        shape=(slices, 96, 168),
        aspect=float(aspect),
        psf=(rng.uniform(0.7, 1.3), rng.uniform(0.8, 1.8)),
        photons=float(np.exp(rng.uniform(np.log(20), np.log(200)))),
        membrane=0.0,
        interior=1.0,
        unequal=0.4,
        grain=rng.uniform(0.1, 0.6),
        clump=rng.uniform(1.0, 3.0),
        nucleoli=int(rng.integers(0, 5)),
        seeds="labels",
        told=("--structure", "interior"),
    )


def _confluent(rng: np.random.Generator) -> Recipe:
    """Cells that fill the stack; only those count of which half a cell or more lies in it."""
    shape, radius = (30, 42, 42), rng.uniform(7, 9)
    reach = np.array(shape) + 4.4 * radius
    cloud = rng.uniform(-0.5, 0.5, (8000, 3)) * reach
    places = cloud[: int(np.prod(reach) / (4.2 * radius**3))]
    for _ in range(12):
        nearest = ((cloud[:, None] - places) ** 2).sum(2).argmin(1)
        places = np.array([cloud[nearest == k].mean(0) for k in range(len(places))])
    near = (np.abs(places) < np.array(shape) / 2 + 0.9 * radius).all(1)
    cells = tuple((*p.tolist(), 1.35 * radius) for p in places[near])
    within = (np.abs(places[near]) < np.array(shape) / 2).all(1)
    seeded = tuple(int(k) for k in np.flatnonzero(within) + 1)
    light = {"unequal": 0.2, "interior": rng.choice([0.0, 0.4]), "psf": (1.2, 1.1)}
    given = {"shape": shape, "seeds": "labels", "all_labelled": True, **light}
    return Recipe(cells, seeded, True, roughness=0.03, **given)


def _lit_nuclei(rng: np.random.Generator) -> Recipe:
    """One nucleus, or four, in cytoplasm that shines less; bodies may touch and be cut."""
    aspect = float(rng.choice([1, 2]))
    cells: list[tuple[float, ...]] = [(0.0, 0.0, 0.0, rng.uniform(7.0, 14.0))]
    if rng.random() < 0.7:
        away = rng.uniform(1.4, 2.1)
        cells = [
            (*(away * np.array(c[:3])).tolist(), c[3]) for c in _tissue(rng, rng.uniform(7.0, 9.0))
        ]
    return Recipe(
        tuple(cells),  # type: ignore[arg-type]
        tuple(range(1, len(cells) + 1)),
        shape=(round(60 / aspect), 60, 60),
        aspect=aspect,
        psf=(rng.uniform(1.0, 2.0) * (1.5 / aspect), rng.uniform(0.8, 1.6)),
        microscope=str(rng.choice(["", "confocal"])),  # type: ignore[arg-type]
        photons=float(np.exp(rng.uniform(np.log(30), np.log(300)))),
        membrane=0.0,
        interior=1.0,
        unequal=0.2,
        body=(rng.uniform(0.05, 0.4), rng.uniform(1.4, 2.0)),
        grain=float(rng.choice([0.0, 0.2])),
        seeds="labels",
        told=("--structure", "interior"),
    )


def _flat_voxels(rng: np.random.Generator, microscope: Microscope, **others: Any) -> Recipe:
    """One cell, in voxels twice as deep as wide."""
    given = {"cells": ((0, 0, 0, 12.0),), "shape": (24, 48, 48), "aspect": 2.0}
    return replace(PLAIN, microscope=microscope, photons=rng.uniform(30, 100), **(given | others))


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
    "both-grown": lambda rng: replace(
        PLAIN, interior=rng.uniform(0.3, 1.0), seeds="labels", grown=2, told=("--structure", "both")
    ),
    "thick": lambda rng: replace(
        PLAIN, thickness=rng.uniform(3, 8), cells=((0, 0, 0, 13.0),), shape=(48, 48, 48)
    ),
    "neighbours-labels": lambda rng: _neighbours(rng, "labels"),
    "neighbours-spheres": lambda rng: _neighbours(rng, "spheres"),
    "neighbours-mesh": lambda rng: _neighbours(rng, "mesh"),
    "neighbours-points": lambda rng: _neighbours(rng, "points"),
    "specks": lambda rng: replace(PLAIN, specks=12, seeds="labels"),
    "arms": lambda rng: replace(PLAIN, arms=3, roughness=0.05, shape=(48, 48, 48)),
    "arms-point": lambda rng: replace(
        PLAIN, arms=4, roughness=0.05, shape=(48, 48, 48), seeds="points"
    ),
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
    "crowd-grown": lambda rng: _crowd(rng, interior=rng.uniform(0.3, 1.0), grown=2),
    "crowd-bright": lambda rng: _crowd(rng, interior=rng.uniform(1.0, 2.5)),
    "topless": lambda rng: replace(
        PLAIN,
        membrane=float(rng.random() < 0.5),
        interior=1.0,
        seeds="labels",
        topless=rng.uniform(0.2, 0.4),
    ),
    "topless-crowd": lambda rng: _crowd(rng, topless=rng.uniform(0.2, 0.4)),
    "tissue-both": lambda rng: replace(
        _labelled_tissue(rng), interior=rng.uniform(0.2, 0.8), unequal=0.4
    ),
    "marked": lambda rng: replace(
        PLAIN,
        interior=float(rng.choice([0.0, 0.5])),
        seeds="labels",
        shrunk=rng.uniform(0.4, 0.7),
    ),
    "marked-tissue": lambda rng: replace(
        _labelled_tissue(rng),
        interior=float(rng.choice([0.0, 0.5])),
        shrunk=rng.uniform(0.4, 0.7),
    ),
    "tissue-partial": lambda rng: replace(_labelled_tissue(rng), seeded=(1, 2)),
    "packed-nuclei": _packed,
    "packed-partial": _partly_seeded,
    "packed-hazy": lambda rng: _packed(rng, haze=0.3),
    "tissue-insides": lambda rng: replace(
        _labelled_tissue(rng), membrane=0.0, interior=1.0, unequal=rng.choice([0.0, 0.4])
    ),
    "grainy-nuclei": lambda rng: _crowd(
        rng, membrane=0.0, interior=1.0, grain=rng.uniform(0.2, 0.5)
    ),
    "chromatin": _chromatin,
    "chromatin-cut": _cut_chromatin,
    "cytoplasm": _cytoplasm,
    "crowd-cytoplasm": lambda rng: _crowd(
        rng,
        membrane=0.0,
        interior=1.0,
        nucleus=rng.uniform(0.45, 0.6),
        told=("--structure", "interior"),
    ),
    "flat-nuclei": _flat_nuclei,
    "lit-nuclei": _lit_nuclei,
    "chromatin-both": lambda rng: _chromatin(
        rng, membrane=1.0, interior=rng.uniform(0.3, 1.2), told=("--structure", "both")
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
    "widefield": lambda rng: _flat_voxels(rng, "widefield"),
    "widefield-nucleus": lambda rng: _flat_voxels(rng, "widefield", membrane=0.0, interior=1.0),
    "widefield-haze": lambda rng: _flat_voxels(rng, "widefield", haze=rng.uniform(0.2, 0.6)),
    "widefield-haze-small": lambda rng: _flat_voxels(
        rng, "widefield", haze=0.4, cells=((0, 0, 0, 7.0),)
    ),
    "widefield-haze-tissue": lambda rng: replace(
        _labelled_tissue(rng), microscope="widefield", haze=0.4
    ),
    "widefield-tissue": lambda rng: replace(_labelled_tissue(rng), microscope="widefield"),
    "confocal": lambda rng: _flat_voxels(rng, "confocal"),
    "confocal-nuclei": lambda rng: _crowd(
        rng, membrane=0.0, interior=1.0, microscope="confocal", aspect=2.0, shape=(30, 54, 54)
    ),
    "aberrated": lambda rng: _flat_voxels(
        rng, "confocal", aberrated=rng.uniform(0.4, 0.8), shape=(30, 48, 48)
    ),
    "aberrated-widefield": lambda rng: _flat_voxels(
        rng, "widefield", aberrated=rng.uniform(0.4, 0.8), shape=(30, 48, 48)
    ),
    "leaning": lambda rng: _flat_voxels(
        rng, "sheet", leaning=rng.choice([-1, 1]) * rng.uniform(25, 45), shape=(34, 44, 44)
    ),
    "leaning-nuclei": lambda rng: _crowd(
        rng,
        membrane=0.0,
        interior=1.0,
        microscope="sheet",
        leaning=rng.choice([-1, 1]) * rng.uniform(25, 45),
    ),
    "aberrated-nuclei": lambda rng: _crowd(
        rng,
        membrane=0.0,
        interior=1.0,
        microscope="confocal",
        aberrated=rng.uniform(0.4, 0.8),
        aspect=2.0,
        shape=(36, 54, 54),
    ),
    "confluent": _confluent,
    "mixed": _mixed,
    "wrong-start": lambda rng: replace(PLAIN, start=(0.6, 0.4)),
}

WORDS = {
    "plain": "a membrane",
    "dim": "a membrane, 3 to 8 photons",
    "bright": "a membrane, 1000 photons",
    "uneven": "a membrane of uneven brightness",
    "textured": "a membrane with texture of a few voxels",
    "narrow": "a membrane, PSF of 0.6 voxel",
    "wide": "a membrane, PSF of 2.4 to 3 voxels",
    "haze": "a membrane in a haze of 0.8 of its brightness",
    "nucleus": "a nucleus",
    "both": "membrane and inside",
    "both-grown": "the same, its label two voxels too large",
    "thick": "a layer 3 to 8 voxels thick",
    "neighbours-labels": "a cell among five without a seed, labelled",
    "neighbours-spheres": "the same from a sphere",
    "neighbours-mesh": "the same from a mesh",
    "neighbours-points": "the same from a point",
    "specks": "a membrane among bright specks",
    "arms": "a cell with three thin fingers, from a sphere",
    "arms-point": "a cell with four thin fingers, from a point",
    "cut": "a cell that the border cuts",
    "cut-deep": "the same, at a corner",
    "tissue": "four cells that share walls, labelled",
    "tissue-spheres": "the same from spheres",
    "crowd": "eight cells side by side, unequally bright",
    "crowd-nuclei": "eight nuclei side by side, unequally bright",
    "crowd-nuclei-spheres": "the same from spheres",
    "crowd-both": "eight cells, membranes and dimmer insides",
    "crowd-grown": "the same, labels two voxels too large",
    "crowd-bright": "eight cells, insides brighter than membranes",
    "topless": "one cell, its label lacks a fifth to two fifths at the top",
    "topless-crowd": "eight cells, their labels the same",
    "tissue-both": "four cells that share walls, membranes and unequal insides",
    "marked": "a cell, its label reaches 0.4 to 0.7 times as far, as that of a nucleus",
    "marked-tissue": "four cells that share walls, their labels the same",
    "tissue-partial": "two of four cells that share walls, labelled",
    "packed-nuclei": "some 40 small nuclei, packed, dim and bright",
    "packed-partial": "the same, one of three without a label",
    "packed-hazy": "the same, all labelled, in a haze",
    "tissue-insides": "four cells that share walls, insides alone",
    "grainy-nuclei": "eight nuclei with chromatin",
    "chromatin": "a nucleus with chromatin and nucleoli",
    "chromatin-cut": "the same, cut by the border, in a few slices",
    "cytoplasm": "a cell whose cytoplasm shines and whose nucleus does not",
    "crowd-cytoplasm": "eight such cells, side by side",
    "flat-nuclei": "two flat nuclei with chromatin, in a few slices",
    "lit-nuclei": "nuclei in cytoplasm that shines less",
    "chromatin-both": "a membrane, and an inside with chromatin",
    "fading": "a membrane that fades along Z",
    "fading-tissue": "four cells that share walls, fading along Z",
    "tilted": "a membrane, background rising along X",
    "tilted-nuclei": "eight nuclei, background rising along X",
    "padded": "a membrane in a padded stack",
    "padded-tissue": "four cells that share walls, in a padded stack",
    "neighbours-nuclei": "a nucleus among five without a seed",
    "flat": "a cell, voxels 3.5 to 5 times as tall as wide",
    "widefield": "a membrane, widefield",
    "widefield-nucleus": "a nucleus, widefield",
    "widefield-haze": "a membrane in a haze, widefield",
    "widefield-haze-small": "a cell 14 voxels wide in a haze, widefield",
    "widefield-haze-tissue": "four cells that share walls in a haze, widefield",
    "widefield-tissue": "four cells that share walls, widefield",
    "confocal": "a membrane, confocal",
    "confocal-nuclei": "eight nuclei, confocal",
    "aberrated": "a membrane, confocal with spherical aberration",
    "aberrated-widefield": "a membrane, widefield with spherical aberration",
    "leaning": "a membrane in a deskewed light sheet, whose PSF leans",
    "leaning-nuclei": "eight nuclei in such a sheet",
    "aberrated-nuclei": "eight nuclei, confocal with spherical aberration",
    "confluent": "cells that fill the stack, labelled",
    "mixed": "all of these at once, cells of 10 to 52 voxels",
    "wrong-start": "a membrane, start of 0.6 of its size, 0.4 radii beside it",
}
