"""The choice of the PSF: a Gaussian, from an objective, or from a bead; and its picture."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtGui import QImage, QPixmap, QShowEvent
from qtpy.QtWidgets import QFileDialog, QFormLayout, QLabel, QSizePolicy, QWidget
from skimage.transform import resize
from superqt.utils import signals_blocked

from ...common.choices import IMAGE_FILES, ZARR
from ...common.description import described
from ...errors import InputError
from ...images.stacks import read_voxel_size
from ...optics import GaussianPSF, Optics
from ...optics.sections import Sections, psf_sections
from ...runs.optics_settings import MeasuredOptics, MicroscopeOptics, optics_from_values
from ...runs.settings import SceneSettings
from ..document import Document
from ..fields import Form, TripleField
from ..fit_choice import widths_in_words
from ..widgets import Note, Signal, button, column, narrow_box
from ..window_words import attempt

GAUSSIAN, OBJECTIVE, MEASURED, GIVEN = "Gaussian", "from the objective", "measured", "as given"
_WAIT = 250  # ms without a change before the PSF is computed
_EVERY = 250  # ms between two pictures, at least
_SIDE, _GAP = 92, 8  # px
_BARS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # um
_KINDS: dict[Any, str] = {MicroscopeOptics: OBJECTIVE, MeasuredOptics: MEASURED}
_TIPS = {
    GAUSSIAN: "Three widths; enough where cells are much larger than the PSF.",
    OBJECTIVE: "Computed from the numbers on the objective.",
    MEASURED: "The image of a bead.",
}
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
    "spherical": ("model", ("scalar",)),
}


class OpticsPanel(QWidget):
    """Lets the user choose the kind of PSF and its numbers."""

    described = Signal()  # :meth:`summary` may be another

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._doc, self._choice = doc, doc.settings
        self._given: Any = None  # settings of a kind that has no fields here
        self._key: tuple[Any, ...] = ()
        self._width = ""
        tips = "<br>".join(f"<b>{name}</b>: {text}" for name, text in _TIPS.items())
        self.kind = narrow_box(self, "kind of PSF", tips, _TIPS)
        self.sigma = TripleField(described(SceneSettings)["sigma"].sentence, self)
        self.objective = ObjectiveFields(self)
        self.measured = MeasuredFields(self._complain, self)
        self.width_note, self.found = Note(self), Note(self)
        self.trouble = Note(self, "poor")
        self.picture = PsfPicture(doc, self)
        self._pages: dict[str, QWidget] = {
            GAUSSIAN: self.sigma,
            OBJECTIVE: self.objective,
            MEASURED: self.measured,
        }
        top = QFormLayout()
        top.addRow("PSF", self.kind)
        rows = self.width_note, self.trouble, self.picture, self.found
        column(top, *self._pages.values(), *rows, of=self)
        self.background = doc.background(self._complain)
        self.kind.currentTextChanged.connect(self._edited)
        for fields in (self.objective, self.measured):
            fields.edited.connect(self._edited)
        self.sigma.edited.connect(self._choice.edit_sigma)
        self._choice.changed.connect(self._show)
        for signal in (doc.shown, doc.image.changed, doc.result_changed, doc.ended):
            signal.connect(self._show_own_or_found)
        self._show()

    def begin_with(self, objective: MicroscopeOptics, kind: str) -> None:
        """Show the numbers of an objective, and choose a kind of PSF."""
        self.objective.show_settings(objective)
        self.kind.setCurrentText(kind)

    def summary(self) -> str:
        """The present choice in a few words."""
        if self._choice.psf is None:
            return self._choice.psf_in_words()
        unknown = isinstance(self._choice.psf, InputError)
        name = self.kind.currentText() if unknown else self._choice.psf_in_words()
        more = "cannot be used" if self.trouble.text() else self._width
        return f"{name}, {more}" if more else name

    def _show_own_or_found(self) -> None:
        """Show in the picture the PSF that the image's fit found, else that of these fields."""
        present = self._doc.present()
        if present is None:
            self._show_own()
            return
        optics = present.state.optics
        self.picture.show_optics(optics)
        # Others are asked for their widths, which takes a while.
        told = ""
        if type(optics) is GaussianPSF:
            told = f": {widths_in_words(optics.sigma_um)} µm{_lean_in_words(optics)}"
        self.found.say(f"That of the fit{told}")

    def _edited(self, value: Any = None) -> None:
        self._choice.edit_psf(self._settings)

    def _settings(self) -> Any:
        """Settings of the PSF; None for the Gaussian. InputError names what is missing."""
        if self.kind.currentText() == GIVEN:
            return self._given
        fields: Any = self._pages[self.kind.currentText()]
        return None if fields is self.sigma else fields.settings()

    def _show(self, by_user: bool = False) -> None:
        """Show what is chosen, and if the PSF has changed, what follows from it."""
        if not by_user and not isinstance(self._choice.psf, InputError):
            self._show_fields(self._choice.psf)
        key = self._choice.psf_key(), self._choice.psf_is_open
        if key != self._key:
            self._key = key
            self._renew()

    def _show_fields(self, psf: Any) -> None:
        kind = GAUSSIAN if psf is None else _KINDS.get(type(psf), GIVEN)
        with signals_blocked(self.kind):
            self.kind.removeItem(self.kind.findText(GIVEN))
            if kind == GIVEN:
                self._given = psf
                self.kind.addItem(GIVEN)
            self.kind.setCurrentText(kind)
        if kind in (OBJECTIVE, MEASURED):
            fields: Any = self._pages[kind]
            fields.show_settings(psf)
        self.sigma.set_value(self._choice.sigma)

    def _renew(self) -> None:
        for kind, page in self._pages.items():
            page.setVisible(kind == self.kind.currentText())
        self._width = text = ""
        if self._choice.psf is None:
            text = "Standard deviations along Z, Y and X, µm."
        if self._choice.psf_is_open:
            text += " Until you edit them, a fit starts as wide as the blur of the image instead."
        self.width_note.say(text)
        self.background.drop()  # of what was shown before
        self._show_own()
        self._complain("")

    def _show_own(self) -> None:
        self.found.say("")
        if self._choice.psf is None:
            self.picture.show_optics(GaussianPSF(self._choice.sigma))
        else:
            self.background.soon(self._compute, _WAIT)

    def _compute(self) -> None:
        psf = self._choice.psf
        if isinstance(psf, InputError):
            self._complain(str(psf))
        elif psf is not None:
            self.background.ask(partial(_built, psf), self._show_width)

    def _show_width(self, optics: Any) -> None:
        sigma = optics.sigma_um
        self.picture.show_optics(optics)
        z, y, x = (1000 * s for s in sigma)
        across = f"{y:.0f} nm" if abs(y - x) < 0.5 else f"{y:.0f} and {x:.0f} nm"
        self._width = f"{widths_in_words(sigma)} µm"
        self.width_note.say(
            f"as wide as a Gaussian of sigma {across} in the plane, {z:.0f} nm along z"
        )
        self.described.emit()

    def _complain(self, message: str) -> None:
        if message:
            self.picture.clear()
        self.trouble.say(message)
        self.described.emit()


def _built(settings: Any) -> Any:
    """The PSF, with its width already computed, as that takes a while, too."""
    optics = settings.build()
    assert optics.sigma_um
    return optics


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
        """The settings shown. InputError if one is missing."""
        free = self._fitted and tuple(name for name in self._fitted if self._needs(name))
        found: dict[str, Any] = {"kind": "microscope", "fitted": free}
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
        """The settings shown. InputError if there is no image."""
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


class PsfPicture(QLabel):
    """Shows the PSF that it was last given; computes nothing while it is hidden."""

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.sections: Sections | None = None
        self._wanted: Optics | None = None  # not yet shown
        self._background = doc.background(self._drop)
        self.setFixedHeight(_SIDE + 2)
        self._tip = (
            "<qt>The PSF, cut along the optical axis (left) and across it, both to one scale; that "
            "of the fit, where there is one. Brightness is its square root, so that its tails are "
            "seen. The bar is {bar} µm long.</qt>"
        )

    def show_optics(self, optics: Optics) -> None:
        """Show a PSF soon; if called several times, the last one."""
        self._wanted = optics
        self._look_soon()

    def clear(self) -> None:
        """Show nothing, as there is no PSF that can be shown."""
        self._wanted = None
        self._background.drop()
        self._drop("")

    def showEvent(self, event: QShowEvent | None) -> None:
        """Called by Qt: computes now what was given while it was hidden."""
        super().showEvent(event)
        self._look_soon()

    def _look_soon(self) -> None:
        """Look at what was given, unless something is under way: then after that."""
        if self._wanted is not None and self.isVisible() and not self._background.busy:
            self._background.soon(self._look, _EVERY)

    def _look(self) -> None:
        if self._wanted is not None and self.isVisible():
            wanted, self._wanted = self._wanted, None
            self._background.ask(partial(psf_sections, wanted), self._show)

    def _show(self, sections: Sections) -> None:
        self.sections = sections
        grey = [_scaled(np.sqrt(np.clip(s, 0, 1))) for s in (sections.xz, sections.xy)]
        # A bar of a round length, at most a third of a side.
        bar = max((b for b in _BARS if b <= sections.side / 3), default=_BARS[0])
        pixels = max(round(_SIDE * bar / sections.side), 1)
        grey[1][-8:-6, _SIDE - 6 - pixels : _SIDE - 6] = 255
        gap = np.zeros((_SIDE, _GAP), np.uint8)
        picture = np.ascontiguousarray(np.hstack([grey[0], gap, grey[1]]))
        n, m = picture.shape
        image: Any = QImage(picture.tobytes(), m, n, m, QImage.Format.Format_Grayscale8)
        self.setPixmap(QPixmap.fromImage(image.copy()))
        self.setToolTip(self._tip.format(bar=f"{bar:g}"))
        self._look_soon()

    def _drop(self, reason: str) -> None:
        # Why a PSF cannot be is told beside its numbers.
        self.sections = None
        super().clear()
        self._look_soon()


def _lean_in_words(optics: GaussianPSF) -> str:
    """How its longest axis leans from Z, after a comma; nothing if it does not."""
    leans = ((round(angle), axis) for angle, axis in zip(optics.tilt, "yx", strict=True))
    told = [f"{abs(a)}° towards {'-' if a < 0 else ''}{axis}" for a, axis in leans if a]
    return f", leaning {' and '.join(told)}" if told else ""


def _scaled(section: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A section scaled to the square of a picture, as its samples differ in size along the axes."""
    square = resize(section, (_SIDE, _SIDE), order=1, anti_aliasing=True)
    return (255 * np.clip(square, 0, 1)).astype(np.uint8)


def _noted_size(path: str) -> tuple[float, float, float] | None:
    """The voxel size in a file, um; None if it has none. InputError if it cannot be read."""
    return read_voxel_size(path) if Path(path).suffix.lower() != ".npy" else None
