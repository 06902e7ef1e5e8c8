"""A picture of a result: measured slices with contours, and rendered slices below."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry import Mesh
from ..measure import section
from ..scene import Grid
from .colouring import colour_indices, colour_of

if TYPE_CHECKING:  # matplotlib takes half a second to load: done only when something is drawn
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 1280  # px, about; more if an image is finer
MIN_WIDTH, MAX_WIDTH, MAX_HEIGHT = 920, 2600, 2000
_DPI = 100
_GAP, _TITLE, _TITLE_WIDTH = 6, 22, 210  # px; a title needs room, however narrow its panel
_LINE = 1.4  # points
_BACKGROUND, _MISSING, _TEXT = "#181818", "#32003c", "#ebebeb"


@dataclass(frozen=True)
class _Slice:
    """A plane through the middle of a layer of voxels, perpendicular to an axis."""

    axis: int
    index: int
    position: float  # um

    @property
    def label(self) -> str:
        plane, name = ("xy", "z") if self.axis == 0 else ("xz", "y")
        return f"{plane}, {name} = {self.position:.2f} um"


def picture(image: ArrayLike, rendered: ArrayLike, mesh: Mesh, grid: Grid) -> Figure:
    """Draw slices of both images, the measured ones with the contours of the mesh.

    Three slices across Z and one across Y, spread over the mesh, with the proportions of the
    specimen and one range of grey for all. Contours have a colour for each region; a wall between
    two has that of the larger number. Missing voxels (NaN) are violet.

    Parameters
    ----------
    image, rendered : (Z, Y, X)
    mesh : um
    grid : where the voxels lie.

    Raises
    ------
    InputError
        If the images do not fit the grid.
    """
    from matplotlib.figure import Figure

    measured, model = np.asarray(image, np.float32), np.asarray(rendered, np.float32)
    for array in (measured, model):
        if array.shape != grid.shape:
            raise InputError(f"the image has shape {array.shape}, the grid {grid.shape}")
    slices = _slices(mesh, grid)
    scale = _scale(slices, grid)
    sides = [_size(s, grid) * scale for s in slices]  # px: height and width of a panel
    window = _window([np.take(measured, s.index, s.axis) for s in slices])
    lefts = np.cumsum([_GAP, *(max(width, _TITLE_WIDTH) + _GAP for _, width in sides)])
    row = max(height for height, _ in sides) + _TITLE + _GAP
    width, height = max(float(lefts[-1]), MIN_WIDTH), 2 * row + _GAP
    figure = Figure((width / _DPI, height / _DPI), dpi=_DPI, facecolor=_BACKGROUND)
    for r, (name, array) in enumerate((("measured", measured), ("rendered", model))):
        for cut, (high, wide), left in zip(slices, sides, lefts.tolist(), strict=False):
            top = height - _GAP - _TITLE - r * row
            axes = figure.add_axes(
                (left / width, (top - high) / height, wide / width, high / height)
            )
            axes.set_title(f"{name}  {cut.label}", loc="left", color=_TEXT, fontsize=10, pad=4)
            _draw_slice(axes, array, cut, grid, window)
            if r == 0:
                _draw_contours(axes, cut, mesh)
    return figure


def picture_png(image: ArrayLike, rendered: ArrayLike, mesh: Mesh, grid: Grid) -> bytes:
    """Return ``picture`` as the content of a PNG file."""
    buffer = io.BytesIO()
    picture(image, rendered, mesh, grid).savefig(buffer, format="png")
    return buffer.getvalue()


def _slices(mesh: Mesh, grid: Grid) -> list[_Slice]:
    first, last = grid.extent
    low, high = np.clip(mesh.bounds(), first, last)
    found = []
    for axis, share in ((0, 0.2), (0, 0.5), (0, 0.8), (1, 0.5)):
        place = low[axis] + share * (high[axis] - low[axis])
        index = round(float((place - first[axis]) / grid.voxel_size[axis]))
        index = min(max(index, 0), grid.shape[axis] - 1)
        position = float(first[axis] + index * grid.voxel_size[axis])
        found.append(_Slice(axis, index, position))
    return found


def _others(axis: int) -> list[int]:
    return [k for k in range(3) if k != axis]


def _scale(slices: Sequence[_Slice], grid: Grid) -> float:
    """Return px per um, the same for all panels."""
    width = sum(_size(s, grid)[1] for s in slices)
    finest = len(slices) * grid.shape[2]
    wanted = float(np.clip(max(WIDTH, finest), MIN_WIDTH, MAX_WIDTH)) / width
    height = 2 * float(max(_size(s, grid)[0] for s in slices))
    return min(wanted, MAX_HEIGHT / height)


def _size(cut: _Slice, grid: Grid) -> NDArray[np.float64]:
    """Return height and width, um."""
    size: NDArray[np.float64] = np.array(grid.shape) * np.asarray(grid.voxel_size)
    return size[_others(cut.axis)]


def _window(layers: Sequence[NDArray[np.float32]]) -> tuple[float, float]:
    values = np.concatenate([layer[np.isfinite(layer)] for layer in layers])
    if not len(values):
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(values, (0.5, 99.8)))
    return low, high if high > low else low + 1.0


def _draw_slice(
    axes: Axes,
    array: NDArray[np.float32],
    cut: _Slice,
    grid: Grid,
    window: tuple[float, float],
) -> None:
    from matplotlib import colormaps

    layer = np.ma.masked_invalid(np.take(array, cut.index, cut.axis))
    shown: dict[str, Any] = {"cmap": colormaps["gray"].with_extremes(bad=_MISSING)}
    others = _others(cut.axis)
    low = (np.asarray(grid.origin) - 0.5 * np.asarray(grid.voxel_size))[others]
    high = low + _size(cut, grid)
    extent = (low[1], high[1], high[0], low[0])
    axes.imshow(layer, **shown, vmin=window[0], vmax=window[1], extent=extent, aspect="auto")
    axes.set_axis_off()


def _draw_contours(axes: Axes, cut: _Slice, mesh: Mesh) -> None:
    from matplotlib.collections import LineCollection

    segments, faces = section(mesh, cut.axis, cut.position)
    indices = colour_indices(mesh)
    regions = mesh.regions[faces].max(axis=1).tolist()
    colours = [np.array(colour_of(region, indices)) / 255 for region in regions]
    lines = list(segments[..., ::-1])  # x, y
    axes.add_collection(
        LineCollection(lines, colors=colours, linewidths=_LINE, capstyle="round"), autolim=False
    )
