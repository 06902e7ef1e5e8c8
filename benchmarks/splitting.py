"""Two fits that share no photon: do they differ by as much as each says that noise moves it?

``python -m benchmarks.splitting --page docs/measurements.md``. Every photon of a raw stack goes to
one of two halves by lot (binomial thinning): their noise is independent, while cells, PSF and all
that a model lacks are the same. Each half is fitted as ``napari-deltamic fit`` does from an image,
a voxel size and seeds. Displacements between the two surfaces, along normals and averaged over
patches as wide as the PSF, are compared with what noise alone is predicted to do, and with the
product's own figure, in which the misfit of the model is.

Photons are known where the variance of the noise grows with brightness: ``(value + intercept /
slope) / slope`` of that line is a number whose variance is its mean, offset and read noise
included. Where an image shows no such line, splitting is not possible, and it says why.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import tifffile
from numpy.typing import NDArray

from napari_deltamic import Mesh
from napari_deltamic.cli import build_parser
from napari_deltamic.cli.inputs import gather
from napari_deltamic.cli.messages import Notes
from napari_deltamic.errors import InputError
from napari_deltamic.evidence.camera import NoiseLine, camera_from_image
from napari_deltamic.evidence.evidence_rules import CAMERA
from napari_deltamic.fitting import FitState
from napari_deltamic.fitting.job import FitInput, start
from napari_deltamic.fitting.objective.convergence import Patches, vertex_normals
from napari_deltamic.fitting.uncertainty.curvature import Curvature
from napari_deltamic.fitting.uncertainty.errors_of_measures import posed_at
from napari_deltamic.images.stacks import read_image
from napari_deltamic.measure.surface_distance import distance_to_surface

from .defaults.scenes import Recipe, Scene, rng_of, scene_of
from .defaults.tissues import tissue
from .figure import Row, default_data_folder
from .page import put_between, table

Array = NDArray[np.float64]
Size = tuple[float, float, float]
# Points of a face at which displacements are looked at: the middles of its four quarters.
_CORNERS = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]]) / 6
LEAST, MOST = 0.8, 1.25  # of the observed difference over the predicted one
GAIN, OFFSET, READ = 2.2, 100.0, 1.6  # of the simulated camera: counts a photon, counts, counts
_DRAWS = 16  # of the noise, as in the product
POINTS = Path(__file__).parent / "data_points" / "vesicles_GUV.csv"
# Raw or not, the stacks that there are seeds for: image, voxel size, seeds.
REAL: tuple[tuple[str, Size, str], ...] = (
    ("vesicles_GUV.tif", (0.34, 0.133, 0.133), str(POINTS)),
    ("celegans_tp33half_bgsub.tif", (4.0, 1.0, 1.0), "auto"),
    ("gland_WT_2017-12-04_1a.tif", (0.5, 1.0, 1.0), "gland_WT_2017-12-04_1a_labels.tif"),
    ("gland_WT_2018-04-10_2a.tif", (0.5, 1.0, 1.0), "gland_WT_2018-04-10_2a_labels.tif"),
    ("bead2.5um_EPFL_25pct.tif", (0.64, 0.258, 0.258), "auto"),
)
RECIPES: dict[str, Recipe] = {
    "cell of 6 voxels, 100 photons": Recipe(cells=((0, 0, 0, 6),), photons=100),
    "cell of 11 voxels, 60 photons": Recipe(),
    "cell of 11 voxels, 300 photons": Recipe(photons=300, roughness=0.2),
    "cell of 16 voxels, 30 photons": Recipe(
        cells=((0, 0, 0, 16),), photons=30, shape=(48, 48, 48), psf=(1.6, 1.6)
    ),
    "cell, voxels 3 times as high": Recipe(
        cells=((0, 0, 0, 14),), aspect=3.0, shape=(20, 48, 48), photons=100
    ),
    "nucleus, stained inside": Recipe(membrane=0.0, interior=1.0, photons=80),
    "uneven membrane": Recipe(uneven=0.3, photons=120),
    "two cells with a wall": Recipe(
        cells=((-6, 0, 0, 9), (6, 1, 0, 9)),
        seeded=(1, 2),
        together=True,
        shape=(44, 40, 40),
        photons=80,
        seeds="labels",
    ),
}
TISSUE = "tissue of 8 or more cells"


@dataclass(frozen=True)
class Stack:
    """A raw stack as a file, with what the command is told."""

    name: str
    image: Path
    voxel_size: Size
    seeds: Path | str


@dataclass(frozen=True)
class Half:
    """A fit to one half of the photons."""

    job: FitInput
    state: FitState


# ---------------------------------------------------------------------------------------- stacks


def simulated(folder: Path, only: str, commit: str) -> Iterator[Stack]:
    """Stacks of a camera that counts 2.2 for a photon, above 100, with read noise."""
    for name, recipe in RECIPES.items():
        if only in name:
            rng = rng_of(name, 0, commit)
            yield _written(folder, name, scene_of(name, recipe, rng), rng)
    if only in TISSUE:
        yield _written(folder, TISSUE, tissue(4, commit), np.random.default_rng(1))


def _written(folder: Path, name: str, scene: Scene, rng: np.random.Generator) -> Stack:
    counts = GAIN * scene.image + OFFSET + READ * rng.normal(size=scene.image.shape)
    stem = name.replace(" ", "_").replace(",", "")
    image, seeds = folder / f"{stem}.tif", folder / f"{stem}_labels.tif"
    tifffile.imwrite(image, np.rint(counts).clip(0, 65535).astype(np.uint16))
    tifffile.imwrite(seeds, scene.labels.astype(np.uint16))
    return Stack(name, image, scene.voxel_size, seeds)


def real(data: Path, only: str) -> Iterator[Stack]:
    """Those that are there."""
    for name, size, seeds in REAL:
        path = data / "images" / name
        if only in name and path.is_file():
            found = seeds if seeds == "auto" else Path(data / "images" / seeds)
            yield Stack(name, path, size, found)


# ------------------------------------------------------------------------------------- splitting


def photons_of(image: Array, line: NoiseLine) -> NDArray[np.int64]:
    """Numbers whose variance is their mean."""
    return np.rint((image + line.intercept / line.slope) / line.slope).clip(0).astype(np.int64)


def halves(stack: Stack, folder: Path, rng: np.random.Generator) -> tuple[Half, Half]:
    """The fits to both halves.

    Raises
    ------
    InputError
        Where the image does not tell its photons.
    """
    image = read_image(stack.image)[0]
    camera = camera_from_image(image)
    line = camera.line
    if line is None or line.slope_error > CAMERA.largest_error * line.slope:
        raise InputError(camera.gain.reason)
    photons = photons_of(image.astype(np.float64), line)
    one = rng.binomial(photons, 0.5)
    found = [
        _fitted(stack, folder / f"half{k}.tif", part) for k, part in enumerate((one, photons - one))
    ]
    return found[0], found[1]


def _fitted(stack: Stack, path: Path, photons: NDArray[np.int64]) -> Half:
    tifffile.imwrite(path, photons.astype(np.float32))
    size = [str(side) for side in stack.voxel_size]
    words = ["fit", str(path), "--voxel-size", *size, "--seeds", str(stack.seeds), "-o", "none"]
    notes = Notes()
    with notes.catching_warnings():
        job = gather(build_parser().parse_args(words), notes)
        *_, state = start(job)
    return Half(job, state)


# ------------------------------------------------------------------------------------- comparing


@dataclass(frozen=True)
class Compared:
    """Root mean squares over the surfaces of all cells, voxels."""

    seen: float
    noise: float
    with_misfit: float

    @property
    def ratio(self) -> float:
        """Of what was seen to what noise alone is predicted to do."""
        return self.seen / self.noise


def compared(one: Half, other: Half) -> Compared:
    """What two halves differ by, and what the errors of both predict."""
    grid = one.job.grid
    voxel = float(np.prod(grid.voxel_size)) ** (1 / 3)
    seen, predicted = [], []
    # Both ways: the surfaces have triangles of their own.
    for half, rest in ((one, other), (other, one)):
        own, theirs = _scatter(half), rest.state.mesh
        predicted.append([np.concatenate([m.ravel() for m in each]) for each in own])
        seen.append(np.concatenate(_displacements(half, theirs, voxel)))
    noise, misfit = (np.mean([np.mean(p[k] ** 2) for p in predicted]) for k in (0, 1))
    squares = np.mean([np.mean(s**2) for s in seen])
    return Compared(*(float(np.sqrt(v)) / voxel for v in (squares, 2 * noise, 2 * misfit)))


def together(each: Sequence[Compared]) -> Compared:
    """Root mean squares over several splits."""
    parts = np.array([(c.seen, c.noise, c.with_misfit) for c in each])
    return Compared(*(float(v) for v in np.sqrt((parts**2).mean(0))))


class _Cell:
    """The surface of one cell, and means over patches of it."""

    def __init__(self, half: Half, region: int) -> None:
        mesh, grid = half.state.mesh, half.job.grid
        self.mesh = mesh.region_surface(region)
        self.used = np.unique(mesh.faces[(mesh.regions == region).any(1)])  # of the whole mesh
        width = float(np.prod(half.state.optics.sigma_um) ** (1 / 3))
        self._patches = Patches(self.mesh, width)
        v, faces = self.mesh.vertices_numpy(), self.mesh.faces
        self.normals = vertex_normals(v, faces)
        low, high = np.asarray(grid.extent)  # beyond the border of an image nothing is seen
        self.seen = ((v > low + width) & (v < high - width)).all(1)
        # Means over the faces around a vertex: vertices alone stand out of flat triangles.
        n, rows = len(faces), np.arange(len(faces) * len(_CORNERS))
        across = np.repeat(faces, len(_CORNERS), axis=0)
        shares = np.tile(_CORNERS, (n, 1))
        given = shares.ravel(), (np.repeat(rows, 3), across.ravel())
        self._points = sp.csr_matrix(given, (len(rows), len(v)))
        spread = self._points.T @ sp.diags(np.repeat(self.mesh.areas(), len(_CORNERS)))
        self._gathered = sp.diags(1 / np.asarray(spread.sum(1)).ravel()) @ spread

    def displaced(self, vertices: Array) -> Array:
        """Patch means of displacements of all vertices of the whole mesh, (V, 3)."""
        along = (vertices[self.used] * self.normals).sum(1)
        return self._means(self._points @ along)

    def from_here_to(self, other: Mesh, reach: float) -> Array:
        """Patch means of the way along the normal to another surface, um.

        Half the difference of the distances of two points, in front of the surface and behind it:
        exact where the other surface is flat over their reach, and less than that away.
        """
        points, normals = self._points @ self.mesh.vertices_numpy(), self._points @ self.normals
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        front, back = (distance_to_surface(points + s * reach * normals, other) for s in (1, -1))
        return self._means((back - front) / 2)

    def _means(self, at_points: Array) -> Array:
        found: Array = self._patches.means(self._gathered @ at_points)[self.seen]
        return found


def _displacements(half: Half, other: Mesh, voxel: float) -> list[Array]:
    """Of each cell: ways to the other surface, um."""
    regions = [int(r) for r in half.state.mesh.region_ids()]
    return [_Cell(half, r).from_here_to(other.region_surface(r), voxel) for r in regions]


def _scatter(half: Half) -> tuple[list[Array], list[Array]]:
    """Of each cell: displacements that noise alone, and what is left, would do."""
    job, state = half.job, half.state
    posed = posed_at(job.image, job.grid, state, job.settings.fit, job.counted)
    curvature = Curvature(posed.posterior, posed.at, state.mesh, state.pinned)
    # Photons were fitted: their variance is their mean.
    measured = posed.posterior.measured(posed.at)[0]
    noise = np.sqrt(np.maximum(measured - curvature.residual, 0.0))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (len(noise), _DRAWS))
    cells = [_Cell(half, int(r)) for r in state.mesh.region_ids()]
    parts: tuple[list[Array], list[Array]] = ([], [])
    for part, spread in zip(parts, (noise, curvature.residual), strict=True):
        moved = [
            curvature.directions.displaced(one)
            for one in curvature.follows(signs * spread[:, None]).T
        ]
        part += [np.array([cell.displaced(m) for m in moved]) for cell in cells]
    return parts


def rows_of(stacks: Iterator[Stack], folder: Path, splits: int) -> Iterator[Row]:
    """A row for each stack, root mean squares over several splits."""
    asked = f"{LEAST:g} to {MOST:g}"
    for stack in stacks:
        began, figure = time.process_time(), f"{stack.name}: seen over predicted"
        try:
            each = [
                compared(*halves(stack, folder, np.random.default_rng(k))) for k in range(splits)
            ]
            told = together(each)
        except InputError as error:
            yield Row(figure, asked, float("nan"), "", None, f"not possible: {error}")
            continue
        splits = ", ".join(f"{e.ratio:.2f}" for e in each)
        note = (
            f"{told.seen:.3f} voxel over {told.noise:.3f}; with the misfit {told.with_misfit:.3f} "
            f"({told.seen / told.with_misfit:.2f}); splits {splits}; "
            f"CPU {time.process_time() - began:.0f} s"
        )
        yield Row(figure, asked, told.ratio, "", LEAST <= told.ratio <= MOST, note)


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.splitting", description=__doc__)
    parser.add_argument("--only", default="", metavar="TEXT", help="stacks whose names hold it")
    parser.add_argument("--splits", type=int, default=3, help="of each stack")
    parser.add_argument("--data", type=Path, default=default_data_folder())
    parser.add_argument("--commit", default="", help="from which odd draws of scenes follow")
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kinds = simulated(folder, chosen.only, chosen.commit), real(chosen.data, chosen.only)
        for stacks in kinds:
            for row in rows_of(stacks, folder, chosen.splits):
                rows.append(row)
                print(f"{row.figure}: {row.measured:.3f}; {row.note}", file=sys.stderr, flush=True)
    print(table(rows))
    if chosen.page is not None:
        put_between(chosen.page, "splitting", table(rows))
    return 1 if any(row.passed is False for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
