"""The fields of a PSF: the numbers on an objective, or the image of a bead."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from qtpy.QtWidgets import QFileDialog, QLabel, QSizePolicy, QWidget
from superqt.utils import signals_blocked

from ...common.choices import IMAGE_FILES, ZARR
from ...errors import InputError
from ...images.stacks import read_voxel_size
from ...runs.optics_settings import MeasuredOptics, MicroscopeOptics, optics_from_values
from ..fields import Form
from ..widgets import Signal, button, column
from ..window_words import attempt

_FILES = f"images ({' '.join(f'*{kind}' for kind in IMAGE_FILES if kind != ZARR)})"
_LIT = "modality", ("confocal", "spinning disk")
_LAYERED = "model", ("vectorial", "gibson-lanni")
# What is only shown where another field has one of some choices.
_SHOWN_FOR = {
    "excitation": _LIT,
    "pinhole": _LIT,
    "sheet": ("modality", ("light sheet",)),
    "sample_index": _LAYERED,
    "depth": _LAYERED,
}


class ObjectiveFields(Form):
    """Fields of :class:`MicroscopeOptics`; ``edited`` comes from the user."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(MicroscopeOptics, parent=parent)
        self.modality, self.model = self.fields["modality"], self.fields["model"]
        self.fields["immersion"].setCurrentText("water")
        self.numbers = {n: self.fields[n] for n, d in self.described.items() if d.kind == "number"}
        self._fitted: tuple[str, ...] | None = None
        self._zernike: dict[int, float] | None = None
        self.edited.connect(self._show_rows)
        self._show_rows()

    def settings(self) -> MicroscopeOptics:
        """The settings shown. InputError where one is missing."""
        found: dict[str, Any] = {"kind": "microscope", "fitted": self._fitted}
        found |= {name: value for name, value in self.values().items() if self._needs(name)}
        if found["model"] == "pupil":
            found["zernike"] = self._zernike
        given = {name: value for name, value in found.items() if value is not None}
        return optics_from_values(given)

    def show_settings(self, settings: MicroscopeOptics) -> None:
        """Show settings, without a signal."""
        self._fitted, self._zernike = settings.fitted, settings.zernike
        with signals_blocked(self):
            self.show_values(settings)
        self._show_rows()

    def _needs(self, name: str) -> bool:
        other, choices = _SHOWN_FOR.get(name, ("", ()))
        if other and self.fields[other].currentText() not in choices:
            return False
        return name != "depth" or bool(self.numbers["sample_index"].value() > 0)

    def _show_rows(self) -> None:
        for name in self.fields:
            self.form.setRowVisible(self.fields[name], self._needs(name))


class MeasuredFields(QWidget):
    """Fields of :class:`MeasuredOptics`; ``edited`` comes from the user.

    Parameters
    ----------
    complain : takes a sentence about what cannot be used.
    """

    edited = Signal()

    def __init__(self, complain: Callable[[str], None], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._complain = complain
        self.file = ""
        tip = "A file with one bead, near its middle: .tif or .npy."
        self.button = button("Image of a bead...", tip, self._ask_file, self)
        self.name = QLabel("none yet", self)
        self.name.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.form = Form(MeasuredOptics, ("voxel_size", "bead_diameter", "bead"), self)
        self.diameter = self.form.fields["bead_diameter"]
        column(self.button, self.name, self.form, of=self)
        self.form.hide()
        self.form.edited.connect(self.edited)

    def settings(self) -> MeasuredOptics:
        """The settings shown. InputError where there is no image."""
        if not self.file:
            raise InputError("choose the image of a bead")
        values = self.form.values()
        diameter = values["bead_diameter"]
        if diameter > 50:
            raise InputError(f"a bead of {diameter:g} um: did you mean {diameter / 1000:g}?")
        return MeasuredOptics(file=self.file, **values)

    def show_settings(self, settings: MeasuredOptics) -> None:
        """Show settings, without a signal."""
        self._show_file(settings.file)
        try:
            size = settings.voxel_size or _noted_size(settings.file)
        except InputError:
            size = None  # the file is gone: building the PSF says so
        with signals_blocked(self):
            self.form.show_values(settings.model_copy(update={"voxel_size": size}))

    def take_file(self, path: str) -> None:
        """Take the image of a bead. InputError if its voxel size cannot be read."""
        size = _noted_size(path)
        self._show_file(path)
        if size is not None:
            self.form.show_value("voxel_size", size)
        self.edited.emit()

    def _show_file(self, path: str) -> None:
        self.file = path
        self.name.setText(Path(path).name)
        self.name.setToolTip(path)
        self.form.setVisible(bool(path))

    def _ask_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Image of a bead", "", _FILES)
        if path:
            attempt(partial(self.take_file, path), self._complain)


def _noted_size(path: str) -> tuple[float, float, float] | None:
    """The voxel size that a file notes, um. InputError if it cannot be read."""
    return read_voxel_size(path) if Path(path).suffix.lower() != ".npy" else None
