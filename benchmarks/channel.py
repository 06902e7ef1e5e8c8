"""Amounts of another channel on the walls of a foam, and what noise alone allows.

``python -m benchmarks.channel --page docs/measurements.md``. The channel of 32 cells is shifted,
has a PSF of its own, and walls whose densities are up to ten times apart. Beside what was found
stands the bound of Cramer and Rao: with shift, widths and every voxel's true mean known, no
unbiased estimate of a wall scatters less.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

import napari_deltamic as nd
from napari_deltamic.measure.channel import channel_amounts
from napari_deltamic.measure.part_images import part_images
from napari_deltamic.scene import random_cells

from .figure import Row, at_least, at_most
from .page import put_between, table

SHIFT = 0.2  # um
BACKGROUND = 4.0  # photons
PHOTONS = (40.0, 120.0)  # in the brightest voxel
_OF_MEDIAN = 0.6745  # of the absolute value of a normal deviate
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stained:
    """A foam, and what shines on its walls and inside its cells, relative to the brightest wall."""

    grid: nd.Grid
    mesh: nd.Mesh
    moved: nd.Mesh
    optics: nd.GaussianPSF
    walls: Floats
    insides: Floats

    @staticmethod
    def made() -> Stained:
        """The same each time."""
        grid = nd.Grid((48, 64, 64), (0.25,) * 3)
        mesh = random_cells(32, grid, "foam", 5)
        rng = np.random.default_rng(0)
        walls = 10 ** rng.uniform(-1, 0, len(mesh.interfaces()[0]))
        insides = rng.uniform(0.02, 0.1, len(mesh.region_ids()))
        moved = mesh.translated(np.array([1.0, -1.0, 1.0]) * SHIFT / np.sqrt(3))
        return Stained(grid, mesh, moved, nd.GaussianPSF((0.36, 0.30, 0.30)), walls, insides)

    def scene(self) -> nd.Scene:
        """What the microscope sees."""
        wall = self.moved.interfaces()[1]
        regions = self.moved.region_ids().tolist()
        parts = (
            nd.Surface(self.moved, self.walls[wall] / self.moved.membranes()),
            nd.Solid(self.moved, dict(zip(regions, self.insides.tolist(), strict=True))),
        )
        return nd.Scene(parts, self.optics)

    def large(self) -> NDArray[np.bool_]:
        """Walls larger than three widths of the PSF squared."""
        pairs, wall = self.mesh.interfaces()
        areas = np.bincount(wall, self.mesh.areas(), len(pairs))
        return np.asarray(areas > (3 * np.prod(self.optics.sigma_um) ** (1 / 3)) ** 2)

    def bound(self, unit: float) -> Floats:
        """(W,) the least standard errors of the walls, where one is as bright as ``unit``."""
        columns = part_images(self.moved, self.grid, self.optics, True, True, 1e-3)
        columns = sp.hstack([columns, np.ones((columns.shape[0], 1))]).tocsr()
        truth = [*(unit * self.walls), *(unit * self.insides), BACKGROUND]
        weights = 1 / np.maximum(columns @ np.array(truth), BACKGROUND / 2)
        information = (columns.T @ columns.multiply(weights[:, None])).toarray()
        return np.sqrt(np.linalg.inv(information).diagonal())[: len(self.walls)]


def rows(photons: float) -> list[Row]:
    """What is found at a brightness."""
    stained = Stained.made()
    made = nd.simulate(
        stained.scene(), stained.grid, photons=photons, background=BACKGROUND, seed=1
    )
    unit = made.parameters["amplitude"]
    found = channel_amounts(
        made.image, stained.grid, stained.mesh, nd.GaussianPSF((0.30, 0.26, 0.26))
    )
    truth, large = unit * stained.walls, stained.large()
    off = found.walls - truth
    z = (off / found.walls_se)[large]
    least = 100 * _OF_MEDIAN * np.median((stained.bound(unit) / truth)[large])
    shift = np.array(found.shift) - (stained.moved.vertices[0] - stained.mesh.vertices[0])
    name = f"{photons:g} photons"
    spread = f"{large.sum()} walls, rms {np.sqrt(np.mean(z**2)):.2f} standard errors"
    share = 100 * float(np.mean(abs(z) <= 2))
    median = 100 * float(np.median(np.abs(off / truth)[large]))
    allowed = f"noise alone allows {least:.1f} %"
    nm = 1000 * float(np.linalg.norm(shift))
    return [
        at_least(f"{name}: walls within 2 standard errors", 95, share, "%", spread),
        at_most(f"{name}: error of a wall, median", 3, median, "%", allowed),
        Row(f"{name}: error of the shift", "-", nm, "nm", None, "of 200 nm"),
    ]


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.channel", description=__doc__)
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    found = [row for photons in PHOTONS for row in rows(photons)]
    print(table(found))
    if chosen.page is not None:
        put_between(chosen.page, "channel", table(found))
    return 1 if any(row.passed is False for row in found) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
