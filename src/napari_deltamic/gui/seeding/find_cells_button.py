"""Cells found without a click: a Labels layer that can be corrected, and is then the seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from napari.layers import Labels
from numpy.typing import NDArray
from qtpy.QtWidgets import QPushButton, QWidget
from superqt.utils import signals_blocked

from ...common.words import counted
from ...errors import InputError
from ...evidence.tilted_ground import with_ground
from ...fitting.job import levelled
from ...runs.seed_checks import voxels_of
from ...runs.settings import SceneSettings
from ...scene import Grid
from ..document import Document
from ..layer_channels import of_one_stack
from ..viewing.colours import label_colormap
from ..viewing.frame import Frame
from ..widgets import Signal, sentence, slider

NAME = "found cells"
_OTHERS = 3  # sizes that are offered besides the one used, at most
_SAME = 0.1  # by which two sizes differ that are the same


class FindCells(QPushButton):
    """The button, its slider, and what they find; ``told`` says that ``message`` is another."""

    told = Signal()

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__("Find cells", parent)
        self._viewer, self._image, self._cells = doc.viewer, doc.image, doc.cells
        self.setToolTip(
            "<qt>Finds the cells of a membrane image by itself and adds them as a Labels layer, "
            "which can be corrected by clicks, or with napari's brush, eraser and bucket. Takes "
            "seconds to minutes in the background, by the size of the image. Pressing again starts "
            "over and replaces what was found, your corrections included.</qt>"
        )
        tip = (
            "Diameter of a typical cell, um. Until you move it, it is estimated from the image. "
            "Larger: fewer cells, smaller: more. Press 'Find cells' again after that."
        )
        self.cell_size = slider(tip, parent)
        self.message = ""
        # Sizes that the cells may have instead, with how many would be found, about; 0: not known.
        self.others: Sequence[tuple[float, int]] = ()
        self._sizes: list[tuple[float, int]] = []
        self._moved = self._refused = False
        self._layer: Any = None
        self._found_in: Any = None  # the image layer that the message and the labels are of
        self.background = doc.background(self._refuse)
        doc.listen(doc.viewer.layers.events.removed, self._layers_changed)
        self.clicked.connect(self.start)
        self.cell_size.valueChanged.connect(self._note_move)

    @property
    def tried(self) -> bool:
        """Whether its slider is of use yet."""
        return self._moved or bool(self.message)

    def start(self) -> None:
        """Look for cells in the image chosen; what is under way is given up."""
        try:
            frame, read = self._image.frame(), self._image.reader()
        except InputError as error:
            self._refuse(str(error))
            return
        size = float(self.cell_size.value()) if self._moved else None
        then = partial(self._show, self._image.layer, frame, size)
        self.background.ask(partial(look, read, frame.voxel_size, size), then)
        self._tell("Looking for cells ...")

    def suit(
        self, shape: tuple[int, ...], voxel_size: tuple[float, ...], *, same: bool = False
    ) -> None:
        """Another image: what was asked of the last one, and found in it, is of no use.

        Unless it is another channel of the same stack: nuclei that were found mark its cells.

        same : it is only another region of the image.
        """
        self.forget()
        before, now = self._found_in, self._image.layer
        if before is not None and before is not now:
            marks = of_one_stack(before, now)
            self._found_in = before if marks else None
            self._tell(self.message if marks else "")  # other sizes would be looked for here
            if self._layer is not None and not marks:
                self._cells.choose(self._layer, ticked=False)
        sides = np.multiply(shape, voxel_size)
        least = 4 * float(np.cbrt(np.prod(voxel_size)))  # less is refused
        if same:
            size = float(self.cell_size.value())
            self._set_size(size, least, max(float(sides.max()), size))
            self._sizes = []
            return
        self._set_size(float(sides.min()) / 3, least, float(sides.max()))
        self._moved, self._sizes = False, []

    def forget(self) -> None:
        """Give up what is under way, and why nothing came of it: the image is not what it was."""
        if self.background.busy or self._refused:
            self.background.drop()
            self._tell("")

    def edited(self, event: Any = None) -> None:
        """Labels were edited: cells that touch now differ too, and there may be more or fewer."""
        layer = self._layer
        if layer is not None and layer in self._viewer.layers:
            layer.colormap = label_colormap(layer.data)
            self._tell(f"{counted(len(voxels_of(layer.data)), 'cell')}.", self.others)

    def find_with(self, size: float | str) -> None:
        self._set_size(float(size))
        self._moved = True
        self.start()

    def _show(self, image_layer: Any, frame: Frame, wanted: float | None, result: Any) -> None:
        """The cells found in an image; wanted: of which size (um), None for any."""
        size, labels = result.size, result.labels
        if image_layer not in self._viewer.layers:
            self._tell("")
            return
        if not self._moved:
            self._set_size(size)
        if wanted is None:
            others = [(one.size, one.cells) for one in result.others[:_OTHERS]]
            self._sizes = [(size, 0), *others]
        layer, self._found_in = self._layer_for(frame, labels), image_layer
        others = [(s, k) for s, k in self._sizes if abs(s / size - 1) > _SAME]
        found = counted(len(voxels_of(labels)), "cell")
        self._tell(f"Found {found} of about {size:.3g} {frame.length}.", others)
        self._cells.choose(layer)

    def _layer_for(self, frame: Frame, labels: NDArray[np.int32]) -> Any:
        """The layer of the last time if it still lies on the image, else a new one."""
        old, options = self._layer, frame.image_options()
        if (
            old is not None
            and old in self._viewer.layers
            and old.data.shape == labels.shape
            and np.allclose(old.scale, options["scale"])
            and np.allclose(old.translate, options["translate"])
        ):
            old.data = labels
            old._reset_history()  # a private name: napari keeps steps of the array before
            old.colormap = label_colormap(labels)
            old.visible = True
            return old
        self._layer = Labels(labels, name=NAME, opacity=0.4, **options)
        self._layer.colormap = label_colormap(labels)
        self._layer.events.paint.connect(self.edited)
        self._viewer.add_layer(self._layer)
        return self._layer

    def _layers_changed(self, event: Any = None) -> None:
        """What was found is of no interest once its layer is gone."""
        if event.value is self._layer:
            self._layer = None
            self._tell("")

    def _refuse(self, reason: str) -> None:
        self._tell(sentence(reason))
        self._refused = True

    def _tell(self, message: str, others: Sequence[tuple[float, int]] = ()) -> None:
        self._refused = False
        self.message, self.others = message, others
        self._cells.wait_for(self.background.busy, self._layer)
        self.told.emit()

    def _note_move(self, value: float) -> None:
        self._moved = True

    def _set_size(self, size: float, *limits: float) -> None:
        with signals_blocked(self.cell_size):
            if limits:
                self.cell_size.setRange(*limits)
            self.cell_size.setValue(size)


def look(
    read: Callable[[], NDArray[Any]], voxel_size: tuple[float, float, float], size: float | None
) -> Any:
    """``CellsFound`` in the image that is read, of a size (um; None: estimated)."""
    # Imported when it is first needed, and in the thread, as that takes a while.
    from ...geometry.labels.bright_cells import cells_of

    image = read()
    scene, _ = with_ground(SceneSettings(voxel_size=voxel_size), image)
    shape: Any = image.shape
    level = levelled(image, Grid(shape, voxel_size), scene.effects)
    return cells_of(level, voxel_size, size)
