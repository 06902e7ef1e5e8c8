"""Scenes in which everything is drawn at random: what no kind of the suite shows by itself.

One cell of 4 to 32 voxels in radius, one among strangers, or a group; membranes, insides or both.
The ranges are those of the stacks that people bring, as far as a process fits them in a minute.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .recipes import Recipe

ANYTHING = "anything"  # the name of the kind
_SMALLEST, _LARGEST = 4.0, 32.0  # radii of cells, voxels in plane
_GROUP = 13.0  # the largest radius in a group


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _places(rng: np.random.Generator, radius: float, count: int) -> list[tuple[float, ...]]:
    """Cells around a first one, each a voxel or more from the others."""
    cells = [(0.0, 0.0, 0.0, radius)]
    for _ in range(200):
        if len(cells) == count:
            break
        other, away = radius * rng.uniform(0.6, 1.3), rng.normal(size=3)
        beside = cells[rng.integers(len(cells))]
        reach = (beside[3] + other) * rng.uniform(1.1, 1.35) + 1.0
        place = np.array(beside[:3]) + reach * away / np.linalg.norm(away)
        room = (np.linalg.norm(place - np.array(c[:3])) - other - c[3] for c in cells)
        if min(room) > 0.08 * radius + 1.0:
            cells.append((*place.tolist(), other))
    return cells


def _light(rng: np.random.Generator, radius: float) -> dict[str, float | int]:
    """What shines: membranes, insides or both, uneven or not, and what lies around."""

    def sometimes(share: float, low: float, high: float) -> float:
        value = rng.uniform(low, high)
        return value if rng.random() < share else 0.0

    shines = rng.choice(["membrane", "membrane", "interior", "both"])
    light: dict[str, float | int] = {
        "membrane": float(shines != "interior"),
        "interior": {"membrane": 0.0, "interior": 1.0, "both": _log(rng, 0.15, 3.0)}[shines],
        "uneven": sometimes(0.4, 0.1, 0.7),
        "textured": sometimes(0.3, 0.1, 0.4),
        "haze": sometimes(0.25, 0.1, 0.7),
        "specks": int(sometimes(0.2, 2, 10)),
        "fading": sometimes(0.2, 0.2, 0.8) or 1.0,
    }
    if shines == "membrane":
        light["thickness"] = sometimes(0.15, 1.5, 6.0) if radius > 10 else 0.0
    else:
        light["grain"], light["clump"] = sometimes(0.5, 0.1, 0.5), rng.uniform(1, 3)
        light["nucleoli"] = int(sometimes(0.4, 1, 5)) if shines == "interior" else 0
    return light


def anything(rng: np.random.Generator) -> Recipe:
    """A scene of which nothing is known beforehand."""
    what = rng.choice(["one", "one", "strangers", "group"])
    largest = _LARGEST if what == "one" else _GROUP
    radius, aspect = _log(rng, _SMALLEST, largest), float(rng.choice([1, 1, 2, 3, 5]))
    cells = _places(rng, radius, 1 if what == "one" else int(rng.integers(2, 7)))
    places = np.array([c[:3] for c in cells])
    places -= (places.min(0) + places.max(0)) / 2 if what == "group" else places[0]
    reach = np.abs(places).max(0) * (what == "group") + 1.45 * max(c[3] for c in cells) + 5
    cut = reach * rng.uniform(-0.5, 0.5, 3) * (rng.random(3) < 0.15) * (what == "one")
    size = np.ceil(2 * reach / (aspect, 1, 1)).astype(int)
    widest = max(0.8, min(3.0, radius / 4))
    across = _log(rng, 0.6, widest)
    shape = int(max(8, size[0])), int(size[1]), int(size[2])
    recipe = Recipe(
        cells=tuple((*(p + cut).tolist(), c[3]) for p, c in zip(places, cells, strict=True)),
        seeded=tuple(range(1, len(cells) + 1)) if what == "group" else (1,),
        roughness=rng.uniform(0.0, 0.2),
        shape=shape,
        aspect=aspect,
        psf=(max(0.6, across * rng.uniform(1, 3) / aspect), across),
        photons=_log(rng, 4, 1000),
        dark=_log(rng, 0.5, 30),
        unequal=rng.choice([0.0, 0.3]),
        grown=int(rng.choice([0, 0, 0, 1, 2])),
        seeds=str(rng.choice(["labels", "spheres", "points", "mesh"])),  # type: ignore[arg-type]
        start=(rng.uniform(0.7, 1.15), rng.uniform(0.0, 0.3)),
        **_light(rng, radius),  # type: ignore[arg-type]
    )
    shines = ("both" if recipe.membrane else "interior") if recipe.interior else "membrane"
    recipe = replace(recipe, told=("--structure", shines))
    if rng.random() < 0.25 and np.prod(shape) < 1e6:
        recipe = replace(recipe, microscope=str(rng.choice(["widefield", "confocal"])))  # type: ignore[arg-type]
    return recipe
