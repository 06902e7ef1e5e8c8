"""Cells that are brighter than what is around them, such as nuclei; and which kind an image shows.

What is brighter than a threshold is cut where it is narrow, and each part ends at half of its own
brightness. Where that leaves clumps, as among crowded cells with hardly a gap, each blob is a cell
(`crowded_cells`): so it is where evenly bright blobs explain the image better, and where dark walls
part a clump (`dark_walls`). What is found may be a whole embryo, in whose light the cells lie
(`cells_in_haze`). In an image of membranes the same steps find whole cells, too, or pieces of
walls: so what walls enclose comes first if most of the light lies there, and a net of walls around
dark places holds no bright cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.filters import threshold_li, threshold_otsu

from ...common.kept import Kept
from ...errors import InputError
from ..distance_transform import distance_transform
from ..mesh import FloatArray
from .basins import content_of
from .bright_things import (
    Smoothed,
    bright_things,
    ended,
    ground_beside,
    of_a_size,
    smoothed,
    typical_diameter,
    unexplained,
)
from .cell_sizes import SizeFound, likeliest, suggest_sizes
from .cells_in_haze import cells_in_haze
from .checked_image import checked_image, positive_size
from .crowded_cells import crowded_cells, without_halves
from .dark_walls import without_bright_walls, without_parted
from .find_cells import WalledCells, none_found, walled_cells
from .in_focus import Image, have_rims, in_focus
from .label_repair import label_boxes
from .region_merging import Labels
from .solidity import mean_solidity


@dataclass(frozen=True)
class BrightRules:
    """Thresholds that decide whether cells are bright.

    Attributes
    ----------
    enclosed, surely
        Shares of the light at and in cells with walls: up to the first, bright ones come first if
        they are whole; above the second, if those with walls are whole, there are none. Else the
        more solid are the cells: crowded bright cells have walls of darkness, and the light of a
        haze is not at walls. Chosen. Measured: 0.04 to 0.59 in images of nuclei, 0.82 once, where
        what walls of darkness enclosed had a solidity of 0.63; 0.29 to 0.86 with membranes in a
        haze, 0.86 and more in 14 tissues without.
    whole
        Mean solidity from which things count as cells. Measured: 0.33 to 0.58 for pieces of walls
        in real images, 0.44 to 0.55 for noise, 0.72 for red blood cells. Of what dark walls part in
        a thing: 0.48 and 0.50 where wrongly, 0.59 in a real dividing nucleus, 0.68 and more else.
    reach
        Sides of a voxel around cells with walls that count as theirs.
    holes
        What is bright holds cells up to so much of it in dark places that it surrounds within a
        slice, as walls do. Measured: 0 to 0.06 in 19 images of cells that shine from inside,
        seven of them real, and 0.105 on a lattice of balls that touch; 0.14 and more in six real
        ones of membranes, mitochondria and pollen.
    explained, alike
        Of the variance of the image that large things leave: smaller ones that leave less than the
        first are better; up to the second, the more solid (volume over that of the convex hull).
        Measured: 0.58 to 0.91 in crowds of nuclei, one real and nine simulated, and in a real
        biofilm; 0.92 to 1.04 in three real and twelve simulated images where large ones are right
        as well, 0.98 to 1.011 in eight where cells without a gap had been one, and 2 for pieces.
    crumbs
        Smaller ones are no cells, however much they explain, if they are so much less solid than
        the large ones. Measured: up to 0.03 in 30 simulated images of nuclei where both are right
        and 0.09 in a real one of blood cells; 0.2 and 0.24 in two where noise was found, too.
    """

    enclosed: float = 0.4
    surely: float = 0.75
    whole: float = 0.65
    reach: float = 2.0
    holes: float = 0.12
    explained: float = 0.95
    alike: float = 1.02
    crumbs: float = 0.1


RULES = BrightRules()


@dataclass(frozen=True, eq=False)
class CellsFound:
    """The cells found in an image.

    Attributes
    ----------
    labels
        (Z, Y, X) int32: 1 to n; 0 is background.
    size
        um: diameter of the typical cell.
    bright
        Whether they were found as bright things, not by their walls.
    others
        For cells found by their walls: other sizes that they may have, the likeliest first.
    """

    labels: NDArray[np.int32]
    size: float
    bright: bool
    others: tuple[SizeFound, ...] = ()


_Checked = tuple[Image, NDArray[np.bool_], FloatArray]  # as checked_image returns it
_FOUND: Kept[CellsFound | InputError] = Kept(1)


def cells_of(
    image: ArrayLike, voxel_size: Sequence[float], size: float | None = None
) -> CellsFound:
    """Find the cells of an image, whether their membranes shine or their insides.

    In widefield stacks, light that is out of focus is left out first, unless voxels are missing.

    Parameters
    ----------
    image : (Z, Y, X) array; NaN where missing.
    voxel_size : um, Z, Y, X.
    size : um; the diameter of a typical cell. None: estimated.

    Raises
    ------
    InputError
        For the same reasons as in :func:`~.find_cells.find_cells`.
    """
    checked = data, known, voxel = checked_image(image, voxel_size)
    # Seeds are found, and then asked how far they reach, in the same image.
    key = content_of(data, voxel), content_of(known, voxel), size
    found = _FOUND.get(key, lambda: _found_or_why_not(image, voxel_size, size, checked))
    if isinstance(found, InputError):
        raise copy(found)
    return replace(found, labels=found.labels.copy())


def _found_or_why_not(
    image: ArrayLike, voxel_size: Sequence[float], size: float | None, checked: _Checked
) -> CellsFound | InputError:
    try:
        return _cells_of(image, voxel_size, size, checked)
    except InputError as error:
        return error.with_traceback(None)  # which would keep large arrays


def _cells_of(
    image: ArrayLike, voxel_size: Sequence[float], size: float | None, checked: _Checked
) -> CellsFound:
    data, known, voxel = checked
    sharper = in_focus(data, voxel) if known.all() else data
    widefield = sharper is not data
    if widefield:
        image, data = sharper, checked_image(sharper, voxel_size)[0]
    size = None if size is None else positive_size(size)
    tried = suggest_sizes(image, voxel_size) if size is None else []
    asked = size or likeliest(tried, data.shape, voxel)
    walled: WalledCells | None
    refused = None
    try:
        walled = walled_cells(image, voxel_size, asked)
        if widefield:
            walled = _not_between(walled, sharper, voxel, asked)
    except InputError as error:
        walled, refused = None, error
    seen = smoothed(data, known, voxel)
    bright = _instead(None if walled is None else walled.sure, seen, size)
    if bright is not None:
        whole = _without_holes(bright)
        return CellsFound(whole, typical_diameter(whole, voxel), True)
    if walled is None:
        assert refused is not None, "what was not found was refused"
        raise refused
    return CellsFound(walled.labels, asked, False, tuple(tried[1:]))


def _not_between(
    walled: WalledCells, sharper: Image, voxel: FloatArray, size: float
) -> WalledCells:
    """Leave out the gaps between light cones; NoCellsFound if no cell is left."""
    cells = walled.of(have_rims(walled.labels, sharper, voxel))
    if not cells.surely.any():
        raise none_found(size)
    return cells


def _instead(
    walled: NDArray[np.int32] | None, seen: Smoothed, size: float | None
) -> NDArray[np.int32] | None:
    """Return bright cells if they are likelier than those that walls enclose, if any; else None."""
    share = 0.0 if walled is None else _light_at(seen, walled)
    solid = 0.0 if walled is None else mean_solidity(walled)
    surely = share >= RULES.surely and solid > RULES.whole
    if (surely and size is None) or _holes(seen.above(threshold_li)) > RULES.holes:
        return None
    # In an embryo that shines all over, a size may leave nothing but the gaps between its nuclei.
    bright = None if surely else _by_threshold(seen, size, share, solid)
    large = bright if size is None else bright_things(seen, None, threshold_li)[0]
    within = cells_in_haze(seen, large, size)
    better = within is not None and (bright is not None or mean_solidity(within) > solid)
    return within if better else bright


def _by_threshold(
    seen: Smoothed, size: float | None, share: float, solid: float
) -> NDArray[np.int32] | None:
    """Return labels of bright things if they are likelier cells than what walls enclose; else None.

    share : of the light, at cells with walls. solid : mean solidity of those cells; 0 without any.
    """
    bright, hollow = bright_things(seen, size, threshold_li)
    if not solid and (bright is None or hollow):
        # In the halo of a bead, or of a few bright nuclei, that threshold holds the halo.
        brighter, ring = bright_things(seen, size, threshold_otsu)
        if brighter is not None and not ring:
            bright, hollow = brighter, False
    if bright is None:
        return None
    first = share < RULES.enclosed and mean_solidity(bright) > RULES.whole
    if not first and (hollow or not solid):
        return None  # pieces of walls, or of noise
    if not hollow:
        bright = _without_clumps(bright, seen, size)
    return bright if first or mean_solidity(bright) > solid else None


def _without_clumps(
    found: NDArray[np.int32], seen: Smoothed, size: float | None
) -> NDArray[np.int32]:
    """Replace clumps by smaller cells that explain the image better, or that dark walls part."""
    blobs = np.where(seen.known, crowded_cells(seen.data, seen.voxel, size), 0)
    if not blobs.any():
        return found
    depth = distance_transform(blobs > 0, seen.voxel)
    # Each cell ends at half of its own brightness.
    smaller = of_a_size(without_halves(ended(seen, blobs, depth)), seen.voxel, size)
    cells = found if smaller is None else _likelier(found, smaller, seen)
    walled = without_bright_walls(blobs, seen.smooth, ground_beside(seen, blobs))
    parts = of_a_size(ended(seen, walled, depth), seen.voxel, size)
    return cells if parts is None else without_parted(cells, parts, RULES.whole)


def _likelier(
    found: NDArray[np.int32], smaller: NDArray[np.int32], seen: Smoothed
) -> NDArray[np.int32]:
    """Return the smaller cells if they explain the image better, else those found."""
    left = unexplained(seen, smaller) / max(unexplained(seen, found), 1e-30)
    gained = mean_solidity(smaller) - mean_solidity(found)
    better = left < RULES.alike if gained > 0 else left < RULES.explained
    return smaller if better and gained > -RULES.crumbs else found


def _holes(things: NDArray[np.bool_]) -> float:
    """Volume of the holes that a mask surrounds within single slices, over its own volume."""
    things = ndimage.binary_opening(things)
    inside = sum(int((ndimage.binary_fill_holes(plane) & ~plane).sum()) for plane in things)
    return inside / max(int(things.sum()), 1)


def _without_holes(labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Fill the holes of each cell with its label."""
    whole = labels.copy()
    for k, box in label_boxes(labels):
        own = ndimage.binary_fill_holes(labels[box] == k)
        whole[box][own & (labels[box] == 0)] = k
    return whole


def _light_at(seen: Smoothed, labels: Labels) -> float:
    """Return the share of the light that lies in cells or near them."""
    light = np.maximum(seen.smooth - threshold_li(seen.smooth[seen.known]), 0) * seen.known
    reach = RULES.reach * seen.voxel.min()
    near = distance_transform(labels == 0, seen.voxel) <= reach
    return float((light * near).sum()) / max(float(light.sum()), 1e-30)
