"""Which voxels belong to the structures that meshes describe.

Neighbours that no mesh describes (other cells, cells cut by the border, debris) would attract a
mesh, which then grows a neck and swallows them. So the ground is shared out: a voxel counts if it
is nearer to a starting surface than to bright signal that no starting surface explains.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_erosion,
    find_objects,
    gaussian_filter,
    label,
    maximum_filter,
    minimum_filter,
)

from ...common.ball import ball_radius
from ...common.doing import doing
from ...common.triple import geometric_mean
from ...errors import InputError, RepairWarning
from ...geometry.distance_transform import distance_transform, nearest_outside
from ...geometry.labels.voxels import depths, highest, voxel_labels
from ...geometry.mesh import Mesh
from ...geometry.seed_points import labels_from_points
from ...images.missing import filled
from ...optics import Optics
from ...scene import Grid
from .bright_regions import STRANGER, Labels, Mask, alike, bright_regions, without_start
from .missed_parts import without_missed
from .protrusions import protrusions


@dataclass(frozen=True)
class OwnershipRules:
    """How far the light of a starting surface reaches, and what bright signal is another's.

    Attributes
    ----------
    near, explained
        Widths of the PSF around a starting surface: beyond, hardly any light is its own. Less where
        it lies on the membranes, as labels do and dark regions of the image, than where bright
        regions end: measured on neighbours of all kinds (benchmarks.defaults), which then end 0.07
        to 0.09 voxel off from labels, not 0.11 to 0.23; and on 87 random scenes from spheres,
        meshes and points with specks or neighbours, of which with 2 in place of 3 eight ended 0.02
        to 0.4 voxel nearer, from dark regions. With 2 everywhere, cells with wrong starts were
        lost.
    farthest, further
        Widths: how far that reaches with what a wider PSF may add to it, and the steps in which it
        is added; chosen.
    margin
        Widths, of what is found so: its edge is not sharp.
    rim
        Widths: what is bright and reaches no further than this beyond its own light is the rim of
        that. Measured: up to 0.3 in layers 6 voxels thick and 0.75 in ones of 9, whose outer half
        was left out as another's, so that fits ended on their inner side; 1.0 to 15 in neighbours
        and debris.
    most
        Share of what lies so far away that is bright where it is still its own; as is 0.7.
    bright
        Of the typical membrane above the dark level: less is haze; chosen, not measured.
    beside
        The same for what is as thick as a cell, beside starts whose insides shine: of packed nuclei
        of which a third has no seed (four draws, ``packed-partial`` of benchmarks.defaults), 0.3
        leaves 0.18 to 0.23 voxel of error, 0.4 0.20 to 0.26, 0.5 0.25 to 0.34 and swallows one;
        0.3 takes the rim of a large cell for a thing where another start is small.
    above, smooth
        Standard deviations of noise above it, smoothed over this many widths: else single voxels of
        noise were taken for neighbours where most of a membrane is dim.
    low, deviation
        A percentile of the standard normal distribution, and where it lies: noise is told by it.
    haze
        Widths: what is as bright this far around on all sides is haze, and nobody's, since a
        membrane would have faded.
    """

    near: float = 2.0
    explained: float = 3.0
    farthest: float = 8.0
    further: float = 0.5
    margin: float = 1.0
    rim: float = 0.8
    most: float = 0.5
    bright: float = 0.3
    beside: float = 0.4
    above: float = 4.0
    smooth: float = 0.7
    low: int = 10
    deviation: float = 1.2816
    haze: float = 4.0


RULES = OwnershipRules()


def counted_voxels(image: np.ndarray, grid: Grid, mesh: Mesh, optics: Optics) -> np.ndarray:
    """The voxels that may count in a fit that starts close to the membranes.

    Parameters
    ----------
    image
        (Z, Y, X); NaN marks missing voxels.
    grid
        Where the voxels lie.
    mesh
        Starting surfaces, within about one PSF width of the membranes.
    optics
        The PSF; distances are measured in its widths, axis by axis.

    Returns
    -------
    (Z, Y, X) bool.
    """
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    return _shared_out(
        image,
        grid,
        surface_voxels(mesh, grid),
        labels,
        optics,
        RULES.near,
        close=_all_seen(image, mesh, labels),
    )


def counted_around(image: np.ndarray, grid: Grid, mesh: Mesh, optics: Optics) -> np.ndarray | None:
    """The same for starting surfaces that may lie far from the membranes.

    Which ground is theirs is asked of the image: the dark region that each start lies in, up to the
    crest of its membrane, or the bright one, up to where it ends. None where nothing can be told.
    """
    starts = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    if not _all_seen(image, mesh, starts):
        return None
    labels, near = bright_regions(image, grid, starts), RULES.explained
    if labels is None:
        labels, near = _dark_regions(image, grid, mesh, starts), RULES.near
    if labels is None:
        # The image shows no such region: what lies as near as the membrane may is theirs.
        return _shared_out(
            image,
            grid,
            surface_voxels(mesh, grid),
            starts,
            optics,
            max(RULES.explained, _radius(mesh, optics)),
        )
    surface = np.zeros(labels.shape, bool)
    for region in np.unique(labels[labels > 0]):
        doing()
        own = labels == region
        surface |= own & ~binary_erosion(own, border_value=1)
    return _shared_out(image, grid, surface, labels, optics, near)


def _all_seen(image: np.ndarray, mesh: Mesh, labels: Labels) -> bool:
    return bool(np.isfinite(image).any() and np.isin(mesh.region_ids(), labels).all())


def protruding(image: np.ndarray, grid: Grid, mesh: Mesh, optics: Optics) -> np.ndarray:
    """(Z, Y, X) bool: fins and fingers of cells whose surfaces lie close to the membranes.

    As for :func:`counted_voxels`: they are thin, joined to a cell, and far from its dark inside.
    """
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    surface = surface_voxels(mesh, grid)
    if not (surface & np.isfinite(image)).any():
        return np.zeros(grid.shape, bool)
    seen = _Seen.of(image, grid, surface, labels, optics, RULES.near)
    return seen.protrusions(seen.far_things())


@dataclass(frozen=True, eq=False)
class _Seen:
    """What starts see of an image, arrays (Z, Y, X); lengths in widths of the PSF.

    Attributes
    ----------
    known, inside
        Measured voxels; those within the starts.
    labels
        Regions of the starts, from 1 on.
    pixels, haze
        The image, smoothed, above the dark level; and what is as bright all around.
    noise
        Above this, it is no noise.
    bright
        What is neither noise nor haze and has its share of the brightness of a membrane.
    crest
        Above the dark level, of the nearest piece of surface, which is on a membrane.
    membrane
        Of a typical membrane, above the dark level.
    spacing
        (3,) of voxels.
    own, reach
        From the surfaces; and how far their own light comes.
    """

    known: Mask
    inside: Mask
    labels: Labels
    pixels: NDArray[np.floating]
    haze: NDArray[np.floating]
    noise: float
    bright: Mask
    crest: NDArray[np.floating]
    membrane: float
    spacing: NDArray[np.floating]
    own: NDArray[np.floating]
    reach: float

    @classmethod
    def of(
        cls,
        image: np.ndarray,
        grid: Grid,
        surface: Mask,
        labels: Labels,
        optics: Optics,
        explained: float,
    ) -> Self:
        """Of an image; explained : how far the light of a surface reaches at least."""
        known, inside = np.isfinite(image), labels > 0
        pixels = np.where(known, image, np.nanmedian(image)).astype(np.float32)
        spacing = np.asarray(grid.voxel_size) / np.asarray(optics.sigma_um)
        doing()
        pixels = gaussian_filter(pixels, RULES.smooth / spacing)
        own, at = nearest_outside(~surface, spacing)
        doing()
        pixels -= np.percentile(pixels[known], 20)
        # The brightest voxel near each piece of surface is what a membrane looks like here.
        membrane = float(np.percentile(pixels[(own < 1) & known], 60))
        haze = minimum_filter(pixels, tuple(_across(RULES.haze / spacing)), mode="nearest")
        haze = np.maximum(haze, 0)
        # Beside a bright side of a cell its own image reaches further.
        crest = np.take(maximum_filter(pixels, tuple(_across(1 / spacing))), at)
        crest = np.maximum(crest, membrane)
        noise = RULES.above * _noise(pixels[known])
        doing()
        bright = pixels - haze > np.maximum(RULES.bright * crest, noise)
        reach = _reach(bright, own, known & ~inside, explained)
        return cls(
            known, inside, labels, pixels, haze, noise, bright, crest, membrane, spacing, own, reach
        )

    def far_things(self) -> Mask:
        """What is bright where the light of the starts has ended."""
        beyond = self.own - self.reach
        # What lies in a cell is light of this cell, whatever it is.
        far = self.bright & (beyond > 0) & ~self.inside & self.known
        return far & ~_rims(far, beyond)

    def protrusions(self, far: Mask) -> Mask:
        """Those of them that are fins and fingers of the starts."""
        around = self.known & ~self.inside
        above = max(_crest(self.pixels, self.own, around, self.membrane), 1e-30)
        height = np.where(self.known, self.pixels - self.haze, 0) / above
        # What is missing dims what is smoothed beside it.
        known, edge = self.known, 2 * RULES.smooth
        sure = known.all() or distance_transform(known, self.spacing) > edge
        doing()
        clear = self.bright & known & (height > RULES.bright)
        starts, beyond = np.where(self.inside, self.labels, 0), self.own - self.reach
        given = starts, beyond, height, known & sure, self.noise / above, self.spacing
        return protrusions(far, clear, *given)


def _shared_out(
    image: np.ndarray,
    grid: Grid,
    surface: Mask,
    labels: Labels,
    optics: Optics,
    explained: float,
    close: bool = False,
) -> np.ndarray:
    known, inside = np.isfinite(image), labels > 0
    if not (surface & known).any():
        return known
    seen = _Seen.of(image, grid, surface, labels, optics, explained)
    own, reach, spacing = seen.own, seen.reach, seen.spacing
    foreign = seen.far_things()
    foreign &= ~seen.protrusions(foreign)
    # Strangers are others' however near: half way to them, a fit still grew into what it could not
    # see of them.
    foreign |= known & (labels == STRANGER)
    doing()
    if close:
        shining = seen.pixels - seen.haze > RULES.beside * seen.crest
        strangers = known & without_start(shining, seen.pixels, labels, grid)
        doing()
        foreign, own, missed = without_missed(
            image, grid, labels, seen.pixels, foreign | strangers, strangers, own, reach, spacing
        )
        doing()
        if missed.any():
            foreign &= strangers | ~_rims(foreign & ~strangers, own - reach)
            inside |= missed
    doing()
    if not foreign.any():
        return known
    other = distance_transform(~foreign, spacing)
    return known & ((own < other) | inside)


def _crest(pixels: np.ndarray, own: np.ndarray, around: Mask, membrane: float) -> float:
    """What a membrane looks like where starts may be too small and lie on its dark inner flank."""
    shells = ((own >= w) & (own < w + 1) & around for w in range(1, int(RULES.explained)))
    return float(max([membrane, *(np.percentile(pixels[s], 60) for s in shells if s.any())]))


def _across(radius: np.ndarray) -> NDArray[np.signedinteger]:
    """(3,) odd numbers of voxels of a filter that reaches so many to each side."""
    return np.maximum(2 * np.ceil(radius).astype(int) + 1, 3)


def _radius(mesh: Mesh, optics: Optics) -> float:
    """Radius of the median cell, in widths of the PSF."""
    volume = float(np.median(list(mesh.volumes().values())))
    radius = ball_radius(abs(volume))
    return float(radius / geometric_mean(optics.sigma_um))


def _reach(bright: Mask, own: np.ndarray, around: Mask, least: float) -> float:
    """Widths to which the image of the surfaces themselves reaches, ``least`` of them at least.

    Where most of what lies so far from them is bright, it is theirs: of a PSF that is wider than it
    was taken for, or of membranes further out than the starts. Neighbours lie to some sides only.
    """
    shells = max(int((RULES.farthest - least) / RULES.further), 0)
    near = around & (own >= least) & (own < least + shells * RULES.further)
    shell = ((own[near] - least) / RULES.further).astype(int)
    all_of_it = np.bincount(shell, minlength=shells)
    share = np.bincount(shell, bright[near], shells) / np.maximum(all_of_it, 1)
    dark = np.flatnonzero(share < RULES.most)
    if not (dark.size and dark[0]):
        return least
    return least + RULES.further * float(dark[0]) + RULES.margin


def _rims(things: Mask, beyond: np.ndarray) -> Mask:
    """The things that are rims of what they lie beside.

    beyond : (Z, Y, X) widths from where its light ends.
    """
    parts, number = label(things)
    farthest = highest(beyond, parts, number)
    return things & np.append(False, farthest <= RULES.rim)[parts]


def _noise(values: np.ndarray) -> float:
    """Standard deviation of the darker half of voxels, whose median is the level of the dark."""
    low, middle = np.percentile(values, (RULES.low, 50))
    return float(middle - low) / RULES.deviation


def _dark_regions(image: np.ndarray, grid: Grid, mesh: Mesh, starts: Labels) -> Labels | None:
    """(Z, Y, X) the dark region around the deepest voxel of each start; None if one has none."""
    size, first = np.asarray(grid.voxel_size), np.asarray(grid.origin)
    places = []
    boxes = find_objects(starts)
    for region in mesh.region_ids():
        doing()
        box = boxes[region - 1]
        deep = depths(starts[box] == region, size)
        corner = np.array([one.start for one in box])
        places.append(first + size * (corner + np.unravel_index(deep.argmax(), deep.shape)))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RepairWarning)
            found = labels_from_points(
                filled(image), grid.voxel_size, places, grid.origin, dark=True
            )
    except InputError:
        return None
    names = np.concatenate([[0], mesh.region_ids()])
    named = names[found]
    return named if alike(named, starts, np.asarray(mesh.region_ids())) else None


def surface_shares(known: np.ndarray, grid: Grid, mesh: Mesh) -> dict[int, float]:
    """Share of the surface of each region that lies in such voxels; known : (Z, Y, X) bool."""
    middles = mesh.vertices_numpy()[mesh.faces].mean(1)
    index = np.rint((middles - np.asarray(grid.origin)) / np.asarray(grid.voxel_size))
    index = np.clip(index, 0, np.asarray(grid.shape) - 1).astype(np.int64)
    areas, there = mesh.areas(), known[tuple(index.T)]
    return {
        r: float(areas[own][there[own]].sum() / max(areas[own].sum(), 1e-300))
        for r, own in mesh.faces_by_region().items()
    }


def surface_voxels(mesh: Mesh, grid: Grid) -> np.ndarray:
    """(Z, Y, X) bool: voxels nearest to points on the surface that are at most 2/3 voxel apart."""
    first, size = np.asarray(grid.origin), np.asarray(grid.voxel_size)
    corners = (mesh.vertices_numpy()[mesh.faces] - first) / size
    longest = np.abs(corners - np.roll(corners, 1, axis=1)).max((1, 2))
    closer = 1.5  # points per voxel along an edge, so that no voxel is skipped
    points = np.ceil(closer * np.minimum(longest, 2 * max(grid.shape))).astype(int)
    points = np.maximum(points, 1)
    out = np.zeros(grid.shape, bool)
    for n in np.unique(points).tolist():
        faces = corners[points == n]
        i, j = (k.ravel() for k in np.mgrid[0 : n + 1, 0 : n + 1])
        weights = np.stack([i, j, n - i - j], 1)[i + j <= n] / n
        for part in np.array_split(faces, max(1, len(faces) * len(weights) // 4_000_000)):
            index = np.rint((weights @ part).reshape(-1, 3)).astype(np.int64)
            index = index[((index >= 0) & (index < np.asarray(grid.shape))).all(1)]
            out[tuple(index.T)] = True
    return out
