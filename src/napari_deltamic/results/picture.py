"""A picture of a result: slices of the measured image with contours, the rendered ones below."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from ..errors import InputError
from ..geometry import Mesh
from ..measure import section
from ..scene import Grid
from .colouring import colour_indices, colour_of

WIDTH = 1280  # px, about; more where an image is finer
MIN_WIDTH, MAX_WIDTH, MAX_HEIGHT = 920, 2600, 2000
_GAP, _TITLE = 6, 22
_FINE = 2  # panels are drawn this many times larger and reduced: smooth lines
_LINE = 4  # px before that
_MISSING = (50, 0, 60)
_TEXT = (235, 235, 235)


@dataclass(frozen=True)
class _Slice:
    """A plane through the middle of a layer of voxels: the axis across it, and which layer."""

    axis: int
    index: int
    position: float  # um

    @property
    def label(self) -> str:
        plane, name = ("xy", "z") if self.axis == 0 else ("xz", "y")
        return f"{plane}, {name} = {self.position:.2f} um"


def picture(image: ArrayLike, rendered: ArrayLike, mesh: Mesh, grid: Grid) -> Image.Image:
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
    measured, model = np.asarray(image, np.float32), np.asarray(rendered, np.float32)
    for array in (measured, model):
        if array.shape != grid.shape:
            raise InputError(f"the image has shape {array.shape}, the grid {grid.shape}")
    slices = _slices(mesh, grid)
    scale = _scale(slices, grid)
    window = _window([np.take(measured, s.index, s.axis) for s in slices])
    rows = []
    for name, array, contours in (("measured", measured, mesh), ("rendered", model, None)):
        panels = [_panel(array, s, grid, scale, window, contours) for s in slices]
        rows.append((name, panels))
    return _compose(rows, slices)


def picture_png(image: ArrayLike, rendered: ArrayLike, mesh: Mesh, grid: Grid) -> bytes:
    """``picture`` as the content of a PNG file."""
    buffer = io.BytesIO()
    picture(image, rendered, mesh, grid).save(buffer, "PNG", optimize=True)
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
    """px per um, the same for all panels."""
    size = np.array(grid.shape) * grid.voxel_size
    width = len(slices) * float(size[2])
    finest = len(slices) * grid.shape[2]
    wanted = float(np.clip(max(WIDTH, finest), MIN_WIDTH, MAX_WIDTH)) / width
    height = 2 * float(max(size[_others(s.axis)[0]] for s in slices))
    return min(wanted, MAX_HEIGHT / height)


def _window(layers: Sequence[NDArray[np.float32]]) -> tuple[float, float]:
    values = np.concatenate([layer[np.isfinite(layer)] for layer in layers])
    if not len(values):
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(values, (0.5, 99.8)))
    return low, high if high > low else low + 1.0


def _panel(
    array: NDArray[np.float32],
    cut: _Slice,
    grid: Grid,
    scale: float,
    window: tuple[float, float],
    mesh: Mesh | None,
) -> Image.Image:
    layer = np.take(array, cut.index, cut.axis)
    known = np.isfinite(layer)
    grey = np.clip((np.where(known, layer, 0) - window[0]) / (window[1] - window[0]), 0, 1)
    colours = np.repeat((255 * grey[..., None]).astype(np.uint8), 3, axis=2)
    colours[~known] = _MISSING
    down, across = _others(cut.axis)
    sides = [layer.shape[i] * grid.voxel_size[k] * scale for i, k in ((0, down), (1, across))]
    height, width = (max(1, round(side)) for side in sides)
    fine = (width * _FINE, height * _FINE)
    larger = fine[0] >= layer.shape[1] and fine[1] >= layer.shape[0]
    how = Image.Resampling.NEAREST if larger else Image.Resampling.BOX
    panel: Image.Image = Image.fromarray(colours).resize(fine, how)
    if mesh is not None:
        _draw_contours(panel, cut, grid, mesh)
    return panel.resize((width, height), Image.Resampling.BOX)


def _draw_contours(panel: Image.Image, cut: _Slice, grid: Grid, mesh: Mesh) -> None:
    segments, faces = section(mesh, cut.axis, cut.position)
    others = _others(cut.axis)
    size = np.asarray(grid.voxel_size)[others]
    shape = np.asarray(grid.shape)[others]
    # The first voxel's centre is half a voxel from the edge of the picture.
    voxels = (segments - np.asarray(grid.origin)[others]) / size + 0.5
    places = voxels / shape * (panel.height, panel.width)
    regions = mesh.regions[faces].max(axis=1)
    draw, indices = ImageDraw.Draw(panel), colour_indices(mesh)
    for ends, region in zip(places.tolist(), regions.tolist(), strict=True):
        colour = colour_of(region, indices)
        draw.line([(x, y) for y, x in ends], fill=colour, width=_LINE)


def _compose(
    rows: Sequence[tuple[str, Sequence[Image.Image]]], slices: Sequence[_Slice]
) -> Image.Image:
    """Panels in a table, each with its title above."""
    font: Any = _font()
    panels = rows[0][1]
    # A title needs room, however narrow its panel.
    columns = [
        max(panel.width, int(font.getlength(f"measured  {cut.label}")) + _GAP)
        for panel, cut in zip(panels, slices, strict=True)
    ]
    row_height = max(panel.height for panel in panels) + _TITLE + _GAP
    width = max(sum(columns) + _GAP * (len(columns) + 1), MIN_WIDTH)
    canvas = Image.new("RGB", (width, row_height * len(rows) + _GAP), (24, 24, 24))
    draw = ImageDraw.Draw(canvas)
    for r, (name, row) in enumerate(rows):
        left, top = _GAP, _GAP + r * row_height
        for panel, cut, column in zip(row, slices, columns, strict=True):
            draw.text((left, top), f"{name}  {cut.label}", fill=_TEXT, font=font)
            canvas.paste(panel, (left, top + _TITLE))
            left += column + _GAP
    return canvas


def _font() -> Any:
    try:
        return ImageFont.load_default(14)
    except (ImportError, TypeError, OSError):  # a Pillow without FreeType
        return ImageFont.load_default()
