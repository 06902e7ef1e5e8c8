"""The starting surfaces that points would give, computed in the background and shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from qtpy.QtWidgets import QCheckBox, QWidget

from ...geometry import Mesh
from ...runs.seed_preview import COARSEST, SMALL, Found, Problem, coarsening, find
from ..cell_source import PREVIEW, Wanted
from ..document import Document
from ..viewing.frame import MADE_BY_FIT, FloatArray, Frame
from ..viewing.mesh_layers import MeshLayers
from ..widgets import Signal

WAIT = 400  # ms without a click before the preview is computed
_TIP = (
    "<qt>Shows, shortly after each click, the membrane that was found around each point: contours "
    "on the slices, surfaces in 3D. Takes a second or two in the background, on a copy of the "
    f"image made up to {COARSEST} times coarser along each axis. Off at first for images "
    "of more than about {most:.1f} million voxels, which take longer.</qt>"
)


class Preview(QCheckBox):
    """The check box of the preview, and the preview; ``changed``: it found other problems."""

    changed = Signal()

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__("preview", parent)
        self.setToolTip(_TIP.format(most=SMALL * COARSEST**3 / 1e6))
        self.problems: tuple[Problem, ...] = ()
        self._wanted = doc.cells.wanted
        self._user_chose = False
        self._preferred = True
        self._key: tuple[Any, ...] | None = None
        self._viewer = doc.viewer
        self._layers: StartLayers | None = None
        self.background = doc.background(self._fail)
        doc.at_end(self._let_go)
        doc.listen(doc.viewer.layers.events.removed, self._layer_removed)
        self.clicked.connect(self._note_choice)
        self.toggled.connect(self.later)

    @property
    def mesh(self) -> Mesh | None:
        return None if self._layers is None else self._layers.mesh

    def suit(self, shape: tuple[int, ...], size: tuple[float, ...]) -> None:
        """Switch it on for images that are fast to preview, else off, unless the user chose."""
        if not self._user_chose:
            factors = coarsening(shape, size)
            coarse = np.prod(np.ceil(np.divide(shape, factors)))
            self.setChecked(self._preferred and bool(coarse <= SMALL))

    def prefer(self, on: bool) -> None:
        """Set whether it is on at first."""
        self._preferred = on
        if not on and not self._user_chose:
            self.setChecked(False)

    def later(self) -> None:
        """Compute it again after points may have changed, once they no longer change."""
        wanted = self._wanted() if self.isChecked() else None
        if wanted is None:
            self.clear()
        elif wanted.key() != self._key:
            self._key = wanted.key()
            self.background.soon(partial(self._ask, wanted), WAIT)

    def clear(self) -> None:
        """Show no surfaces until the points change."""
        self.background.drop()
        self._key = None
        self._take_away()
        self._set_problems(())

    def _let_go(self) -> None:
        """Close down, as the window is closed."""
        if self._layers is not None:  # which stay, as the window may be gone
            self._layers.close()
        self._layers = None

    def _ask(self, asked: Wanted) -> None:
        work = partial(_found, asked.points, asked.read, asked.frame)
        self.background.ask(work, partial(self._show, asked))
        self.changed.emit()

    def _show(self, asked: Wanted, found: Found) -> None:
        shown, of = self._layers, asked.layer
        if found.mesh is None or of not in self._viewer.layers:
            self._take_away()
        else:
            if shown is None or shown.frame != asked.frame or shown.image_layer is not of:
                self._take_away()
                shown = self._layers = StartLayers(self._viewer, of, asked.frame)
            shown.show(found.mesh)
        self._set_problems(found.problems)

    def _take_away(self) -> None:
        shown, self._layers = self._layers, None
        if shown is not None:
            shown.remove()

    def _fail(self, message: str) -> None:
        self._take_away()
        self._set_problems(((f"no preview: {message}", ()),))

    def _set_problems(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        self.changed.emit()

    def _note_choice(self, checked: bool) -> None:
        self._user_chose = True

    def _layer_removed(self, event: Any) -> None:
        """Take all away where one of the layers goes; if by the user, do not show them again."""
        shown = self._layers
        if shown is None or event.value not in (*shown.made(), shown.image_layer):
            return
        self._take_away()
        self.changed.emit()
        if event.value is not shown.image_layer:
            self._user_chose = True
            self.setChecked(False)


def _found(points: FloatArray, read: Callable[[], NDArray[Any]], frame: Frame) -> Found:
    """Find the starting surfaces of points; runs in a thread."""
    image = read()
    return find(points, image, frame.grid(image.shape))


class StartLayers(MeshLayers):
    """Two layers of the plugin's own that show where a fit of an image would start."""

    names = ("start", "start contours")
    low = True
    known: ClassVar[Mapping[str, Any]] = {**MADE_BY_FIT, PREVIEW: True}
    surface_options: ClassVar[Mapping[str, Any]] = {
        "opacity": 0.5,
        "blending": "translucent_no_depth",
    }

    def show(self, mesh: Mesh) -> None:
        """Show surfaces, um in the frame."""
        self.take_time()
        self.mesh = mesh
        self.draw(mesh)
