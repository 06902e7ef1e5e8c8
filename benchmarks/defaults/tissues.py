"""How well cells are found without a click: ``python -m benchmarks.defaults.tissues``.

Twenty clusters of cells, every other one in a haze, without seeds and without a size: the size
that is proposed against the true one, and the cells that are found with it. With ``--nuclei``:
images of cells that shine from inside, of the kinds of benchmarks.defaults. With ``--deskewed``:
only a slanted half of each image is there, as of a light sheet's stack, and only cells count that
lie in it for the most part; what is found of the others counts neither way. With ``--of``: an image
of yours, against its labels.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from napari_deltamic.geometry.labels.bright_cells import cells_of
from napari_deltamic.geometry.labels.cell_sizes import suggest_sizes
from napari_deltamic.geometry.labels.find_cells import find_cells

from ..figure import Row, at_least, at_most
from ..page import put_between, table
from ..tree import commit
from .scenes import Recipe, Scene, made, rng_of, scene_of

COUNT = 20
WITHIN = 0.1  # of the true size
NUCLEI = (
    "packed-nuclei",
    "packed-partial",
    "packed-hazy",
    "crowd-nuclei",
    "grainy-nuclei",
    "tissue-insides",
)
DRAWS = 4  # of each
MATCHED = 0.5  # volume common to both over that of either


def tissue(draw: int, code: str) -> Scene:
    """Cells that press on each other, 8 to 30 of them; odd draws follow the commit."""
    rng = rng_of("tissue", draw, code)
    count, radius = int(rng.integers(8, 31)), rng.uniform(5, 8)
    reach = 0.86 * radius * count ** (1 / 3)
    cloud = rng.uniform(-1, 1, (6000, 3))
    cloud = cloud[(cloud**2).sum(1) < 1] * max(reach - 0.6 * radius, 1)
    places = cloud[:count]
    for _ in range(20):
        nearest = ((cloud[:, None] - places) ** 2).sum(2).argmin(1)
        places = np.array([cloud[nearest == k].mean(0) for k in range(count)])
    cells = tuple(
        (*p.tolist(), radius * s)
        for p, s in zip(places, rng.uniform(0.93, 1.07, count), strict=True)
    )
    side = int(2 * reach + 14)
    recipe = Recipe(
        cells=cells,
        seeded=tuple(range(1, count + 1)),
        together=True,
        roughness=0.05,
        shape=(side, side, side),
        uneven=rng.uniform(0, 0.4),
        photons=rng.uniform(20, 100),
        psf=(rng.uniform(1, 1.8), rng.uniform(0.9, 1.3)),
        haze=rng.uniform(0.3, 1.0) if draw // 2 % 2 else 0.0,
    )
    return scene_of(f"tissue-{draw}", recipe, rng)


def deskewed(scene: Scene) -> Scene:
    """The same with NaN outside a slanted band; labels of cells that are mostly outside are -1."""
    z, y, _ = np.ogrid[tuple(slice(n) for n in scene.image.shape)]
    depth, height, _ = scene.image.shape
    aside = (y - height / 2) - 0.5 * height / depth * (z - depth / 2)
    known = np.broadcast_to(np.abs(aside) < 0.27 * height, scene.image.shape)
    labels = scene.all_labels
    there = np.bincount(labels[known], minlength=labels.max() + 1) > np.bincount(labels.ravel()) / 2
    there[0] = True
    image = np.where(known, scene.image, np.float32(np.nan))
    labels = np.where(there[labels], labels, -1)
    return replace(scene, image=image, all_labels=np.where(known, labels, 0))


def matched(found: NDArray[np.int32], true: NDArray[np.int32]) -> float:
    """Share of the true cells that a found one is nearly the same as."""
    hits, names = 0, np.unique(true[true > 0])
    for name in names:
        own = true == name
        others, counts = np.unique(found[own], return_counts=True)
        best = max(
            (n / ((found == k) | own).sum() for k, n in zip(others, counts, strict=True) if k > 0),
            default=0.0,
        )
        hits += best > MATCHED
    return hits / len(names)


def counted(found: NDArray[np.int32], true: NDArray[np.int32]) -> int:
    """How many were found, but for what is mostly of cells that count neither way."""
    size = np.bincount(found.ravel())[1:]
    aside = np.bincount(found[true < 0], minlength=len(size) + 1)[1:]
    return int((aside <= size / 2).sum())


def nuclei(scenes: Iterable[Scene]) -> list[Row]:
    """Cells that shine from inside, found without a size."""
    shares: dict[str, list[float]] = {}
    numbers = []
    for scene in scenes:
        found = cells_of(scene.image, scene.voxel_size).labels
        true = scene.all_labels
        cells, many = len(np.unique(true[true > 0])), counted(found, true)
        share = matched(found, true)
        shares.setdefault(scene.name.rpartition("-")[0], []).append(share)
        numbers.append(many / cells)
        print(f"{scene.name:18} cells {cells:3d} found {many:3d} matched {share:.2f}", flush=True)
    each = ", ".join(f"{name} {np.mean(of):.2f}" for name, of in shares.items())
    every = [share for of in shares.values() for share in of]
    note = f"{len(every)} images: {each}"
    return [
        at_least("cells matched", 0.9, float(np.mean(every)), "", note),
        at_most("found over true, most", 1.1, max(numbers), ""),
    ]


def membranes(scenes: Iterable[Scene]) -> list[Row]:
    """Cells with walls: the size that is proposed, and what is found with it."""
    close, shares, off = 0, [], []
    for scene in scenes:
        labels = scene.all_labels
        volumes = np.bincount(labels[labels > 0])[1:] * np.prod(scene.voxel_size)
        true = float(np.cbrt(6 / np.pi * np.median(volumes)))
        size = suggest_sizes(scene.image, scene.voxel_size)[0].size
        found = find_cells(scene.image, scene.voxel_size, size)
        shares.append(matched(found, labels))
        close += abs(size / true - 1) <= WITHIN
        if abs(size / true - 1) > WITHIN:
            off.append(f"{size / true:.2f} times in a haze of {scene.recipe.haze:.2f}")
        print(
            f"{scene.name:12} haze {scene.recipe.haze:4.2f} cells {len(volumes):3d} found "
            f"{found.max():3d} size {true:.2f} um, proposed {size / true:5.2f} of it, "
            f"matched {shares[-1]:.2f}",
            flush=True,
        )
    many = len(shares)
    what = f"proposed size within {WITHIN:.0%}"
    return [
        at_least(what, round(0.95 * many), close, f"of {many}", "; ".join(off)),
        at_least("cells matched, with that size", 0.9, float(np.mean(shares)), ""),
    ]


def labelled(image: str, labels: str, *voxel_size: str) -> int:
    """An image and its labels: cells found, and the F1 score at an IoU of 0.5."""
    true = tifffile.imread(labels)
    found = cells_of(tifffile.imread(image), [float(side) for side in voxel_size]).labels
    there, many = len(np.unique(true[true > 0])), int(found.max())
    f1 = 2 * matched(found, true) * there / (there + many)
    print(f"cells {there} found {many} F1 {f1:.2f}")
    return 0


def main(argv: Sequence[str]) -> int:
    """Returns 1 where the bars (size on 19 of 20, 0.9 of the cells) are missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.defaults.tissues")
    parser.add_argument("count", type=int, nargs="?", default=COUNT, help="of clusters")
    parser.add_argument("--nuclei", action="store_true", help="cells that shine from inside")
    parser.add_argument("--deskewed", action="store_true", help="half of each image is missing")
    parser.add_argument("--of", nargs=5, metavar=("IMAGE", "LABELS", "DZ", "DY", "DX"))
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose table is replaced")
    chosen, code = parser.parse_args(argv), commit()
    if chosen.of:
        return labelled(*chosen.of)
    seen = deskewed if chosen.deskewed else lambda scene: scene
    if chosen.nuclei:
        rows = nuclei(seen(made(kind, draw, code)) for kind in NUCLEI for draw in range(DRAWS))
    else:
        rows = membranes(seen(tissue(draw, code)) for draw in range(chosen.count))
    print(table(rows))
    if chosen.page:
        what = "nuclei" if chosen.nuclei else "tissues"
        mark = f"deskewed-{what}" if chosen.deskewed else what
        put_between(chosen.page, mark, table(rows))
    return int(any(row.passed is False for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
