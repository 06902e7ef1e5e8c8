"""Good, fair or poor: what is to be thought of the shapes that a fit found.

That a fit has converged says that its iterations ended, nothing of the shape. `judged` is a pure
function of a few facts; `facts_of` gathers them. A predicted error of the shape can join them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any, Literal

import numpy as np
from scipy.ndimage import distance_transform_edt

from ..fitting.job import FitInput
from ..fitting.state import FitState
from ..fitting.voxel_ownership import surface_voxels
from ..geometry.labels.voxels import voxel_labels
from ..geometry.mesh import Mesh
from ..scene import Grid
from .first_sigma import first_sigma
from .residual import Residual

Grade = Literal["good", "fair", "poor"]
_ORDER: tuple[Grade, ...] = ("good", "fair", "poor")


@dataclass(frozen=True)
class VerdictSettings:
    """What lowers a grade; from the scenes of ``benchmarks.defaults`` and three real stacks.

    Attributes
    ----------
    good, fair
        Least share of the signal around the surfaces that is explained, noise left out. Real
        surfaces that lay where they should explained 0.79 to 0.95, wrong ones 0.11 to 0.45.
    stray
        Largest share of the light of a cell that one place of the residual may hold. Scenes within
        0.2 voxel had up to 0.09, nuclei and haze fitted as membranes 0.15 or more.
    widths
        Width of the blur that the image tells over that of the PSF used. Where the PSF is right and
        layers are thin 0.9 to 1.1; layers of 3 to 8 voxels and nuclei 1.2 to 1.5.
    grown, shrunk
        Volume over that of the start; with four cells or more, over what it is in the others.
    inside
        Brightness deep inside a cell less that outside, over that of its surface: with membranes
        alone within 0.02 of 0, with light inside or a haze around beyond 0.35.
    compact
        Area of the sphere of the same volume over that of the cell, over what it was at the start:
        0.9 to 1 where the shape was found, below 0.6 where it crumpled or swallowed a neighbour.
    psf_voxels
        Narrowest PSF that an image can tell, in voxels.
    """

    good: float = 0.75
    fair: float = 0.5
    stray: float = 0.12
    widths: tuple[float, float] = (0.7, 1.3)
    grown: float = 3.0
    shrunk: float = 0.2
    inside: float = 0.12
    compact: float = 0.65
    psf_voxels: float = 0.6


SETTINGS = VerdictSettings()
_DEEP, _FAR = 2.5, 6.0  # widths of the PSF from a surface: what its own light hardly reaches
_FEWEST = 30  # voxels that a mean brightness is taken from


@dataclass(frozen=True)
class CellFacts:
    """One cell.

    Attributes
    ----------
    region
        The cell.
    explained
        Share of the signal around it; None where nothing varies beyond noise.
    stray
        Light of the clearest place of the residual near it, over the light of the cell.
    growth
        Volume over that of the start; None where the start had no such cell.
    cut
        Whether it reaches the border of the image.
    inside
        Brightness deep inside less that outside, over that of the surface; None where the cell is
        too small to have a deep inside.
    compact
        How round it is, over how round its start was; None where the start had no such cell.
    """

    region: int
    explained: float | None
    stray: float = 0.0
    growth: float | None = None
    cut: bool = False
    inside: float | None = None
    compact: float | None = None


@dataclass(frozen=True)
class Facts:
    """What is known when a fit has ended.

    Attributes
    ----------
    finished
        Whether its iterations came to an end, and it was not stuck.
    explained
        Of the whole.
    width
        Of the blur that the image tells over that of the PSF used; None where it does not tell.
    narrow
        Whether a PSF that was fitted became narrower than an image can tell.
    cells
        One for each.
    """

    finished: bool
    explained: float | None
    width: float | None = None
    narrow: bool = False
    cells: tuple[CellFacts, ...] = ()


@dataclass(frozen=True)
class CellVerdict:
    """A grade of one cell, and why it is no better."""

    region: int
    grade: Grade
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """A grade of a fit and of each cell, and why they are no better."""

    grade: Grade
    reasons: tuple[str, ...]
    cells: tuple[CellVerdict, ...]

    def as_plain(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    def sentence(self) -> str:
        """For a user: the grade, and why."""
        return f"{self.grade}" + (f": {'; '.join(self.reasons)}" if self.reasons else "")


def judged(facts: Facts, settings: VerdictSettings = SETTINGS) -> Verdict:
    """The grade: that of most cells, lowered by what concerns all; one bad cell spoils no other."""
    whole = _of_whole(facts, settings)
    usual = _usual_growth(facts.cells)
    cells = tuple(_of_cell(cell, usual, settings) for cell in facts.cells)
    grade = _worst(grade for grade, _ in whole)
    reasons = [text for _, text in whole]
    for word in _ORDER[1:]:
        bad = [cell.region for cell in cells if cell.grade == word]
        if not bad:
            continue
        if 2 * sum(_ORDER.index(c.grade) >= _ORDER.index(word) for c in cells) > len(cells):
            grade = _worst((grade, word))
        if len(cells) == 1:
            reasons += [text for text in cells[0].reasons if text not in reasons]
        else:
            reasons.append(f"{word}: {_cells(bad)}")
    return Verdict(grade, tuple(reasons), cells)


def _of_whole(facts: Facts, settings: VerdictSettings) -> list[tuple[Grade, str]]:
    found: list[tuple[Grade, str]] = []
    if not facts.finished:
        found.append(("poor", "the fit did not come to an end: go on, or start nearer"))
    if facts.explained is None:
        found.append(("poor", "nothing around the surfaces is brighter or darker than noise"))
    elif facts.explained < settings.good:
        word: Grade = "fair" if facts.explained >= settings.fair else "poor"
        found.append(
            (word, f"{facts.explained:.0%} of the signal around the surfaces is explained")
        )
    if facts.width is not None and facts.width > settings.widths[1]:
        text = (
            f"what shines is blurred {facts.width:.2g} times as wide as the PSF: a layer that is "
            "thick, light inside, or a PSF that is too narrow (--fit-psf, --effects auto)"
        )
        found.append(("fair", text))
    elif facts.width is not None and facts.width < settings.widths[0]:
        text = f"the image is {1 / facts.width:.2g} times as sharp as the PSF: give its width"
        found.append(("fair", text))
    if facts.narrow:
        found.append(("fair", "the fitted PSF is narrower than voxels can tell: hold it"))
    return found


def _of_cell(cell: CellFacts, usual: float, settings: VerdictSettings) -> CellVerdict:
    found: list[tuple[Grade, str]] = []
    if cell.explained is not None and cell.explained < settings.good:
        word: Grade = "fair" if cell.explained >= settings.fair else "poor"
        found.append((word, f"{cell.explained:.0%} of the signal around it is explained"))
    if cell.stray > settings.stray:
        text = f"light that no surface explains, {cell.stray:.0%} of that of the cell, lies at it"
        found.append(("fair", text + ": light inside, haze or a neighbour (--effects auto)"))
    if cell.inside is not None and abs(cell.inside) > settings.inside:
        where = "inside it" if cell.inside > 0 else "around it"
        text = (
            f"light {where}, {abs(cell.inside):.0%} as bright as its surface, is not in the model"
        )
        found.append(("fair", f"{text} (--effects bulk)"))
    if cell.compact is not None and cell.compact < settings.compact:
        text = "its surface has crumpled, or leaked into a neighbour: smooth it, or start anew"
        found.append(("fair", text))
    if cell.growth is not None:
        growth = cell.growth / usual
        if growth > settings.grown:
            text = f"it has grown to {growth:.2g} times its volume: has it swallowed a neighbour?"
            found.append(("fair", text))
        elif growth < settings.shrunk:
            found.append(("poor", f"it has shrunk to {growth:.0%} of its volume"))
    if cell.cut:
        found.append(("fair", "the border of the image cuts it: what lies beyond is a guess"))
    return CellVerdict(cell.region, _worst(g for g, _ in found), tuple(text for _, text in found))


def _usual_growth(cells: Iterable[CellFacts]) -> float:
    known = [cell.growth for cell in cells if cell.growth is not None]
    return max(median(known), 1e-9) if len(known) >= 4 else 1.0


def _worst(grades: Iterable[Grade]) -> Grade:
    return max(grades, key=_ORDER.index, default="good")


def _cells(regions: list[int]) -> str:
    shown = ", ".join(map(str, regions[:12])) + (" and more" if len(regions) > 12 else "")
    return f"cell{'s' * (len(regions) > 1)} {shown}"


# Facts ----------------------------------------------------------------------------------------


def facts_of(
    job: FitInput, state: FitState, left: Residual, rendered: np.ndarray | None = None
) -> Facts:
    """What is known of a fit.

    Parameters
    ----------
    left
        What it does not explain.
    rendered
        (Z, Y, X) image of the state, where it is known already.
    """
    image = state.rendered() if rendered is None else rendered
    total = float(np.abs(np.asarray(image) - state.background).sum())
    areas = _areas(state.mesh)
    whole = sum(areas.values()) or 1.0
    growth = _growth(job.mesh, state.mesh)
    cut = _cut(state.mesh, job.grid)
    inside, compact = _inside(job, state), _compactness(job.mesh, state.mesh)
    modelled = state.effects.light_inside
    explained = {cell.region: cell.explained for cell in left.cells}
    light: dict[int, float] = {}
    for spot in left.spots:
        light[spot.region] = max(light.get(spot.region, 0.0), abs(spot.light))
    cells = tuple(
        CellFacts(
            region,
            explained.get(region),
            light.get(region, 0.0) / max(total * area / whole, 1e-30),
            growth.get(region),
            region in cut,
            None if modelled else inside.get(region),
            compact.get(region),
        )
        for region, area in areas.items()
    )
    sigma, size = np.asarray(state.optics.sigma_um), np.asarray(job.grid.voxel_size)
    fitted = job.settings.fit.fit_psf
    narrow = fitted and bool((sigma < SETTINGS.psf_voxels * size).any())
    width = _width(np.asarray(job.image), job.grid, sigma)
    return Facts(state.converged, left.explained, width, narrow, cells)


def _width(image: np.ndarray, grid: Grid, sigma: np.ndarray) -> float | None:
    """Of the blur in the plane, over that of the PSF; voxels blur, too."""
    told = first_sigma(image, grid.voxel_size).yx.value
    return None if told is None else told / float(max(sigma[1:]))


def _areas(mesh: Mesh) -> dict[int, float]:
    areas = mesh.areas()
    return {int(r): float(areas[(mesh.regions == r).any(1)].sum()) for r in mesh.region_ids()}


def _growth(start: Mesh, end: Mesh) -> dict[int, float]:
    before: Mapping[int, float] = start.volumes()
    return {
        region: abs(volume / before[region])
        for region, volume in end.volumes().items()
        if before.get(region)
    }


def _compactness(start: Mesh, end: Mesh) -> dict[int, float]:
    before, after = _roundness(start), _roundness(end)
    return {r: value / before[r] for r, value in after.items() if before.get(r)}


def _roundness(mesh: Mesh) -> dict[int, float]:
    """Area of the sphere of the volume of each region, over its own."""
    areas = _areas(mesh)
    return {
        region: float(np.cbrt(np.pi) * (6 * abs(volume)) ** (2 / 3) / areas[region])
        for region, volume in mesh.volumes().items()
        if areas.get(region)
    }


def _inside(job: FitInput, state: FitState) -> dict[int, float]:
    """Brightness deep inside of each region less that outside, over that of the surface."""
    grid, mesh = job.grid, state.mesh
    image = np.asarray(job.image)
    known = np.isfinite(image)
    if job.counted is not None:
        known = known & job.counted
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    surface = surface_voxels(mesh, grid)
    if not (surface & known).any():
        return {}
    widths = np.asarray(grid.voxel_size) / np.asarray(state.optics.sigma_um)
    away = distance_transform_edt(~surface, sampling=widths)
    deep = known & (away > _DEEP)
    outer = deep & (labels == 0) & (away < _FAR)
    if outer.sum() < _FEWEST:
        return {}
    dark, bright = float(image[outer].mean()), float(np.median(image[surface & known]))
    found = {}
    for region in mesh.region_ids():
        own = deep & (labels == region)
        if own.sum() >= _FEWEST:
            level = float(image[own].mean())
            found[int(region)] = (level - dark) / max(bright - min(level, dark), 1e-30)
    return found


def _cut(mesh: Mesh, grid: Grid) -> set[int]:
    """Cells whose surface comes within a voxel of the border of the image."""
    low, high = (np.asarray(side) for side in grid.extent)
    half = np.asarray(grid.voxel_size) / 2
    places = mesh.vertices_numpy()
    outside = np.logical_or(places < low + half, places > high - half)
    beyond = np.flatnonzero(outside.any(axis=1))
    return {int(r) for r in np.unique(mesh.regions[np.isin(mesh.faces, beyond).any(1)]) if r}
