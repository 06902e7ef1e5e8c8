"""Cells found without a click: a Labels layer that can be corrected, and becomes the seeds."""

from __future__ import annotations

import re
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from napari.layers import Labels
from numpy.typing import NDArray
from qtpy.QtWidgets import QPushButton, QWidget
from superqt.utils import signals_blocked

from ...common.triple import geometric_mean, triple
from ...common.words import counted, sentence
from ...errors import InputError
from ...evidence.tilted_ground import with_ground
from ...fitting.job import levelled
from ...runs.seed_checks import voxels_of
from ...runs.settings import SceneSettings
from ...scene import Grid
from ..document import Document
from ..layer_channels import of_one_stack
from ..viewing.colours import label_colormap
from ..viewing.frame import FOUND, OWN, Frame
from ..viewing.listening import reference
from ..widgets import Signal, slider

NAME = "found cells"
_OTHERS = 3  # sizes that are offered besides the one used, at most
_ALL = (slice(None),) * 3
_SAME = 0.1  # by which two sizes differ that are the same


@dataclass(eq=False)
class _Found:
    """What was found in an image.

    image : a weak reference to its layer.
    layer : of the labels.
    count : how many cells there are, in words.
    size : how large they are, in words; '' once they were edited.
    others : sizes that they may have instead, with how many would be found, about; 0: not known.
    voxel_size : that the image had, um.
    pixels : gives the voxels that it had, as long as they are there.
    ticked, visible : whether the labels were, when another image was chosen.
    """

    image: weakref.ref[Any]
    layer: Any
    count: str
    size: str
    others: Sequence[tuple[float, int]]
    voxel_size: tuple[float, ...]
    pixels: Callable[[], Any]
    ticked: bool = True
    visible: bool = True

    def of_size(self, voxel_size: tuple[float, ...]) -> bool:
        """Whether the voxel size is still the one with which the cells were found."""
        return bool(np.allclose(self.voxel_size, voxel_size, rtol=1e-3, atol=0))

    @property
    def of_other_pixels(self) -> bool:
        """Whether the image's pixels have been replaced since."""
        image = self.image()
        return image is not None and self.pixels() is not image.data

    def told(self, voxel_size: tuple[float, ...]) -> str:
        """The message on the found cells."""
        if not self.size:
            return f"{self.count}."
        if self.of_other_pixels:
            return f"Found {self.count}, in other pixels than the image has now."
        if not self.of_size(voxel_size):
            return f"Found {self.count}, with another voxel size."
        return f"Found {self.count} of about {self.size}."

    def note(self) -> None:
        """Store the facts in the layer's metadata, for a window opened later, and for sessions."""
        image = self.image()
        self.layer.metadata.setdefault(OWN, {})[FOUND] = {
            "image": "" if image is None else str(image.unique_id),
            "count": self.count,
            "size": self.size,
            "others": [[float(size), int(n)] for size, n in self.others],
            "voxel_size": [float(d) for d in self.voxel_size],
        }

    @classmethod
    def noted(cls, layer: Any, layers: Sequence[Any]) -> _Found | None:
        """What a layer's metadata store, if its image is one of some layers; else None."""
        own = layer.metadata.get(OWN, {}) if isinstance(layer, Labels) else {}
        noted: Any = own.get(FOUND)
        try:
            of = next(one for one in layers if str(one.unique_id) == noted["image"])
            others = [(float(size), int(n)) for size, n in noted["others"]]
            size = triple(float(d) for d in noted["voxel_size"])
            words = str(noted["count"]), str(noted["size"])
        except (StopIteration, KeyError, TypeError, ValueError):
            return None  # it was not found here, or someone has edited what is noted
        return cls(weakref.ref(of), layer, *words, others, size, reference(of.data))


def be_found_in(layer: Any, image: Any) -> None:
    """Link found cells that were saved with their image to the image's layer."""
    noted = layer.metadata.get(OWN, {}).get(FOUND)
    if isinstance(noted, dict):
        noted["image"] = str(image.unique_id)


class FindCells(QPushButton):
    """The button, its slider, and what they find; ``told`` says that ``message`` is another."""

    told = Signal()

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__("Find cells", parent)
        self._viewer, self._image, self._cells = doc.viewer, doc.image, doc.cells
        self.setToolTip(
            "<qt>Finds the cells of a membrane image by itself and adds them as a Labels layer, "
            "which can be corrected by clicks, or with napari's brush, eraser and bucket. Takes "
            "seconds to minutes in the background, depending on the size of the image. Pressing "
            "again starts over and replaces what was found in this image; undo (↶) brings that "
            "back, with your corrections.</qt>"
        )
        tip = (
            "Diameter of a typical cell. Until you move the slider, it is estimated from the "
            "image. Larger: fewer cells; smaller: more. Then press 'Find cells' again."
        )
        self.cell_size = slider(tip, parent)
        self._said = ""  # why nothing was found, or what goes on
        self._told = ""  # the message as it was told last
        self._sizes: list[tuple[float, int]] = []
        self._moved = False
        self._found: WeakKeyDictionary[Any, _Found] = WeakKeyDictionary()  # by image layer
        self._looked_in: Callable[[], Any] | None = None  # the voxels that are looked through
        self._in_use: _Found | None = None  # of the image, or of another channel of its stack
        self.background = doc.background(self._refuse)
        doc.listen(doc.viewer.layers.events.removed, self._layers_changed)
        # After its tick: new layers have one.
        doc.listen(doc.viewer.layers.events.inserted, self._layer_added, position="last")
        doc.image.looked.connect(self._look_again)
        self.clicked.connect(self.start)
        self.cell_size.valueChanged.connect(self._note_move)
        for layer in doc.viewer.layers:  # found in a window that was closed
            self._adopt(layer)

    @property
    def message(self) -> str:
        """What goes on, or what was found in the image; '' for nothing."""
        found, frame = self._in_use, self._image.known_frame
        if self._said or found is None:
            return self._said
        return found.told(found.voxel_size if frame is None else frame.voxel_size)

    @property
    def others(self) -> Sequence[tuple[float, int]]:
        """Other sizes that are offered: they would be looked for in the image as it is now."""
        found, frame = self._in_use, self._image.known_frame
        if self._said or found is None or frame is None or found.of_other_pixels:
            return ()
        same = found.of_size(frame.voxel_size) and not self._marks(found, self._image.layer)
        return found.others if same else ()

    @property
    def tried(self) -> bool:
        """Whether cells were looked for, or the slider moved, so that showing it is of use."""
        return self._moved or bool(self.message)

    def start(self) -> None:
        """Look for cells in the chosen image; a search under way is given up."""
        try:
            frame, read = self._image.frame(), self._image.reader()
        except InputError as error:
            self._refuse(str(error))
            return
        size = float(self.cell_size.value()) if self._moved else None
        self._looked_in = reference(self._image.layer.data)
        then = partial(self._show, self._image.layer, frame, size)
        self.background.ask(partial(look, read, frame.voxel_size, size), then)
        self._tell("Looking for cells ...")

    def suit(
        self, shape: tuple[int, ...], voxel_size: tuple[float, ...], *, same: bool = False
    ) -> None:
        """Adapt to another image: what was asked of, or found in, the last one is put away.

        Unless it is another channel of the same stack: nuclei that were found mark its cells.

        same : it is only another region of the image.
        """
        self.forget()
        self._use_those_of(self._image.layer)
        self._tell()
        sides = np.multiply(shape, voxel_size)
        least = 4 * geometric_mean(voxel_size)  # less is refused
        if same:
            size = float(self.cell_size.value())
            self._set_size(size, least, max(float(sides.max()), size))
            self._sizes = []
            return
        self._set_size(float(sides.min()) / 3, least, float(sides.max()))
        self._moved, self._sizes = False, []

    def forget(self) -> None:
        """Give up a search, and clear the reason for a failed one, as the image has changed."""
        if self._said:
            self.background.drop()
            self._tell()

    def edited(self, event: Any = None) -> None:
        """Labels were edited: count cells again, and renew colours, as other cells may touch."""
        found = self._in_use
        if found is not None and found.layer in self._viewer.layers:
            labels = found.layer.data
            found.layer.colormap = label_colormap(labels)
            found.count, found.size = counted(len(voxels_of(labels)), "cell"), ""
            found.note()
            self._tell()

    def find_with(self, size: float | str) -> None:
        self._set_size(float(size))
        self._moved = True
        self.start()

    def _show(self, image_layer: Any, frame: Frame, wanted: float | None, result: Any) -> None:
        """Show the cells found in an image; wanted : size that was asked for, um; None for any."""
        size, labels = result.size, result.labels
        if image_layer not in self._viewer.layers:
            self._tell()
            return
        if not self._moved:
            self._set_size(size)
        if wanted is None:
            others = [(one.size, one.cells) for one in result.others[:_OTHERS]]
            self._sizes = [(size, 0), *others]
        before = [one.layer for one in self._found.values()]
        layer = self._layer_for(image_layer, frame, labels)
        others = [(s, k) for s, k in self._sizes if abs(s / size - 1) > _SAME]
        count = counted(len(voxels_of(labels)), "cell")
        of, words = weakref.ref(image_layer), f"{size:.3g} {frame.length}"
        pixels = self._looked_in or reference(image_layer.data)
        found = _Found(of, layer, count, words, others, frame.voxel_size, pixels)
        self._found[image_layer] = self._in_use = found
        found.note()
        self._tell()
        for other in before:  # of another region, or channel
            if other is not layer:
                self._cells.choose(other, ticked=False)
                other.visible = False
        self._cells.choose(layer)

    def _use_those_of(self, image: Any) -> None:
        """Tick and show what was found in an image; untick and hide what was found in another."""
        old, new = self._in_use, self._found.get(image)
        if old is not None and new is None and self._marks(old, image):
            new = old
        if old is new:
            return
        if old is not None:
            old.ticked, old.visible = old.layer in self._cells.ticked, bool(old.layer.visible)
            self._cells.choose(old.layer, ticked=False)
            old.layer.visible = False
        self._in_use = new
        if new is not None:
            self._cells.choose(new.layer, new.ticked)
            new.layer.visible = new.visible

    def _marks(self, found: _Found, image: Any) -> bool:
        """Whether cells were found in another channel of the same stack as an image."""
        there = found.image()
        return there is not None and there is not image and of_one_stack(there, image)

    def _look_again(self) -> None:
        """Tell the message anew if it has changed, as the image's pixels may have been replaced."""
        if self.message != self._told:
            self._tell(self._said)

    def _layer_for(self, image: Any, frame: Frame, labels: NDArray[np.int32]) -> Any:
        """The layer of the last search in this image if it still lies on it, else a new one."""
        known, options = self._found.get(image), frame.image_options()
        old = None if known is None else known.layer
        if (
            old is not None
            and old in self._viewer.layers
            and old.data.shape == labels.shape
            and np.allclose(old.scale, options["scale"])
            and np.allclose(old.translate, options["translate"])
        ):
            _replace(old, labels)
            old.colormap = label_colormap(labels)
            old.visible = True
            return old
        name = f"{image.name}: {NAME}" if NAME in self._viewer.layers else NAME
        layer = Labels(labels, name=name, opacity=0.4, **options)
        layer.colormap = label_colormap(labels)
        layer.events.paint.connect(self.edited)
        self._viewer.add_layer(layer)
        return layer

    def _layer_added(self, event: Any) -> None:
        """Take up a layer that was added, perhaps by a session, if it holds found cells."""
        found = self._adopt(event.value)
        if found is not None and found.image() is self._image.layer:
            self._in_use = found
            self._cells.choose(found.layer)
            self._tell()

    def _adopt(self, layer: Any) -> _Found | None:
        """Take a layer as the cells found in its image if it says so, and there is no other."""
        found = _Found.noted(layer, self._viewer.layers)
        image = None if found is None else found.image()
        if found is None or image is None or image in self._found:
            return None
        self._found[image] = found
        layer.events.paint.connect(self.edited)
        if image is self._image.layer:
            found.visible = bool(layer.visible)
        self._cells.choose(layer, ticked=False)  # that of the image chosen is ticked when it is
        return found

    def _layers_changed(self, event: Any = None) -> None:
        """Forget what was found once its layer is removed."""
        for image in [image for image, one in self._found.items() if one.layer is event.value]:
            del self._found[image]
        if self._in_use is not None and self._in_use.layer is event.value:
            self._in_use = None
            self._tell()

    def _refuse(self, reason: str) -> None:
        frame = self._image.known_frame
        if frame is not None and frame.length == "voxels":
            reason = re.sub(r"\bum\b", "voxels", reason)
        self._tell(sentence(reason))

    def _tell(self, said: str = "") -> None:
        """Tell the message: what is said, or else what was found."""
        self._said = said
        self._told = self.message
        in_use = self._in_use
        self._cells.wait_for(self.background.busy, None if in_use is None else in_use.layer)
        self.told.emit()

    def _note_move(self, value: float) -> None:
        self._moved = True

    def _set_size(self, size: float, *limits: float) -> None:
        with signals_blocked(self.cell_size):
            if limits:
                self.cell_size.setRange(*limits)
            self.cell_size.setValue(size)


def _replace(layer: Any, labels: NDArray[np.int32]) -> None:
    """Give a layer other labels, so that undo brings the earlier ones back.

    By private names: napari has no public way to a step of a whole array.
    """
    before, steps = layer.data, list(layer._undo_history)
    layer.data = labels
    layer._reset_history()
    if not isinstance(before, np.ndarray) or before.dtype != labels.dtype:
        return
    # A step holds two arrays: no more than one of that kind.
    whole = [k for k, step in enumerate(steps) if isinstance(step[0], tuple) and step[0][0] is _ALL]
    layer._undo_history.extend(steps[whole[-1] + 1 :] if whole else steps)
    layer._undo_history.append([(_ALL, _in_few_bytes(before), _in_few_bytes(labels))])


def _in_few_bytes(labels: NDArray[np.int32]) -> NDArray[Any]:
    """A copy in the smallest type of integers that holds all labels."""
    low, high = int(labels.min(initial=0)), int(labels.max(initial=0))
    return labels.astype(np.result_type(np.min_scalar_type(low), np.min_scalar_type(high)))


def look(
    read: Callable[[], NDArray[Any]], voxel_size: tuple[float, float, float], size: float | None
) -> Any:
    """``CellsFound`` in the image that is read, of a size (um; None: estimated)."""
    # Imported when it is first needed, and in the thread, as that takes a while.
    from ...geometry.labels.bright_cells import cells_of

    image = read()
    if min(image.shape) == 1:
        voxels = " x ".join(map(str, image.shape))
        raise InputError(
            f"the image has {voxels} voxels, and cells are found in stacks of several slices: "
            "open the whole stack"
        )
    scene, _ = with_ground(SceneSettings(voxel_size=voxel_size), image)
    shape: Any = image.shape
    level = levelled(image, Grid(shape, voxel_size), scene.effects)
    return cells_of(level, voxel_size, size)
