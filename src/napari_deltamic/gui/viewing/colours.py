"""One colour for each region, the same in the viewer, the table and the pictures of a report."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from napari.utils import Colormap
from napari.utils.colormaps import DirectLabelColormap, ensure_colormap
from numpy.typing import NDArray

from ...geometry import Mesh
from ...results.colouring import COLOURS, PALETTE, colour_indices, label_indices, plain_index

_DIM, _GREY = 0.75, 0.42  # a cell that is not chosen: so much of this grey in its colour
_GHOSTLY = 0.4  # its opacity in 3D: one looks through it at what is chosen
_OPAQUE = np.ones((len(PALETTE), 1))
PALETTE_RGBA = np.hstack([np.array(PALETTE) / 255, _OPAQUE])
_DIMMED = np.hstack([(1 - _DIM) * PALETTE_RGBA[:, :3] + _DIM * _GREY, _OPAQUE])
_BOTH = np.concatenate([PALETTE_RGBA, _DIMMED])
_GHOSTS = _BOTH.copy()
_GHOSTS[len(PALETTE_RGBA) :, 3] = _GHOSTLY
# Viridis without its darkest third, which could not be seen on a dark image.
BY_VALUE = Colormap(ensure_colormap("viridis").map(np.linspace(0.35, 1, 64)), name="by value")
# Where, in 3D, in widths of the limits: the colours of what is not chosen begin, cells without a
# number are, and those of them that are not chosen.
_GHOSTS_FROM, _WITHOUT, _END = 2.0, 4.0, 5.0
LIMITS = (0.0, float(len(_BOTH)))


def _dimmed(colours: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hstack([(1 - _DIM) * colours[:, :3] + _DIM * _GREY, colours[:, 3:]])


def _with_ghosts() -> Colormap:
    """The colours of ``BY_VALUE``, dimmed ones for cells not chosen, and greys for NaN."""
    bright, grey = np.asarray(BY_VALUE.colors, float), np.full((1, 4), _GREY)
    ghosts, grey[0, 3] = _dimmed(bright), 1.0
    pale = grey.copy()
    ghosts[:, 3] = pale[:, 3] = _GHOSTLY
    n, before_ghosts, before_grey, before_pale = len(bright), 1.5, 3.5, 4.5
    steps: list[Any] = [
        *(np.linspace(0, 1, n), (before_ghosts, before_ghosts)),
        *(np.linspace(_GHOSTS_FROM, _GHOSTS_FROM + 1, n), (before_grey, before_grey)),
        (before_pale, before_pale, _END),
    ]
    colours = [bright, bright[-1:], ghosts[:1], ghosts, ghosts[-1:], grey, grey, pale, pale]
    controls = np.concatenate(steps) / _END
    return Colormap(np.concatenate(colours), controls=controls, name="numbers of cells")


_OF_NUMBERS = _with_ghosts()


@dataclass(frozen=True)
class ByValue:
    """Colours cells by a number of each, instead of giving each a colour of its own.

    values : region -> number; those without one are grey.
    """

    values: Mapping[int, float]

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest of the numbers."""
        known = [value for value in self.values.values() if np.isfinite(value)]
        low, high = (min(known), max(known)) if known else (0.0, 1.0)
        return low, high if high > low else low + max(abs(low), 1.0) * 1e-3

    def at(self, regions: Any) -> NDArray[np.float32]:
        """The numbers of regions; NaN for those without one."""
        names, inverse = np.unique(np.asarray(regions), return_inverse=True)
        known = np.array([self.values.get(int(name), np.nan) for name in names], np.float32)
        return known[inverse].reshape(np.shape(regions))

    def look(self) -> tuple[Colormap, tuple[float, float]]:
        """Colormap and contrast limits of a surface with ``surface_values``."""
        low, high = self.limits
        return _OF_NUMBERS, (low, low + _END * (high - low))

    def surface_values(
        self, sides: NDArray[np.int64], chosen: Collection[int] = ()
    ) -> NDArray[np.float32]:
        """(n,) values for vertices between regions (n, k), as in ``side_values``."""
        low, high = self.limits
        own = np.where(np.isin(sides, list(chosen)), sides, 0).max(axis=1)
        values, width = self.at(np.where(own > 0, own, sides.max(axis=1))), high - low
        dim, without = (own == 0) & bool(chosen), ~np.isfinite(values)
        shown = np.where(dim, values + _GHOSTS_FROM * width, values)
        shown[without] = low + np.where(dim[without], _END, _WITHOUT) * width
        return shown.astype(np.float32)

    def rgba(self, regions: Any, chosen: Collection[int] = ()) -> NDArray[np.float64]:
        """Colours of regions, (n, 4) RGBA; if some are chosen, the others are dimmed."""
        low, high = self.limits
        share = (self.at(regions) - low) / (high - low)
        colours = np.asarray(BY_VALUE.map(np.nan_to_num(np.atleast_1d(share))), float)
        colours[~np.isfinite(np.atleast_1d(share))] = (_GREY, _GREY, _GREY, 1.0)
        dim = ~np.isin(np.atleast_1d(regions), list(chosen)) & bool(chosen)
        colours[dim] = _dimmed(colours[dim])
        return colours


def region_colours(
    regions: Any, chosen: Collection[int] = (), indices: Mapping[int, int] | None = None
) -> NDArray[np.float64]:
    """(n, 4) RGBA for region numbers from 1, or (4,) for one.

    Where some are chosen, the others are dimmed. ``indices`` are those of ``colour_indices``;
    without them each region has the colour of its number.
    """
    numbers = np.asarray(regions)
    index = _places(numbers, indices)
    if chosen:
        index = index + len(PALETTE_RGBA) * ~np.isin(numbers, list(chosen))
    return _BOTH[index]


def region_colormap() -> Colormap:
    """A colormap that, over ``LIMITS``, gives ``vertex_values`` the colours of their regions."""
    return in_steps(_GHOSTS, "deltamic regions")


def in_steps(colours: NDArray[np.float64], name: str) -> Colormap:
    """A colormap of n colours (n, 4) RGBA, each over one n-th of the limits."""
    if len(colours) == 1:
        colours = np.repeat(colours, 2, axis=0)  # a canvas draws by no fewer
    controls = np.linspace(0, 1, len(colours) + 1)
    return Colormap(colours, name=name, controls=controls, interpolation="zero")


def surface_look() -> dict[str, Any]:
    """Options of a Surface layer whose values are ``vertex_values``."""
    return {"colormap": region_colormap(), "contrast_limits": LIMITS, "shading": "smooth"}


def label_colormap(labels: NDArray[np.integer]) -> DirectLabelColormap:
    """A colormap for Labels that gives each label its region's colour, where possible.

    Labels lie side by side without a contour: two of one colour would look like one cell.
    """
    colours: dict[int | None, Any] = {k: PALETTE_RGBA[v] for k, v in label_indices(labels).items()}
    # None is napari's name for those that are painted later.
    return DirectLabelColormap(color_dict={None: PALETTE_RGBA[0], 0: np.zeros(4), **colours})


def vertex_values(mesh: Mesh) -> NDArray[np.float32]:
    """(V,) a value for each vertex; where regions meet, that of the highest region number."""
    largest = np.zeros(len(mesh.vertices), np.int64)
    np.maximum.at(largest, mesh.faces.ravel(), np.repeat(mesh.regions.max(axis=1), 3))
    return side_values(largest[:, None], (), colour_indices(mesh))


def side_values(
    sides: NDArray[np.int64], chosen: Collection[int] = (), indices: Mapping[int, int] | None = None
) -> NDArray[np.float32]:
    """(n,) values for vertices between regions (n, k): each that of the highest region number.

    Where some regions are chosen, all of their vertices have their colours, and the rest is dimmed.
    """
    values = _places(np.maximum(sides.max(axis=1), 1), indices) + 0.5
    if chosen:
        own = np.where(np.isin(sides, list(chosen)), sides, 0).max(axis=1)
        bright = _places(np.maximum(own, 1), indices) + 0.5
        values = np.where(own > 0, bright, values + len(PALETTE_RGBA))
    return values.astype(np.float32)


def _places(regions: NDArray[np.int64], indices: Mapping[int, int] | None) -> NDArray[np.int64]:
    """Places of region numbers (from 1) in the table of colours."""
    plain: NDArray[np.int64] = (regions - 1) % len(COLOURS)
    if not indices:
        return plain
    numbers, inverse = np.unique(regions, return_inverse=True)
    own = np.array([indices.get(n, plain_index(n)) for n in numbers.tolist()], np.int64)
    return own[inverse].reshape(regions.shape)
