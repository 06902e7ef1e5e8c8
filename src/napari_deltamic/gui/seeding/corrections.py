"""Labels corrected by clicks in the viewer: the clicks become edits in a thread, one at a time."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from napari.layers import Labels
from numpy.typing import NDArray
from qtpy.QtCore import QObject
from qtpy.QtWidgets import QWidget

from ...errors import InputError
from ...geometry import Click, read_clicks_csv, write_clicks_csv
from ...geometry.labels.label_edits import Action, Corrector
from ...runs.seeds import LabelSeeds
from ..attempt import attempt
from ..document import Document
from ..layer_choice import Connections
from ..qt import Signal
from ..viewing.frame import FloatArray, Frame
from ..work import Background
from .correct_bar import CorrectBar, Tool
from .label_clicks import Before, can_undo, clicks_of, note, put, undo
from .seed_kinds import seeds_from_layer

_STILL = 5.0  # px: a mouse that moves further drags
_UNDO = "Control-Z"
_ACTIONS: dict[Tool, Action] = {"split": "cell", "merge": "merge", "remove": "remove"}
_BESIDE = "In 3D, click on a cell; what was missed is added on the slices."


@dataclass(frozen=True, eq=False)
class _Wanted:
    """Clicks that are to be made, in one step that can be undone."""

    layer: Any  # that is corrected
    clicks: Sequence[Click]
    from_file: bool = False


class Corrections(QObject):
    """Corrects one of the Labels layers that are ticked: the active one, else the highest.

    Parameters
    ----------
    doc : the document.
    layers : gives the layers that are ticked as seeds.
    parent : Qt's, of the bar.
    """

    edited = Signal()  # labels were changed

    def __init__(
        self,
        doc: Document,
        layers: Callable[[], list[Any]],
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self._doc, self._viewer, self._image, self._layers = doc, doc.viewer, doc.image, layers
        self.bar = bar = CorrectBar(parent)
        self._first: Click | None = None  # of the two that are to be merged
        self._waiting: list[_Wanted] = []
        # What is under way: the array of the layer, its labels, and what is to be done.
        self._asked: tuple[Any, NDArray[np.int32], _Wanted] | None = None
        self._corrector: Corrector | None = None
        self._corrector_of: tuple[Any, ...] = ()
        self._corrector_data: Any = None
        self._bound: Any = None  # the layer that takes Ctrl+Z
        self._background = Background(self._show, self._fail)
        self._callback = self._pressed  # one object, so that it can be taken out again
        self._connections = Connections()
        self._connections.connect(doc.viewer.dims.events.ndisplay, self._view_changed)
        bar.tool_chosen.connect(self._tool_chosen)
        bar.undo.connect(self.undo)
        bar.load.connect(self._load)
        bar.save.connect(self._save)
        self._view_changed()

    @property
    def layer(self) -> Any:
        """The layer that clicks correct, or None."""
        layers = [x for x in self._layers() if _can_be_corrected(x)]
        active = self._viewer.layers.selection.active
        return active if active in layers else layers[-1] if layers else None

    @property
    def busy(self) -> bool:
        """Whether clicks are still to be made."""
        return bool(self._waiting) or self._background.busy

    def lay_down(self) -> None:
        """Clicks move the view again."""
        self.bar.use(None)

    def renew(self) -> None:
        """Look at the layers again: other ones may be ticked, or labels painted."""
        layer = self.layer
        self.bar.setVisible(layer is not None)
        if layer is None:
            self.lay_down()
            return
        if self.bar.tool is not None and layer is not self._bound:
            self._listen(layer)
            self.bar.explain()
        cells, waits = _cells(np.asarray(layer.data)), self._first is not None
        self.bar.show_count(cells, len(clicks_of(layer)), can_undo=waits or can_undo(layer))

    def click(self, place: FloatArray) -> None:
        """Use the tool at a place, um in the image's frame."""
        tool, layer = self.bar.tool, self.layer
        if tool is None or layer is None:
            return
        if layer is not self._bound:  # another one was selected
            self._listen(layer)
        z, y, x = (float(p) for p in place)
        click = Click((z, y, x), _ACTIONS[tool])
        if tool != "merge":
            self._want(_Wanted(layer, [click]))
        elif self._first is None:
            self._first = click
            self.bar.say("Click the other half of this cell to merge them.")
            self.renew()
        else:
            first, self._first = self._first, None
            self._want(_Wanted(layer, [first, click]))

    def undo(self, layer: Any = None) -> None:
        """Undo the last correction, or the first click of two."""
        target = self.layer
        if self.busy or target is None:
            return
        if self._first is not None:
            self._first = None
        elif can_undo(target):
            undo(target)
            self.edited.emit()
        self.bar.explain()
        self.renew()

    def load(self, path: str) -> None:
        """Make the clicks of a file. InputError if it cannot be read."""
        self._want(_Wanted(self.layer, read_clicks_csv(path), from_file=True))

    def save(self, path: str) -> None:
        """Save the clicks that were made. InputError if there are none, or they cannot be saved."""
        layer = self.layer
        clicks = [] if layer is None else clicks_of(layer)
        if not clicks:
            raise InputError("there are no clicks to save")
        write_clicks_csv(path if path.lower().endswith(".csv") else f"{path}.csv", clicks)
        self.bar.say(f"saved {path}")

    def forget(self) -> None:
        """Another image: what is under way is given up."""
        self._waiting, self._asked, self._corrector, self._first = [], None, None, None
        self._background.drop()
        self.bar.explain()

    def close_links(self) -> None:
        """End what is under way, and let the viewer go."""
        self._connections.undo()
        self._listen(None)
        self._background.close()
        self._waiting, self._asked, self._corrector = [], None, None

    def _load(self, path: str) -> None:
        attempt(partial(self.load, path), self.bar.say)

    def _save(self, path: str) -> None:
        attempt(partial(self.save, path), self.bar.say)

    # ------------------------------------------------------------------------------------ mouse

    def _tool_chosen(self, tool: Tool | None) -> None:
        layer = self.layer if tool is not None else None
        self._listen(layer)
        if layer is not None:
            self._doc.finish_tools.emit(self)
            for other in self._viewer.layers:  # points that are placed, labels that are painted
                if str(getattr(other, "mode", "pan_zoom")) != "pan_zoom":
                    other.mode = "pan_zoom"
            layer.visible = True
            self._viewer.layers.selection = {layer}
        self.renew()

    def _listen(self, layer: Any) -> None:
        """To the mouse, and to Ctrl+Z on a layer; to nothing for None."""
        self._first = None  # two clicks merge cells of one layer
        callbacks = self._viewer.mouse_drag_callbacks
        if self._callback in callbacks:
            callbacks.remove(self._callback)
        if self._bound is not None:
            self._bound.bind_key(_UNDO, None, overwrite=True)
        self._bound = layer
        if layer is not None:
            callbacks.append(self._callback)
            layer.bind_key(_UNDO, self.undo, overwrite=True)

    def _view_changed(self, event: Any = None) -> None:
        self.bar.show_dimensions(self._viewer.dims.ndisplay)

    def _pressed(self, viewer: Any, event: Any) -> Iterator[None]:
        if event.button != 1 or event.handled or event.modifiers or self.bar.tool is None:
            return
        active = viewer.layers.selection.active
        if str(getattr(active, "mode", "pan_zoom")) != "pan_zoom":
            self.lay_down()  # the layer's own tool was taken up
            return
        start = np.asarray(event.pos, float)
        yield
        while event.type == "mouse_move":
            if np.abs(np.asarray(event.pos, float) - start).max() > _STILL:
                return  # the view is moved
            yield
        attempt(partial(self._clicked, event), self.bar.say)

    def _clicked(self, event: Any) -> None:
        layer = self.layer
        if layer is None or self._image.layer is None:
            return
        frame = self._image.under(layer)[0]
        if len(event.dims_displayed) == 3:
            place = middle_on_ray(layer, event, frame)
            if place is None:
                self.bar.say(_BESIDE)
                return
        else:
            place = frame.to_um(np.asarray(event.position, float)[-3:])
        voxel = np.floor(place / frame.voxel_size + 0.5)
        if ((voxel >= 0) & (voxel < layer.data.shape)).all():  # else it was beside the image
            self.click(place)

    # --------------------------------------------------------------------------------- the work

    def _want(self, wanted: _Wanted) -> None:
        self._waiting.append(wanted)
        if not self._background.busy:
            self._next()

    def _next(self) -> None:
        """Make what waits longest; what cannot be done is told."""
        while self._waiting and not self._background.busy:
            wanted = self._waiting.pop(0)
            try:
                self._start(wanted)
            except InputError as error:
                self._waiting = []
                self.bar.say(str(error))

    def _start(self, wanted: _Wanted) -> None:
        layer = wanted.layer
        if layer is None or layer not in self._layers() or self._image.layer is None:
            raise InputError("tick the Labels layer that is to be corrected")
        frame, read = self._image.under(layer)
        seeds = seeds_from_layer(layer, frame, (), spheres=False)
        assert isinstance(seeds, LabelSeeds)
        made = clicks_of(layer)
        step = made[-1].step + 1 if made else 0
        clicks = [replace(click, step=click.step + step) for click in wanted.clicks]
        work = partial(self._corrector_for(frame, read, layer.data).corrected, seeds.labels, clicks)
        self._asked = (layer.data, seeds.labels, replace(wanted, clicks=clicks))
        self.bar.say("working ...")
        self._background.ask(work)

    def _corrector_for(
        self, frame: Frame, read: Callable[[], NDArray[Any]], data: Any
    ) -> Corrector:
        step = tuple(self._viewer.dims.current_step[:-3])
        of = (self._image.layer, frame, step)
        # Cells that were found anew have another size; clicks change an array in place.
        anew = data is not self._corrector_data
        if self._corrector is None or anew or of != self._corrector_of:
            self._corrector, self._corrector_of = Corrector(read(), frame.voxel_size), of
            self._corrector_data = data
        return self._corrector

    def _show(self, labels: NDArray[np.int32]) -> None:
        if self._asked is None:
            return
        (data, before, wanted), self._asked = self._asked, None
        layer = wanted.layer
        self.bar.explain()
        if layer in self._viewer.layers and layer.data is data:  # not replaced meanwhile
            places = np.flatnonzero(labels != before)
            old = put(layer, places, labels.ravel()[places].astype(np.int64))
            note(layer, wanted.clicks, Before(len(wanted.clicks), places, old))
            self.edited.emit()
        self.renew()
        self._next()

    def _fail(self, message: str) -> None:
        asked, self._asked = self._asked, None
        plain = asked is not None and not asked[2].from_file
        self.bar.say(_without_numbers(message) if plain else message)
        self.renew()
        self._next()


def _can_be_corrected(layer: Any) -> bool:
    return isinstance(layer, Labels) and layer.ndim == 3 and not layer.multiscale


def _cells(labels: NDArray[Any]) -> int:
    """How many labels there are, however large their numbers."""
    if labels.max(initial=0) > labels.size:
        return int((np.unique(labels) > 0).sum())
    # Which is faster, but takes memory by the largest number.
    return int((np.bincount(labels.ravel().clip(0).astype(np.intp))[1:] > 0).sum())


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
    middle: FloatArray = points[(first + last) // 2] * scale + shift
    return middle


def _without_numbers(message: str) -> str:
    """Of a click that was only just made, the user needs no number."""
    both = re.sub(r"clicks \d+ and \d+", "both clicks", message)
    return re.sub(r"click \d+", "that click", both)
