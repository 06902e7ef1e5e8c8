"""Figures of tracking: ten frames of a foam that grows, changes neighbours, and divides.

Six cells; their truth is a power diagram, so that every frame's regions and contacts are known.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import GaussianPSF, Grid, Mesh, render
from napari_deltamic.geometry.contacts import contact_areas
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.measure import surface_distance
from napari_deltamic.tracking import track

from ..contacts import SEEN, contact_errors
from ..figure import Figure, Options, Row, at_least, at_most

VOXEL = 0.25  # um
GRID = Grid((44, 48, 48), (VOXEL,) * 3)
OPTICS = GaussianPSF(1.3 * VOXEL)
FRAMES, PHOTONS, BACKGROUND = 10, 40.0, 2.0
DIVIDES_AT, MOTHER = 6, 6  # frame; cell
_EDGE = 2.0 * VOXEL
BAR_DISTANCE = 0.15  # voxel


@dataclass(frozen=True)
class TrueFrame:
    """A frame of which all is known.

    image : (Z, Y, X) photons, with noise.
    mesh : the true surfaces; region k is cell ``cells[k - 1]``.
    cells : numbers that stay over time; the daughters have new ones.
    """

    image: NDArray[np.float32]
    mesh: Mesh
    centers: NDArray[np.float64]
    radii: NDArray[np.float64]
    cells: tuple[int, ...]


def spheres(frame: int) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[int, ...]]:
    """Centres and radii (um) of the power diagram of a frame, and the number of each cell.

    Four cells around a line change neighbours halfway; the lowest one divides.
    """
    share = frame / (FRAMES - 1)
    across, along = 5.5 + 4 * share, 9.5 - 4 * share
    places = [(0, 0, -across), (0, 0, across), (0, -along, 0), (0, along, 0), (11, 0, 0)]
    radii = [8.5, 8.5, 8.5, 8.5, 8.5]
    cells = [1, 2, 3, 4, 5]
    if frame < DIVIDES_AT:
        places, radii, cells = [*places, (-11, 0, 0)], [*radii, 8.5], [*cells, MOTHER]
    else:
        apart = 3.5 + 0.6 * (frame - DIVIDES_AT)
        # Askew, so that no four cells meet in a line.
        y, x = apart * np.cos(0.7), apart * np.sin(0.7)
        places += [(-11, -y, -x), (-11, y, x)]
        radii, cells = [*radii, 7.2, 7.2], [*cells, MOTHER + 1, MOTHER + 2]
    drift = np.array([0.1, 0.25, -0.2]) * (frame - FRAMES / 2)
    growth = 1 + 0.008 * frame
    centers = np.array([21.5, 23.5, 23.5]) + drift + growth * np.array(places, float)
    return VOXEL * centers, VOXEL * growth * np.array(radii), tuple(cells)


def movie(frames: int = FRAMES, seed: int = 0) -> list[TrueFrame]:
    """The frames with their noise."""
    rng = np.random.default_rng(seed)
    found = []
    for t in range(frames):
        centers, radii, cells = spheres(t)
        mesh = foam(centers, radii, _EDGE)
        clean = render(mesh, GRID, OPTICS, 1e-3).numpy().clip(0)
        image = rng.poisson(BACKGROUND + PHOTONS * clean / clean.max()).astype(np.float32)
        found.append(TrueFrame(image, mesh, centers, radii, cells))
    return found


def start(first: TrueFrame, seed: int = 1) -> Mesh:
    """Seeds: the foam of smaller spheres with shifted centres."""
    shifts = np.random.default_rng(seed).uniform(-0.7, 0.7, first.centers.shape) * VOXEL
    return foam(first.centers + shifts, 0.95 * first.radii, _EDGE * 1.25)


def matched(mesh: Mesh, truth: TrueFrame) -> dict[int, int]:
    """Tracked region -> true cell with which it shares most voxels; 0 for none."""
    own = voxel_labels(mesh, GRID.shape, GRID.voxel_size)
    true = np.append(0, truth.cells)[voxel_labels(truth.mesh, GRID.shape, GRID.voxel_size)]
    return {
        region: int(np.bincount(true[own == region], minlength=1).argmax())
        for region in mesh.region_ids().tolist()
    }


def named_contacts(mesh: Mesh, names: dict[int, int]) -> dict[tuple[int, int], float]:
    """Area of the wall of each pair of cells, um^2."""
    found: dict[tuple[int, int], float] = {}
    for (a, b), area in contact_areas(mesh).items():
        one, other = sorted((names.get(a, -a), names.get(b, -b)))
        found[one, other] = found.get((one, other), 0.0) + area
    return found


def wrong_contacts(mesh: Mesh, names: dict[int, int], truth: TrueFrame) -> int:
    """Contacts that are lost or made up; those too small to be seen do not count."""
    own = named_contacts(mesh, names)
    true = named_contacts(truth.mesh, dict(enumerate(truth.cells, 1)))
    return contact_errors(own, true, SEEN * VOXEL**2).wrong


@dataclass
class Course:
    """What came of tracking, frame by frame."""

    right: list[bool]  # identities
    distance: list[float]  # voxels
    wrong: list[int]  # contacts
    divided_at: int | None
    seconds: float


def follow(frames: list[TrueFrame], **options: Any) -> Course:
    """Track the movie and compare every frame with the truth."""
    began = time.perf_counter()
    results = []
    images = (frame.image for frame in frames)
    for state in track(images, GRID, start(frames[0]), OPTICS, **options):
        if state.done is not None:
            results.append(state.done)
    seconds = time.perf_counter() - began
    return judged(frames, results, seconds)


def judged(frames: list[TrueFrame], results: Sequence[Any], seconds: float) -> Course:
    """What came of each frame: results have a frame, a mesh or None, and events."""
    course = Course([], [], [], None, seconds)
    names = {cell: cell for cell in range(1, MOTHER + 1)}
    for truth, result in zip(frames, results, strict=True):
        if result.mesh is None:
            course.right.append(False)
            continue
        for event in result.events:
            if event.kind == "divided" and names.get(event.cell) == MOTHER:
                course.divided_at = result.frame
        found = matched(result.mesh, truth)
        _name_daughters(names, found, results, result.frame)
        good = {r: names.get(r) for r in found} == found and len(found) == len(truth.cells)
        course.right.append(good)
        course.distance.append(surface_distance(result.mesh, truth.mesh, 4000).mean / VOXEL)
        course.wrong.append(wrong_contacts(result.mesh, found, truth))
    return course


def _name_daughters(
    names: dict[int, int], found: dict[int, int], results: Sequence[Any], frame: int
) -> None:
    """The daughters get the numbers of those that they lie on, at their birth and for good."""
    for event in results[frame].events:
        if event.kind == "divided" and names.get(event.cell) == MOTHER:
            names.update({d: found[d] for d in event.daughters if d in found})


def tracking(options: Options) -> list[Row]:
    """The whole movie."""
    course = follow(movie())
    division = abs(course.divided_at - DIVIDES_AT) if course.divided_at is not None else np.nan
    each = ", ".join(f"{d:.3f}" for d in course.distance)
    wrong = ", ".join(map(str, course.wrong))
    return [
        at_least("tracking, frames with all identities right", FRAMES, sum(course.right), "frames"),
        at_most(
            "tracking, mean surface error, worst frame",
            BAR_DISTANCE,
            max(course.distance),
            "voxel",
            each,
        ),
        at_most("tracking, wrong contacts over all frames", 0, sum(course.wrong), "", wrong),
        at_most("tracking, division found at the wrong frame by", 0, division, "frames"),
        Row("tracking, ten frames", "", course.seconds, "s", None),
    ]


FIGURES: dict[str, Figure] = {"tracking": tracking}
