"""The fields of the second view: its layer, and the widths of its PSF."""

from __future__ import annotations

from typing import Any

from qtpy.QtWidgets import QFormLayout, QWidget

from ...errors import InputError
from ...scene.effects import ViewEffect, kind_of
from ..document import Document
from ..fields import TripleField
from ..viewing.listening import Connections
from ..widgets import LayerChooser, Note, column, show_row


class SecondViewFields(QWidget):
    """Shows the second view of the document, and lets the user choose it."""

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.source = doc.second
        self.chooser = LayerChooser(doc.second, self)
        helped = kind_of(ViewEffect).help
        self.chooser.setToolTip(f"<qt>{helped[0].upper()}{helped[1:]}.</qt>")
        self.sigma = TripleField(
            "Standard deviations of the second view's PSF, um: known, or measured on a bead. "
            "They are held during a fit.",
            self,
        )
        self.note = Note(self, wrong=True)
        self._form = QFormLayout()
        self._form.setContentsMargins(0, 0, 0, 0)
        self._form.addRow("second view", self.chooser)
        self._form.addRow("its PSF, um", self.sigma)
        column(self._form, self.note, of=self)  # a form would cut a text of several lines
        self._of_layers = Connections()  # where the two layers lie
        doc.second.shown.connect(self._show)
        doc.at_end(self._of_layers.undo)
        self.sigma.edited.connect(self._sized)
        self._show()

    def _sized(self) -> None:
        self.source.resize(self.sigma.value())

    def _show(self) -> None:
        self._of_layers.undo()
        for layer in self.source.both():
            for moved in (layer.events.scale, layer.events.translate):
                self._of_layers.connect(moved, self._check)
        self.sigma.set_value(self.source.sigma)
        show_row(self._form, self.sigma, self.source.layer is not None)
        self._check()

    def _check(self, event: Any = None) -> None:
        """Say what is wrong with the layer, if anything."""
        try:
            self.source.view()
        except InputError as error:
            self.note.say(str(error))
        else:
            self.note.say("")
