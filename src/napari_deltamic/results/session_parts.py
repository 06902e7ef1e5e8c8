"""The parts of a session; see :mod:`napari_deltamic.results.session_file`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.triple import Triple
from ..fitting import FitState
from ..fitting.history import History
from ..geometry import Mesh
from ..runs.settings import RunSettings
from ..runs.track_run import TrackRun
from ..scene import Grid
from ..tracking import FrameResult
from .timeline import Moment


@dataclass(frozen=True, eq=False)
class SavedImage:
    """The image that is fitted, and how its layer lies in the viewer's world.

    pixels : (Z, Y, X), of any real type; NaN where missing.
    voxel_size : um, Z, Y, X.
    scale, translate, units : of the layer, Z, Y, X; the scale is in units of the world.
    display : plain values that say how it is shown (contrast limits, colormap, ...).
    """

    name: str
    pixels: NDArray[Any]
    voxel_size: Triple
    scale: Triple
    translate: Triple
    units: tuple[str, str, str]
    display: dict[str, Any] = field(default_factory=dict)

    @property
    def grid(self) -> Grid:
        """Its grid, in um from the centre of the first voxel."""
        z, y, x = self.pixels.shape
        return Grid((z, y, x), self.voxel_size)


@dataclass(frozen=True, eq=False)
class SavedLayer:
    """A layer, such as seeds, and its place in the viewer's world.

    kind : points, labels or surface.
    arrays : points: data (n, 3), size (n,); labels: data (Z, Y, X); surface: vertices (V, 3),
        faces (F, 3) and, if known, regions (F, 2).
    scale, translate, units : of the layer, Z, Y, X.
    options : further plain values (colours, symbols, ...).
    """

    kind: str
    name: str
    arrays: dict[str, NDArray[Any]]
    scale: Triple
    translate: Triple
    units: tuple[str, str, str]
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SavedResult:
    """The result of a fit.

    settings : of the fit; those of the session may have been changed since.
    start : the mesh where it started, um; None if not known.
    state : the last good state.
    history : its course, which took ``seconds``.
    verdict, message : how it ended, in one word and in a sentence.
    moments : the states that were kept on the way.
    counted : (Z, Y, X) bool: voxels that may count; None for all.
    """

    settings: RunSettings
    state: FitState
    history: History
    seconds: float = 0.0
    verdict: str = ""
    message: str = ""
    start: Mesh | None = None
    moments: tuple[Moment, ...] = ()
    counted: NDArray[np.bool_] | None = None


@dataclass(frozen=True, eq=False)
class SavedTracks:
    """Cells tracked through a series, and the series.

    pixels : (T, Z, Y, X); the image of the session is one of its frames.
    time : scale, translation and unit of the layer along T.
    results : of the frames that are done.
    settings : of the run; its ``fit`` is that of the first frame.
    seconds : how long tracking took.
    shared_ground : see :func:`napari_deltamic.tracking.track`.
    """

    pixels: NDArray[Any]
    time: tuple[float, float, str]
    results: tuple[FrameResult, ...]
    settings: TrackRun
    seconds: float = 0.0
    shared_ground: bool = False


@dataclass(frozen=True, eq=False)
class Session:
    """Everything that a session file holds.

    settings : what the panels show.
    seeds : the layers that the seeds come from.
    panels : plain values of the panels that are not settings of a run.
    second : image of the second view, if the settings have one.
    """

    settings: RunSettings
    image: SavedImage
    seeds: tuple[SavedLayer, ...] = ()
    result: SavedResult | None = None
    panels: dict[str, Any] = field(default_factory=dict)
    second: SavedImage | None = None
    tracks: SavedTracks | None = None
