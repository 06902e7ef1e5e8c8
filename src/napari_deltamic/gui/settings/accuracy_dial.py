"""The accuracy dial: a name that is relative to the noise of the image, or a number."""

from __future__ import annotations

from collections.abc import Callable

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QComboBox, QWidget

from ...fitting.default_accuracy import (
    PRESETS,
    Preset,
    accuracy_of,
    chosen,
    is_length,
    relative,
    written,
)
from ...runs.fit_settings import SHAPE_CHOICES
from ..widgets import be_narrow

NORMAL: Preset = "normal"
# What the page of preferences offers; the dial also takes any other number.
CHOICES: tuple[str, ...] = (*PRESETS, "1e-2", "3e-3", "1e-3", "3e-4", "1e-4", "1e-5")
_TIPS: dict[Preset, str] = {
    "quick": "Longer edges, images five times coarser than normal, an earlier end. The fastest, "
    "but the shape may be off by more than the noise makes it: for a first look.",
    "normal": "As accurate as the noise of this image can tell: finer renderings take longer and "
    "do not improve the shape.",
    "careful": "Edges so short that flat triangles add nothing beside the noise, images ten times "
    "finer than normal, a later end.",
    "exact": "The closed form at every wavevector of the grid: no approximation at all, and often "
    "hundreds of times slower. To check the others with.",
}
_TIP = (
    "How near to the true shape the fit is to come, and so how long it takes. Choose a name, or "
    "type how far the shape may be off, such as 20nm, or the relative error that rendered images "
    "may have, such as 3e-3."
)


class AccuracyDial(QComboBox):
    """Quick, normal, careful, exact, or a number that is typed in.

    Parameters
    ----------
    noise : the noise of the image chosen, see ``image_noise``. InputError where there is none.
    """

    def __init__(self, noise: Callable[[], float], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.noise = noise
        self.setEditable(True)
        self.setInsertPolicy(QComboBox.InsertPolicy.NoInsert)
        for k, name in enumerate(PRESETS):
            self.addItem(name)
            self.setItemData(k, f"<qt>{_TIPS[name]}</qt>", Qt.ItemDataRole.ToolTipRole)
        rows = "".join(f"<br><b>{name}</b>: {_TIPS[name]}" for name in PRESETS)
        self.setToolTip(f"<qt>{_TIP}{rows}</qt>")
        be_narrow(self, 8)
        self.setMinimumWidth(104)  # napari's style asks for more, and the dock could not be narrow
        self.show_choice(NORMAL)

    @property
    def choice(self) -> str:
        """What is chosen: a name, or what was typed."""
        return chosen(self.currentText())

    def setting(self) -> float | None:
        """The accuracy for the settings; None leaves it to the noise. InputError if it is none."""
        return None if self.choice == NORMAL or is_length(self.choice) else self.number()

    @property
    def shape_error(self) -> str:
        """What the choice says of the shape: numbers without a unit are of images alone."""
        word = self.choice
        known = word in SHAPE_CHOICES or is_length(word)
        return word.replace(" ", "") if known else "normal"

    def number(self) -> float:
        """What the choice stands for on this image. InputError if nothing."""
        choice = self.choice
        return accuracy_of(choice, self.noise() if relative(choice) else 0.0)

    def show_fit(self, accuracy: float | None, shape_error: str) -> None:
        """Show what settings say of images and of the shape."""
        if shape_error != "normal":
            self.show_choice(shape_error)
            return
        self.show_choice(NORMAL if accuracy is None else written(accuracy))

    def show_choice(self, choice: str) -> None:
        """Show a name or a number."""
        self.setCurrentText(chosen(choice))
