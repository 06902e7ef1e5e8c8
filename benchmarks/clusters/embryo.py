"""A real embryo of about 56 cells: found, corrected by clicks, fitted, compared with LimeSeg.

Meshes of LimeSeg (S. Machado et al., BMC Bioinformatics 20, 2019) are the result of a peer, no
truth: they lie two to three voxels inside the membranes, and some pairs of its cells divide what
shows no membrane.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import GaussianPSF, Grid, Mesh, load_mesh, render
from napari_deltamic.geometry import find_cells, mesh_from_labels
from napari_deltamic.geometry.labels.label_edits import Click, correct_labels
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.images.stacks import read_image
from napari_deltamic.results.picture import picture

from ..default_command import fitted
from ..figure import Figure, MissingData, Options, Row, at_least, at_most
from ..image_similarity import image_similarity
from ..ridge import ridge_distance

CLICKS = Path(__file__).parent / "data" / "celegans_clicks.csv"
MOST_CLICKS = 10
# The scale of the stack is not known: lengths are in voxels within planes.
VOXEL_SIZE = (4.0, 1.0, 1.0)
SIGMA = (4.0, 1.4, 1.4)  # through which our meshes and LimeSeg's are rendered
CELL, REACH = 55.0, 8.0
BAR_DISTANCE, BAR_SECONDS = 0.5, 180.0


def embryo(options: Options) -> list[Row]:
    """Cells matched, distance to the membranes, time, and the same for LimeSeg's meshes."""
    image, others = stack(options), limeseg(options)
    grid = Grid(image.shape, VOXEL_SIZE)
    first = cells(image)
    clicks = read_clicks()
    labels = corrected(image, first)
    theirs = as_labels(others, grid)
    rows = [
        Row("embryo, cells found", "", matched(first, theirs), f"of {len(others)}", None),
        at_most("embryo, clicks", MOST_CLICKS, len(clicks), ""),
        at_least("embryo, LimeSeg's cells matched", len(others), matched(labels, theirs), ""),
    ]
    start = mesh_from_labels(labels, VOXEL_SIZE)
    rows.append(_distance("embryo, seeds", start, image, bar=None))
    found = fitted(image, VOXEL_SIZE, labels)
    if options.pictures is not None:
        drawn = picture(image, found.rendered, found.mesh, grid)
        drawn.savefig(options.pictures / "clusters_embryo.png")
    rows += [
        _distance("embryo, fit", found.mesh, image, bar=BAR_DISTANCE),
        at_most("embryo, fit", BAR_SECONDS, found.report["seconds"], "s", found.note),
        Row("embryo, whole command", "", found.seconds, "s", None),
        at_least(
            "embryo, LimeSeg's cells matched after the fit",
            len(others),
            matched(voxel_labels(found.mesh, grid.shape, grid.voxel_size), theirs),
            "",
        ),
    ]
    return rows + against_limeseg(found.mesh, Mesh.merge(others), image, grid)


def against_limeseg(ours: Mesh, theirs: Mesh, image: NDArray, grid: Grid) -> list[Row]:
    """Images of both under one PSF, each membrane of one density, and the distance to the ridge."""
    voxels = np.zeros(image.shape, bool)
    rows, similar = [], {}
    for mesh in (ours, theirs):
        voxels |= voxel_labels(mesh, grid.shape, grid.voxel_size) > 0
    for name, mesh in (("ours", ours), ("LimeSeg", theirs)):
        rendered = render(mesh, grid, GaussianPSF(SIGMA), 1e-3).numpy()
        similar[name] = image_similarity(image, rendered, voxels)
    one, other = similar["ours"], similar["LimeSeg"]
    rows.append(at_most("embryo, MSE (LimeSeg's is the bar)", other.mse, one.mse, ""))
    rows.append(at_least("embryo, PSNR (LimeSeg's is the bar)", other.psnr, one.psnr, "dB"))
    rows.append(at_least("embryo, SSIM (LimeSeg's is the bar)", other.ssim, one.ssim, ""))
    bar = float(np.mean(lateral_distances(theirs, image)))
    rows.append(_distance("embryo, fit (LimeSeg's is the bar)", ours, image, bar=bar))
    return rows


def matched(labels: NDArray, theirs: NDArray) -> int:
    """How many cells of theirs are matched one to one.

    Each must be, of all cells, the one that the other overlaps most, and at least a third of theirs
    (which are smaller) must lie in ours.
    """
    n, m = int(theirs.max()), int(labels.max())
    both = np.bincount((theirs.astype(np.int64) * (m + 1) + labels).ravel())
    both = np.pad(both, (0, (n + 1) * (m + 1) - len(both))).reshape(n + 1, m + 1)
    volume, both = both.sum(1)[1:], both[1:, 1:]
    best = both.argmax(1)
    mutual = both.argmax(0)[best] == np.arange(n)
    return int((mutual & (both.max(1) >= volume / 3)).sum())


def lateral_distances(mesh: Mesh, image: NDArray) -> NDArray[np.float64]:
    """Distances to the ridge of the faces that stand upright, voxels; where there is a ridge."""
    found = ridge_distance(mesh, image, VOXEL_SIZE, reach_um=REACH)
    return np.abs(found.offset[found.lateral & found.found])


def _distance(name: str, mesh: Mesh, image: NDArray, bar: float | None) -> Row:
    values = lateral_distances(mesh, image)
    figure = f"{name}, mean lateral distance to the ridge"
    note = f"median {np.median(values):.2f}, above 2: {(values > 2).mean():.1%}"
    mean = float(values.mean())
    if bar is None:
        return Row(figure, "", mean, "voxel", None, note)
    return at_most(figure, bar, mean, "voxel", note)


def cells(image: NDArray[np.float32]) -> NDArray[np.int32]:
    """Labels of the cells as they are found."""
    return find_cells(image, VOXEL_SIZE, CELL)


def corrected(image: NDArray[np.float32], found: NDArray[np.int32]) -> NDArray[np.int32]:
    """The cells found, corrected by the clicks."""
    labels: NDArray[np.int32] = correct_labels(image, VOXEL_SIZE, found, read_clicks())
    return labels


def read_clicks() -> list[Click]:
    """The clicks that correct the cells found."""
    with CLICKS.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [Click((float(r["z"]), float(r["y"]), float(r["x"])), r["action"]) for r in rows]


def stack(options: Options) -> NDArray[np.float32]:
    """The image; MissingData where it is not at hand."""
    path = options.data / "images" / "celegans_tp33half_bgsub.tif"
    if not path.is_file():
        raise MissingData(f"no {path.name} at {path.parent}")
    return read_image(path)[0].astype(np.float32)


def limeseg(options: Options) -> list[Mesh]:
    """Its meshes; MissingData where they are not at hand."""
    paths = sorted((options.data / "images" / "celegans_meshes_T19").glob("*.ply"))
    if not paths:
        raise MissingData(f"no celegans_meshes_T19 at {options.data / 'images'}")
    return [load_mesh(path) for path in paths]


def as_labels(meshes: list[Mesh], grid: Grid) -> NDArray[np.int32]:
    """Their voxels, k for the k-th mesh."""
    labels = np.zeros(grid.shape, np.int32)
    for number, mesh in enumerate(meshes, 1):
        labels[voxel_labels(mesh, grid.shape, grid.voxel_size) > 0] = number
    return labels


FIGURES: dict[str, Figure] = {"embryo": embryo}
