"""What a look before the fit makes of images in order and of spoilt ones.

``python -m benchmarks.defaults.sanity``: three draws of every kind of scene as they are, and
twenty-two with a wrong voxel size, leaning slices, cut brightness, time for depth, labels for an
image, no or another structure.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, shift

from benchmarks.shapes import scaled
from napari_deltamic import Mesh
from napari_deltamic.evidence.compressed_brightness import bright_over_dark
from napari_deltamic.evidence.sanity import (
    doubts,
    elongation,
    first_sigma,
    followed,
    lasting,
    structured,
)
from napari_deltamic.geometry import mesh_from_labels, sphere
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.scene import Grid

from ..figure import Row, at_least, at_most
from ..page import put_between, table
from ..tree import commit
from .scenes import KINDS, Scene, made, rng_of

Triple = tuple[float, float, float]
DRAWS = 3


@dataclass(frozen=True)
class Case:
    """What is looked at."""

    name: str
    image: np.ndarray
    voxel_size: Triple
    seeds: Mesh | None
    close: bool = False  # seeds that follow the image
    expected: str = ""  # the kind of doubt; none for what is in order


def as_it_is(scene: Scene) -> Case:
    """With the seeds that the command gets."""
    scale, offset = scene.recipe.start
    if scene.recipe.seeds in ("labels", "points"):
        seeds = mesh_from_labels(scene.labels, scene.voxel_size)
    else:
        names = scene.recipe.seeded
        direction = np.array([0.48, 0.6, 0.64])
        seeds = Mesh.merge(
            [
                sphere(scene.centres[k] + offset * scene.radii[k] * direction, scale * r)
                for k, r in ((k, scene.radii[k]) for k in names)
            ]
        )
    close = scene.recipe.seeds in ("labels", "points")
    return Case(scene.name, scene.image, scene.voxel_size, seeds, close)


def z_times(case: Case, factor: float) -> Case:
    """The step along Z is wrong; seeds that follow the image are wrong with it."""
    z, y, x = case.voxel_size
    seeds = case.seeds
    if case.close and seeds is not None:
        seeds = scaled(seeds, (factor, 1, 1))
    wrong = (z * factor, y, x)
    return replace(case, voxel_size=wrong, seeds=seeds, expected="voxel size")


def in_nanometres(case: Case) -> Case:
    """Numbers in nm, taken for um."""
    z, y, x = (1000 * v for v in case.voxel_size)
    return replace(case, voxel_size=(z, y, x), seeds=None, expected="voxel size")


def turned(case: Case) -> Case:
    """X Y Z given for Z Y X."""
    z, y, x = case.voxel_size
    return replace(case, voxel_size=(x, y, z), seeds=None, expected="voxel size")


def leaning(case: Case, slope: float) -> Case:
    """Every slice further on than the one before."""
    step = slope * case.voxel_size[0] / case.voxel_size[1]
    slices = [
        shift(s, ((k - len(case.image) / 2) * step, 0), order=1, mode="nearest")
        for k, s in enumerate(case.image)
    ]
    return replace(case, image=np.stack(slices), seeds=None, expected="lean")


def cut_off(case: Case, share: float) -> Case:
    """Bright voxels at the end of the camera's range, in 8 bits."""
    top = share * float(np.percentile(case.image, 99.9))
    counts = np.minimum(case.image / top * 255, 255).astype(np.uint8)
    return replace(case, image=counts, expected="saturation")


def of_another(case: Case, other: Case) -> Case:
    """Seeds of one image on another."""
    return replace(case, image=other.image, voxel_size=other.voxel_size, expected="seeds")


def noise_only(case: Case, rng: np.random.Generator) -> Case:
    """Nothing there."""
    image = rng.poisson(12.0, case.image.shape).astype(np.float32)
    return replace(case, image=image, expected="empty")


def haze_only(case: Case, rng: np.random.Generator) -> Case:
    """Light, but of nothing that the seeds are about."""
    field = gaussian_filter(rng.normal(size=case.image.shape), 4)
    field = 10 + 30 * (field - field.min()) / np.ptp(field)
    return replace(case, image=rng.poisson(field).astype(np.float32), expected="seeds")


def as_film(case: Case, rng: np.random.Generator) -> Case:
    """One slice again and again, moving a little."""
    middle = gaussian_filter(case.image[len(case.image) // 2], 0.7)
    path = np.cumsum(rng.normal(0, 0.15, (len(case.image), 2)), 0)
    frames = [shift(middle, d, order=1, mode="nearest") for d in path]
    image = rng.poisson(np.maximum(np.stack(frames), 0.1)).astype(np.float32)
    return replace(case, image=image, seeds=None, expected="time")


def as_labels(case: Case, mask: bool) -> Case:
    """Seeds drawn into voxels in place of the image."""
    assert case.seeds is not None
    labels = voxel_labels(case.seeds, case.image.shape, case.voxel_size)
    image = (labels > 0 if mask else labels).astype(np.float32)
    return replace(case, image=image, expected="labels")


def spoilt(cases: dict[str, Case], rng: np.random.Generator) -> Iterator[Case]:
    """Twenty-two."""
    for name in ("plain-0", "tissue-1", "neighbours-labels-1", "nucleus-0"):
        yield z_times(cases[name], 4)
    for name in ("uneven-0", "tissue-spheres-1", "both-1"):
        yield z_times(cases[name], 0.25)
    yield replace(z_times(cases["haze-1"], 4), seeds=None)
    yield in_nanometres(cases["plain-1"])
    yield turned(cases["flat-0"])
    for name, slope in (("tissue-0", 1.0), ("neighbours-mesh-0", 0.62), ("textured-1", -1.5)):
        yield leaning(cases[name], slope)
    yield cut_off(cases["plain-2"], 0.6)
    yield cut_off(cases["tissue-2"], 0.8)
    yield of_another(cases["plain-0"], cases["cut-deep-1"])
    yield haze_only(cases["both-0"], rng)
    yield noise_only(cases["tissue-0"], rng)
    yield as_film(cases["tissue-0"], rng)
    yield as_film(cases["neighbours-mesh-1"], rng)
    yield as_labels(cases["packed-nuclei-0"], mask=False)
    yield as_labels(cases["tissue-1"], mask=True)


def measured(case: Case) -> str:
    """The numbers that decide, for choosing thresholds."""
    pixels = np.asarray(case.image, np.float32)
    width = first_sigma(pixels, case.voxel_size)
    known = width.z.value is not None and width.yx.value is not None
    ratio = width.z.value / width.yx.value if known else np.nan
    grid = Grid(pixels.shape, case.voxel_size)
    follows = np.nan if case.seeds is None else followed(pixels, grid, case.seeds)
    longer = elongation(pixels, case.voxel_size, case.seeds if case.close else None)
    return (
        f"structure {structured(pixels):6.1f} lasting {lasting(pixels):5.2f} psf {ratio:5.2f} "
        f"long {longer:5.2f} follows {follows:5.2f} "
        f"noise {bright_over_dark(pixels) or np.nan:5.2f}"
    )


def looked_at(verbose: bool) -> list[Row]:
    """The doubts of every case."""
    code = commit()
    cases = {}
    for draw in range(DRAWS):
        for kind in KINDS:
            case = as_it_is(made(kind, draw, code))
            cases[case.name] = case
    false, seconds = [], []
    rng = rng_of("sanity", 1, code)
    missed, wrong, count = [], [], 0
    for case in [*cases.values(), *spoilt(cases, rng)]:
        began = time.perf_counter()
        found = doubts(case.image, case.voxel_size, case.seeds, close=case.close)
        seconds.append(time.perf_counter() - began)
        kinds = [d.kind for d in found]
        count += bool(case.expected)
        if case.expected and not found:
            missed.append(f"{case.name} ({case.expected})")
        elif case.expected and case.expected not in kinds:
            wrong.append(f"{case.name} ({case.expected} taken for {', '.join(kinds)})")
        elif found and not case.expected:
            false.append(f"{case.name} ({', '.join(kinds)})")
        if verbose:
            print(f"{case.name:22}{case.expected:12}{measured(case)} {kinds}", flush=True)
    note = "; ".join([f"missed: {', '.join(missed)}"] * bool(missed) + wrong)
    of = f"of {count}"
    return [
        at_least("spoilt images doubted", count - 1, count - len(missed), of, note),
        at_most("images in order doubted", 2, len(false), f"of {len(cases)}", "; ".join(false)),
        at_most("time, median", 1, float(np.median(seconds)), "s", f"most {max(seconds):.2f}"),
    ]


def main(argv: Sequence[str]) -> int:
    """Returns 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.defaults.sanity")
    parser.add_argument("-v", "--verbose", action="store_true", help="the numbers of every case")
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose table is replaced")
    chosen = parser.parse_args(argv)
    rows = looked_at(chosen.verbose)
    print(table(rows))
    if chosen.page:
        put_between(chosen.page, "sanity", table(rows))
    return int(any(row.passed is False for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
