"""Which image is fitted: layer, channel, region, and how large its voxels are."""

from __future__ import annotations

from typing import Any

from qtpy.QtWidgets import QFormLayout, QGroupBox, QLabel, QWidget

from ..common.words import sentence
from ..errors import InputError
from .document import Document
from .fields import TripleField
from .layer_channels import Choice, channel_axes, channels
from .viewing.frame import data_of, um_per_unit
from .widgets import LayerChooser, Note, button, narrow_box, row

WHOLE, BOX = "whole image", "the rectangle drawn"


class ImagePanel(QGroupBox):
    """Shows the image of the document, and lets another one be chosen."""

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__("1  Image", parent)
        self._doc, self._image = doc, doc.image
        self.chooser = LayerChooser(doc.image, self)
        self.chooser.setToolTip("The 3D image to fit. In 4D, the time point shown.")
        tip = (
            "The channel that shows the membranes. It becomes a layer of its own, which is fitted."
        )
        self.channels = narrow_box(self, "channel", tip)
        tip = (
            "Which part of the image is fitted. To leave out bright objects that are not your "
            "cells, draw a rectangle around the cells in a Shapes layer and choose it here. It "
            "applies to all slices; if you move the rectangle, the region follows."
        )
        self.region = narrow_box(self, "region", tip, (WHOLE, BOX))
        self.voxel_size = TripleField("Voxel size, um. It is the scale of the image layer.", self)
        self.size_line = QLabel(self)
        self.edit_size = button("Edit", "Type another voxel size.", None, self)
        self.edit_size.setCheckable(True)
        self.note = Note(self)
        self._form = layout = QFormLayout(self)
        layout.addRow("layer", self.chooser)
        layout.addRow("channel", self.channels)
        layout.addRow("region", self.region)
        layout.addRow("voxel", row((self.size_line, 1), self.edit_size))
        layout.addRow(self.voxel_size)
        layout.addRow(self.note)
        self._told = "", False  # what is said of the image, and whether the user is needed
        self._choices: list[Choice] = []
        # The fields were opened for the image before.
        doc.image.replaced.connect(lambda: self.edit_size.setChecked(False))
        doc.image.looked.connect(self._show)
        doc.image.changed.connect(self._show)
        doc.image.stayed.connect(lambda why: self._tell(sentence(why), needed=True))
        # Also where it was chosen before, and another one has come over it since.
        for chosen in (self.chooser.currentIndexChanged, self.chooser.activated):
            chosen.connect(lambda row: doc.image.show())
        self.channels.activated.connect(self._take_channel)
        self.region.activated.connect(self._take_region)
        self.voxel_size.edited.connect(doc.image.rescale)
        self.voxel_size.refused.connect(self._refuse_size)
        self.edit_size.toggled.connect(self.voxel_size.setVisible)
        self.voxel_size.hide()
        self._show()

    def _show(self) -> None:
        image = self._image
        layer = image.layer
        for field in (self.voxel_size, self.edit_size, self.region):
            field.setEnabled(layer is not None)
        self.region.setCurrentText(WHOLE if image.box is None else BOX)
        self._offer_channels()
        if layer is None:
            self.size_line.setText("-")
            text = sentence(image.missing())
            if self._image.with_channels() is None:
                text = "Open a 3D image (drag it into napari), or File > Open Sample."
            self._tell(text)
            return
        try:
            size = image.frame().voxel_size
        except InputError as error:
            self._tell(sentence(str(error)), needed=True)
            return
        self.voxel_size.set_value(size)
        units = set(map(str, layer.units[-3:]))
        no_length = um_per_unit(layer) is None and units != {"pixel"}
        unknown = um_per_unit(layer) is None and set(size) == {1.0} and not no_length
        shown = " x ".join(f"{d:.3g}" for d in size) + " µm"
        self.size_line.setText("not known" if unknown else shown)
        if unknown:
            self.edit_size.setChecked(True)
        self._tell(self._described(layer, unknown, no_length), needed=unknown or no_length)

    def _tell(self, text: str, *, needed: bool = False) -> None:
        """Show a text; in the colour of warnings if the user is needed."""
        self._told = text, needed
        self.note.say(text, "fair" if needed else "")

    def _refuse_size(self, why: str) -> None:
        """Say why what was typed is not a voxel size; '' as soon as more is typed."""
        text, needed = (sentence(why), True) if why else self._told
        self.note.say(text, "fair" if needed else "")

    def _described(self, layer: Any, unknown: bool, no_length: bool) -> str:
        text = " x ".join(map(str, self._image.shape())) + " voxels"
        if self._image.box is not None:
            text += " of the image"
        if channel_axes(layer):
            times, planes = data_of(layer).shape[:2]
            text += f", read as {times} times of {planes} planes; if it has channels, choose one"
        if unknown:
            text += "; the voxel size is not known: enter it in µm, or all lengths are in voxels"
        elif no_length:
            units = ", ".join(map(str, layer.units[-3:]))
            text += f"; the units of Z, Y, X ({units}) are not lengths: taken as µm"
        return text

    def _offer_channels(self) -> None:
        """List the channels of the layer, of the layer it was taken from, or of an unusable one."""
        layer = self._image.with_channels()
        self._choices = channels(layer)
        self.channels.clear()
        series = layer is not None and layer is self._image.layer
        self.channels.addItem("none: it is a series in time" if series else "...")
        self.channels.addItems(
            [f"{k + 1} of {n}, {name or f'along axis {a + 1}'}" for a, k, n, name in self._choices]
        )
        taken = self._image.taken_channel
        if taken in self._choices:
            self.channels.setCurrentIndex(self._choices.index(taken) + 1)
        self._form.setRowVisible(self.channels, bool(self._choices))

    def _take_channel(self, index: int) -> None:
        if 0 < index <= len(self._choices):
            self._image.take_channel(self._image.with_channels(), self._choices[index - 1])

    def _take_region(self, index: int) -> None:
        try:
            if self.region.currentText() == BOX:
                self._image.follow_drawn()
            else:
                self._image.take_region(None)
        except InputError as error:
            self._show()
            self._tell(sentence(str(error)), needed=True)
