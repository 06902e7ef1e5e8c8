"""The layer that shows the same scene through another PSF, and that PSF's widths."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtWidgets import QFormLayout, QWidget

from ...errors import InputError
from ...fitting.job import SIGMA_IN_VOXELS
from ...scene.effects import ViewEffect, kind_of
from ..document import Document
from ..fields import TripleField
from ..layer_channels import file_of
from ..layer_choice import LayerChoice
from ..qt import Signal
from ..viewing.connections import Connections
from ..viewing.frame import Frame, is_stack, shape_of, voxel_size
from ..widgets import LayerChooser, Note, column, show_row

_VIEW = kind_of(ViewEffect)


class SecondViewFields(QWidget):
    """Choice of a second view; ``edited`` comes from the user.

    Parameters
    ----------
    doc : has the first view, on whose voxels the second has to lie.
    """

    edited = Signal()

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._image = doc.image
        self.choice = LayerChoice(doc.viewer, self._accepts, optional=True)
        self.chooser = LayerChooser(self.choice, self)
        helped = _VIEW.help
        self.chooser.setToolTip(f"<qt>{helped[0].upper()}{helped[1:]}.</qt>")
        self.sigma = TripleField(
            "Standard deviations of the second view's PSF, um: known, or measured on a bead. "
            "They are held during a fit.",
            self,
        )
        self.note = Note(self, wrong=True)
        form = QFormLayout()
        form.setContentsMargins(0, 0, 0, 0)
        form.addRow("second view", self.chooser)
        form.addRow("its PSF, um", self.sigma)
        column(form, self.note, of=self)  # a form would cut a text of several lines
        self._form = form
        self._sigma_given = False
        self._blocked = False
        self._of_layers = Connections()  # where the two layers lie
        self.choice.changed.connect(self._chosen)
        doc.at_end(self._of_layers.undo, self.choice.close_links)
        self.sigma.edited.connect(self._sized)
        doc.image.changed.connect(self._image_changed)
        self._show()

    @property
    def layer(self) -> Any:
        """The layer chosen; None for no second view."""
        return self.choice.layer

    def view(self) -> ViewEffect | None:
        """The effect, or None for no second view.

        Raises
        ------
        InputError
            If the layer does not lie on the voxels of the image.
        """
        layer, image = self.layer, self._image.layer
        if layer is None or image is None:
            return None
        _check_on_voxels(layer, image)
        path, channel = file_of(layer)
        # The file of a second view holds nothing else.
        return _VIEW(sigma=self.sigma.value(), image="" if channel else path)

    def pixels(self) -> NDArray[Any] | None:
        """(Z, Y, X) of the layer, at the time shown; None for no second view."""
        if self.layer is None:
            return None
        pixels: NDArray[Any] = self._image.stack(self.layer)
        return pixels

    def show_view(self, layer: Any, sigma: tuple[float, float, float] | None = None) -> None:
        """Show a choice, without a signal; None for no second view."""
        self._blocked = True
        self.choice.choose(layer)
        if sigma is not None:
            self.sigma.set_value(sigma)
            self._sigma_given = True
        self._blocked = False
        self._show()

    # ----------------------------------------------------------------------------------- inside

    def _accepts(self, layer: Any) -> bool:
        return is_stack(layer) and layer is not self._image.layer

    def _image_changed(self) -> None:
        self.choice.refresh()
        layer = self._image.layer
        if not self._sigma_given and layer is not None:
            self.sigma.set_value([SIGMA_IN_VOXELS * d for d in voxel_size(layer)])
        self._show()

    def _chosen(self) -> None:
        self._show()
        if not self._blocked:
            self.edited.emit()

    def _sized(self) -> None:
        self._sigma_given = True
        self.edited.emit()

    def _show(self) -> None:
        self._of_layers.undo()
        if self.layer is not None and self._image.layer is not None:
            for layer in (self.layer, self._image.layer):
                for moved in (layer.events.scale, layer.events.translate):
                    self._of_layers.connect(moved, self._check)
        self._check()

    def _check(self, event: Any = None) -> None:
        """Say what is wrong with the layer, if anything."""
        show_row(self._form, self.sigma, self.layer is not None)
        try:
            self.view()
        except InputError as error:
            self.note.say(str(error))
        else:
            self.note.say("")


def _check_on_voxels(layer: Any, image: Any) -> None:
    """InputError, with what to do, unless both layers have the same voxels."""
    advice = "register it to the image and resample it on the image's voxels first"
    shape, of_image = shape_of(layer), shape_of(image)
    if shape != of_image:
        mine, theirs = (" x ".join(map(str, s)) for s in (shape, of_image))
        raise InputError(
            f"second view: '{layer.name}' has {mine} voxels, the image {theirs}: {advice}"
        )
    try:
        own, first = Frame.of(layer), Frame.of(image)
    except InputError as error:
        raise InputError(f"second view: {error}: {advice}") from None
    shift = np.abs(first.to_um(own.translate))
    same = np.allclose(own.voxel_size, first.voxel_size, rtol=1e-3)
    if not same or (shift > 0.01 * np.array(first.voxel_size)).any():
        raise InputError(
            f"second view: '{layer.name}' does not lie on the voxels of the image: {advice}, "
            "then give both layers the same scale and translation"
        )
