"""Labels corrected by clicks in the viewer: the clicks become edits in a thread, one at a time."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from typing import Any

import numpy as np
from napari.layers import Labels
from numpy.typing import NDArray
from qtpy.QtCore import QObject
from qtpy.QtWidgets import QWidget

from ...common.triple import triple
from ...common.words import counted, sentence
from ...errors import InputError
from ...geometry import Click
from ...geometry.labels.label_edits import Action, Corrector
from ...runs.seed_checks import voxels_of
from ...runs.seeds import LabelSeeds
from ..cell_source import seeds_from_layer
from ..document import Document
from ..viewing.frame import FloatArray, Frame, chosen_of
from ..viewing.listening import Connections, Presses, is_click, lay_down, wants_clicks
from ..widgets import Note, Signal, ToolBar, button, small
from ..window_words import as_tip, attempt

# Title, what it does, and its name among the edits of labels.
_TOOLS: dict[str, tuple[str, str, Action]] = {
    "split": (
        "Split / add",
        "Click in the middle of a cell: if it is part of a larger label it is split off; if it "
        "was missed it is added.",
        "cell",
    ),
    "merge": ("Merge", "Click both halves of a cell, one after the other, to merge them.", "merge"),
    "remove": ("Remove", "Click on what is not a cell.", "remove"),
}
_UNDO = "Undo the last correction, or stroke of the brush (Ctrl+Z)."
_IN_3D = "Cells that were missed are added on slices only."
# What clicks led to: the labels, and the voxels where they changed.
_Found = tuple[NDArray[np.int32], tuple[NDArray[np.intp], ...]]
_BESIDE = "In 3D, click on a cell; what was missed is added on the slices."


class Corrections(QObject):
    """Corrects one of the ticked Labels layers: the active one, else the highest."""

    edited = Signal()  # labels were changed

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._doc, self._viewer, self._image, self._cells = doc, doc.viewer, doc.image, doc.cells
        self.bar = bar = ToolBar({t: one[:2] for t, one in _TOOLS.items()}, _more, doc, parent)
        self.undo_button, self.count = small(button("↶", "", self.undo, bar)), Note(bar)
        bar.row.addWidget(self.undo_button)
        bar.column.addWidget(self.count)
        self._first: Click | None = None  # of the two that are to be merged
        self._waiting: list[tuple[Any, list[Click]]] = []  # layers, and what is to be done there
        self._corrector: Callable[[], Corrector] | None = None
        self._corrector_of: tuple[Any, ...] = ()
        self._corrected: Any = None  # the array of the labels
        self._of_layer = Connections()
        self._listened_to: Any = None  # the layer whose steps can be undone
        self._clicked_in: Any = None  # the layer whose cells the tool corrects
        self._background = doc.background(self._fail)
        self._presses = Presses(doc.viewer, self._pressed)
        doc.at_end(partial(self._listen, None), self._of_layer.undo)
        bar.tool_chosen.connect(self._tool_chosen)

    @property
    def layer(self) -> Any:
        found = [x for x in self._cells.ticked if isinstance(x, Labels) and x.ndim == 3]
        return chosen_of(self._viewer, [x for x in found if not x.multiscale])

    @property
    def busy(self) -> bool:
        return bool(self._waiting) or self._background.busy

    def renew(self) -> None:
        """Look at the layers again, as others may be ticked, or labels painted."""
        layer = self.layer
        self.bar.setVisible(layer is not None)
        self._follow(layer)
        if layer is None:
            self.bar.use(None)
            return
        if self.bar.tool is not None and layer is not self._clicked_in:
            self._listen(layer)
            self.bar.explain()
        in_use = self.bar.tool is not None
        self.count.say(counted(len(voxels_of(np.asarray(layer.data))), "cell") if in_use else "")

    def _follow(self, layer: Any) -> None:
        """Look whether there is something to undo in a layer, now and whenever that may change."""
        if layer is not self._listened_to:
            self._of_layer.undo()
            self._listened_to = layer
            for name in ("paint", "set_data") if layer is not None else ():
                self._of_layer.connect(getattr(layer.events, name), self._show_undo)
        self._show_undo()

    def _show_undo(self, event: Any = None) -> None:
        # A private name: where napari has none, nobody knows.
        steps = getattr(self._listened_to, "_undo_history", True)
        able = self._listened_to is not None and bool(steps or self._first)
        self.undo_button.setEnabled(able)
        self.undo_button.setToolTip(as_tip(_UNDO if able else "Nothing to undo."))

    def click(self, place: FloatArray) -> None:
        """Use the tool at a place (3,), um in the image's frame."""
        tool, layer = self.bar.tool, self.layer
        if tool is None or layer is None:
            return
        if layer is not self._clicked_in:  # another one was selected
            self._listen(layer)
        click = Click(triple(place), _TOOLS[tool][2])
        if tool == "merge" and self._first is None:
            self._first = click
            self.bar.hint.say("Click the other half of this cell to merge them.")
            self.renew()
            return
        first, self._first = self._first, None
        self._waiting.append((layer, [click] if first is None else [first, click]))
        self._next()

    def undo(self) -> None:
        """Undo what was last done to the labels, by clicks or brush, or the first click of two."""
        layer = self.layer
        if self.busy or layer is None:
            return
        if self._first is not None:
            self._first = None
        else:
            with suppress(IndexError):  # napari's steps may be of an array that was replaced
                layer.undo()
            self.edited.emit()
        self.bar.explain()
        self.renew()

    def forget(self) -> None:
        """Give up what is under way, as another image is chosen."""
        self._waiting, self._corrector, self._first = [], None, None
        self._background.drop()
        self.bar.explain()

    # ------------------------------------------------------------------------------------ mouse

    def _tool_chosen(self, tool: str | None) -> None:
        layer = self.layer if tool is not None else None
        self._listen(layer)
        if layer is not None:
            for other in self._viewer.layers:  # points that are placed, labels that are painted
                lay_down(other)
            layer.visible = True
            self._viewer.layers.selection = {layer}
        self.renew()

    def _listen(self, layer: Any) -> None:
        """Listen to clicks into a layer; for None, stop listening."""
        self._first = None  # two clicks merge cells of one layer
        self._clicked_in = layer
        self._presses.listen(layer is not None)

    def _pressed(self, viewer: Any, event: Any) -> Iterator[None]:
        if event.button != 1 or event.handled or event.modifiers or self.bar.tool is None:
            return
        if wants_clicks(viewer.layers.selection.active):
            self.bar.use(None)  # the layer's own tool was taken up
        elif (yield from is_click(event)):
            attempt(partial(self._clicked, event), self.bar.hint.say)

    def _clicked(self, event: Any) -> None:
        layer = self.layer
        if layer is None or self._image.layer is None:
            return
        frame = self._image.under(layer)[0]
        if len(event.dims_displayed) == 3:
            place = middle_on_ray(layer, event, frame)
            if place is None:
                self.bar.hint.say(_BESIDE)
                return
        else:
            place = frame.place_of(event)
        voxel = np.floor(place / frame.voxel_size + 0.5)
        if ((voxel >= 0) & (voxel < layer.data.shape)).all():  # else it was beside the image
            self.click(place)

    # --------------------------------------------------------------------------------- the work

    def _next(self) -> None:
        """Start the click that has waited longest; errors are told."""
        while self._waiting and not self._background.busy:
            try:
                self._start(*self._waiting.pop(0))
            except InputError as error:
                self._waiting = []
                self.bar.hint.say(sentence(str(error)))

    def _start(self, layer: Any, clicks: list[Click]) -> None:
        if layer not in self._cells.ticked or self._image.layer is None:
            raise InputError("tick the Labels layer that is to be corrected")
        frame, read = self._image.under(layer)
        seeds = seeds_from_layer(layer, frame, (), spheres=False)
        assert isinstance(seeds, LabelSeeds)
        of = (self._image.layer, frame, tuple(self._viewer.dims.current_step[:-3]))
        # Cells that were found anew have another size; clicks change an array in place.
        if self._corrector is None or layer.data is not self._corrected or of != self._corrector_of:
            # In the thread, as to read a large image takes long; once for all clicks.
            self._corrector = cache(lambda: Corrector(read(), frame.voxel_size))
            self._corrector_of, self._corrected = of, layer.data
        work = partial(_corrected, self._corrector, seeds.labels, clicks)
        self.bar.hint.say("working ...")
        self._background.ask(work, partial(self._show, layer, layer.data))

    def _show(self, layer: Any, data: Any, found: _Found) -> None:
        """Put corrected labels into a layer if it still holds the same array."""
        self.bar.explain()
        if layer in self._viewer.layers and layer.data is data:  # not replaced meanwhile
            _put(layer, *found)
            self.edited.emit()
        self.renew()
        self._next()

    def _fail(self, message: str) -> None:
        self.bar.hint.say(sentence(_without_numbers(message)))
        self.renew()
        self._next()


def _corrected(corrector: Callable[[], Corrector], labels: Any, clicks: list[Click]) -> _Found:
    """Apply clicks to labels; runs in a thread."""
    found = corrector().corrected(labels, clicks)
    return found, np.nonzero(found != labels)


def _more(tool: str, ndisplay: int) -> str:
    return _IN_3D if tool == "split" and ndisplay == 3 else ""


def _put(layer: Any, labels: NDArray[np.int32], where: tuple[NDArray[np.intp], ...]) -> None:
    """Set voxels of a layer, so that napari can undo it."""
    data, high = layer.data, int(labels.max(initial=0))
    fits = (
        isinstance(data, np.ndarray) and data.flags.writeable and high <= np.iinfo(data.dtype).max
    )
    if not fits:  # a file, or a kind of number that is too small
        layer.data = np.array(data, np.int32)
    layer.data_setitem(where, labels[where])


def middle_on_ray(layer: Any, event: Any, frame: Frame) -> FloatArray | None:
    """The middle of the first label that the mouse points at in 3D, um; None where there is none.

    That is well inside the cell, where its surface is not.
    """
    near, far = layer.get_ray_intersections(
        np.asarray(event.position)[-3:], np.asarray(event.view_direction)[-3:], [0, 1, 2]
    )
    if near is None:
        return None
    near, far = np.asarray(near, float), np.asarray(far, float)
    n = 2 * int(np.ceil(np.linalg.norm(far - near))) + 2
    points = near + np.linspace(0, 1, n)[:, None] * (far - near)
    index = np.clip(np.floor(points + 0.5).astype(int), 0, np.array(layer.data.shape) - 1)
    values = np.asarray(layer.data)[tuple(index.T)]
    hit = np.flatnonzero(values)
    if not len(hit):
        return None
    first = int(hit[0])
    after = np.flatnonzero(values[first:] != values[first])
    last = first + (int(after[0]) if len(after) else n - first) - 1
    scale, shift = frame.data_to_um(layer)
    return points[(first + last) // 2] * scale + shift


def _without_numbers(message: str) -> str:
    """A message without the numbers of clicks, which were made only just now."""
    both = re.sub(r"clicks \d+ and \d+", "both clicks", message)
    return re.sub(r"click \d+", "that click", both)
