"""The starting surfaces that points would give, computed in the background and shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QCheckBox, QWidget

from ...errors import InputError
from ...geometry import Mesh
from ...geometry.labels.meshes import EDGE_IN_VOXELS
from ...geometry.seed_points import surfaces_of_points
from ...images.missing import filled
from ...scene import Grid
from ..attempt import attempt
from ..background import Background
from ..qt import Signal
from ..viewing.frame import FloatArray, Frame
from .start_layers import StartLayers

Problem = tuple[str, tuple[int, ...]]  # a sentence, and the points that it names, from 1
WAIT = 400  # ms without a click before the preview is computed
SMALL = 250_000  # voxels whose preview takes about a second
COARSEST = 2  # voxels are joined in each direction, at most, to get there
_TIP = (
    "<qt>Shows, shortly after each click, the membrane that was found around each point: contours "
    "on the slices, surfaces in 3D. Takes about a second or two in the background, for which the "
    f"image is made coarser by up to {COARSEST} voxels in each direction. Off at first for images "
    "of more than about {most:.1f} million voxels, which take longer.</qt>"
)


@dataclass(frozen=True)
class Found:
    """Starting surfaces, None if no point gave any; and what was wrong with those that did not."""

    mesh: Mesh | None
    problems: tuple[Problem, ...]


@dataclass(frozen=True)
class Wanted:
    """What a preview is of: points, um in the frame of an image layer, and when.

    image : gives the voxels; only asked when the preview is computed.
    """

    points: FloatArray
    image: Callable[[], NDArray[Any]]
    layer: Any
    frame: Frame
    time: tuple[int, ...] = ()

    def key(self) -> tuple[Any, ...]:
        """Equal where the preview is the same."""
        return self.points.tobytes(), id(self.layer), self.frame, self.time


class Preview(QCheckBox):
    """The box that turns the preview on, and what it turns on; ``changed``: other problems."""

    changed = Signal()

    def __init__(
        self, viewer: Any, wanted: Callable[[], Wanted | None], parent: QWidget | None = None
    ) -> None:
        super().__init__("preview", parent)
        self.setToolTip(_TIP.format(most=SMALL * COARSEST**3 / 1e6))
        self.problems: tuple[Problem, ...] = ()
        self._wanted = wanted
        self._user_chose = False
        self._open = True
        self._preferred = True
        self._asked: Wanted | None = None
        self._key: tuple[Any, ...] | None = None
        self._layers = StartLayers(viewer, self._removed_by_user)
        self._background = Background(self._show, self._fail)
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(WAIT)
        self._timer.timeout.connect(self._ask)
        self.clicked.connect(self._note_choice)
        self.toggled.connect(self._toggled)

    @property
    def busy(self) -> bool:
        """Whether a preview is awaited."""
        return self._open and (self._timer.isActive() or self._background.busy)

    @property
    def mesh(self) -> Mesh | None:
        """What is shown."""
        return self._layers.mesh

    def suit(self, shape: tuple[int, ...], size: tuple[float, ...]) -> None:
        """On for images of which it is fast, off for others; unless the user has chosen."""
        if not self._user_chose:
            factors = coarsening(shape, size)
            coarse = np.prod(np.ceil(np.divide(shape, factors)))
            self.setChecked(self._preferred and bool(coarse <= SMALL))

    def prefer(self, on: bool) -> None:
        """Whether it is on at first."""
        self._preferred = on
        if not on and not self._user_chose:
            self.setChecked(False)

    def later(self) -> None:
        """The points may be others: compute it anew, unless they change again at once."""
        if not self._open:
            return
        wanted = self._wanted() if self.isChecked() else None
        if wanted is None:
            self.clear()
        elif wanted.key() != self._key:
            self._key = wanted.key()
            self._background.drop()
            self._timer.start()

    def clear(self) -> None:
        """Show none until the points change."""
        if self._open:
            self._timer.stop()
        self._background.drop()
        self._asked = self._key = None
        self._layers.clear()
        self._set_problems(())

    def close_links(self) -> None:
        """End what is under way and let the viewer go."""
        self._open = False
        self._background.close()
        self._layers.close()
        self._asked = None

    def _ask(self) -> None:
        asked = self._wanted() if self._open and self.isChecked() else None
        if asked is None:
            return
        attempt(partial(self._look_for, asked), self._fail)
        self.changed.emit()

    def _look_for(self, asked: Wanted) -> None:
        image = asked.image()
        self._asked = asked
        self._background.ask(partial(find, asked.points, image, asked.frame.grid(image.shape)))

    def _show(self, found: Found) -> None:
        asked, self._asked = self._asked, None
        if asked is None:
            return
        if found.mesh is None:
            self._layers.clear()
        else:
            self._layers.show(found.mesh, asked.layer, asked.frame)
        self._set_problems(found.problems)

    def _fail(self, message: str) -> None:
        self._layers.clear()
        self._set_problems(((f"no preview: {message}", ()),))

    def _set_problems(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        self.changed.emit()

    def _note_choice(self, checked: bool) -> None:
        self._user_chose = True

    def _toggled(self, checked: bool) -> None:
        self.later()

    def _removed_by_user(self) -> None:
        self._user_chose = True
        self.setChecked(False)


def find(points: FloatArray, image: NDArray[Any], grid: Grid) -> Found:
    """Starting surfaces of points (um), on a coarser image where that saves much time.

    Points that give none are named and left out; those outside the image only left out.
    """
    inside = np.floor(points / np.asarray(grid.voxel_size) + 0.5)
    left = np.flatnonzero(((inside >= 0) & (inside < np.asarray(grid.shape))).all(axis=1))
    if not len(left):
        return Found(None, ())
    whole, coarse = coarser(filled(image), grid)
    edge = EDGE_IN_VOXELS * min(grid.voxel_size)  # that of the fit
    try:
        parts, refused = surfaces_of_points(
            whole, coarse.voxel_size, points[left], None, coarse.origin, edge
        )
    except InputError as error:
        return Found(None, ((str(error), ()),))
    problems = tuple((one.text, tuple(int(left[n - 1]) + 1 for n in one.points)) for one in refused)
    return Found(Mesh.merge(parts) if parts else None, problems)


def coarsening(shape: tuple[int, ...], size: tuple[float, ...]) -> tuple[int, ...]:
    """How many voxels to join along each axis: none in small images, else the shortest first."""
    factors = [1] * len(shape)
    for axis in np.argsort(size, kind="stable").tolist():
        voxels = np.prod(np.ceil(np.divide(shape, factors)))
        same = [k for k in range(len(shape)) if np.isclose(size[k], size[axis])]
        if voxels > SMALL:
            for k in same:
                factors[k] = COARSEST
    return tuple(factors)


def coarser(image: NDArray[Any], grid: Grid) -> tuple[NDArray[Any], Grid]:
    """The image with voxels joined by ``coarsening``, and its grid."""
    factors = coarsening(grid.shape, grid.voxel_size)
    if max(factors) == 1:
        return image, grid
    short = [(0, -n % f) for n, f in zip(image.shape, factors, strict=True)]
    blocks = np.pad(np.asarray(image, np.float32), short, mode="edge")
    for axis, factor in enumerate(factors):
        shape = (*blocks.shape[:axis], -1, factor, *blocks.shape[axis + 1 :])
        blocks = blocks.reshape(shape).mean(axis=axis + 1)
    size = np.multiply(grid.voxel_size, factors)
    # The first voxel is now the middle of several.
    origin = np.add(grid.origin, np.multiply(grid.voxel_size, np.subtract(factors, 1)) / 2)
    return blocks, Grid(blocks.shape, _triple(size), _triple(origin))


def _triple(values: Any) -> tuple[float, float, float]:
    z, y, x = (float(v) for v in values)
    return z, y, x
