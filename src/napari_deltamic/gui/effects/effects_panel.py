"""Which effects are computed, and what the image says about them."""

from __future__ import annotations

from typing import Any

from qtpy.QtWidgets import QHBoxLayout, QPushButton, QVBoxLayout, QWidget

from ...errors import InputError
from ...evidence import Recommendation
from ...evidence.camera import Camera
from ...evidence.candidates import CONSIDERED
from ...scene.effects import KINDS, Effects
from ..qt import Signal
from ..widgets import Note
from .effects_table import EffectsTable, spoken
from .second_view_fields import SecondViewFields

_START, _STOP = "Check this image", "Stop checking"
_TIP = (
    "<qt>Asks the image: fits it (or takes the present fit), and tells for each effect how clearly "
    "it is seen, by how much the surface is off without it, and what it costs. Takes as long as a "
    "fit, often longer, in the background. Nothing is added before you tick it.</qt>"
)
_NOT_NOW = "no checking while a fit runs: both would need the same processor"


class EffectsPanel(QWidget):
    """Button, table and reasons; ``changed`` says that the user wants other effects."""

    changed = Signal()
    described = Signal()  # :meth:`summary` may be another
    check = Signal()
    stop = Signal()

    def __init__(self, viewer: Any, image_panel: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._effects = Effects()  # without the second view, which is chosen by its layer
        self._checking = False
        self.found: Recommendation | None = None
        self.button = QPushButton(_START, self)
        self.take_button = QPushButton("Use recommended", self)
        self.take_button.setToolTip("Tick the effects that are recommended.")
        self.progress, self.reason, self.remarks = Note(self), Note(self), Note(self)
        self.table = EffectsTable(CONSIDERED, self)
        self.second = SecondViewFields(viewer, image_panel, self)
        buttons = QHBoxLayout()
        for button in (self.button, self.take_button):
            buttons.addWidget(button)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(buttons)
        for widget in (self.progress, self.table, self.reason, self.remarks, self.second):
            layout.addWidget(widget)
        self.button.clicked.connect(self._pressed)
        self.take_button.clicked.connect(self.take_recommended)
        self.table.ticked.connect(self._ticked)
        self.table.looked_at.connect(self._explain)
        self.second.edited.connect(self._second_edited)
        self.allow(True)
        self._show_outcome()

    # -------------------------------------------------------------------------------- effects

    def effects(self) -> Effects:
        """Those ticked, with their numbers, and the second view.

        Raises
        ------
        InputError
            If the layer of the second view cannot be used.
        """
        return self._effects.replace(second_view=self.second.view())

    @property
    def own(self) -> Effects:
        """The effects ticked, without the second view."""
        return self._effects

    def show_effects(self, effects: Effects) -> None:
        """Tick effects, without a signal; the second view, which is a layer, stays as it is."""
        self._effects = effects.without("second_view")
        self.table.show_present(self._effects.names)
        self._show_outcome()

    def take_recommended(self) -> None:
        """Tick what is recommended."""
        for name in self._open_recommendations():
            self.table.tick(name)

    def summary(self) -> str:
        """The present choice in a few words."""
        chosen = [*self._effects.names, *(["second view"] if self.second.layer else [])]
        names = ", ".join(spoken(name) for name in chosen)
        more = self._open_recommendations()
        if more:
            recommended = spoken(more[0]) if len(more) == 1 else str(len(more))
            return f"{names or 'none'}; {recommended} recommended"
        if names or self.found is not None:
            return names or "none; no evidence for any"
        return "none; check this image"

    # ------------------------------------------------------------------------------- evidence

    def allow(self, allowed: bool) -> None:
        """Whether checking can be started; says why not."""
        self.button.setEnabled(allowed or self._checking)
        self.button.setToolTip(_TIP if allowed else f"<qt>{_NOT_NOW.capitalize()}.</qt>")

    def set_checking(self, checking: bool) -> None:
        """Whether the button starts or stops."""
        self._checking = checking
        self.button.setText(_STOP if checking else _START)

    def show_found(self, found: Recommendation | None) -> None:
        """Show what the image calls for; None: nothing is known."""
        self.found = found
        self.table.show_evidence(found.evidence if found else ())
        lines = [] if found is None else [*found.remarks, *_camera(found.camera)]
        self.remarks.say("; ".join(lines))
        self._explain("")
        self._show_outcome()

    # ----------------------------------------------------------------------------------- inside

    def _open_recommendations(self) -> list[str]:
        """What is recommended and not ticked."""
        found = self.found.recommended if self.found is not None else ()
        return [name for name in found if name not in self._effects.names]

    def _show_outcome(self) -> None:
        names = self._open_recommendations()
        self.take_button.setVisible(bool(names))
        if self.found is not None:
            text = ", ".join(spoken(name) for name in names)
            self.progress.say(
                f"recommended: {text}; choose a row to read why"
                if names
                else "the image gives no evidence for other corrections"
            )
        self.described.emit()

    def _second_edited(self) -> None:
        self.described.emit()
        self.changed.emit()

    def _pressed(self) -> None:
        (self.stop if self._checking else self.check).emit()

    def _ticked(self, name: str, on: bool) -> None:
        found = None if self.found is None else getattr(self.found.effects, name)
        try:
            added = (found or KINDS[name]()) if on else None
            effects = self._effects.replace(**{name: added})
        except (InputError, ValueError) as error:
            self.reason.say(f"{spoken(name)} cannot be added: {error}")
            self.table.show_present(self._effects.names)
            return
        self.reason.say("")
        self.show_effects(effects)
        self.changed.emit()

    def _explain(self, name: str) -> None:
        if not name:
            self.reason.say("")
            return
        known = {e.name: e.reason for e in (self.found.evidence if self.found else ())}
        self.reason.say(f"{spoken(name)}: {known.get(name) or KINDS[name].help}")


def _camera(camera: Camera) -> list[str]:
    """What the image tells about its camera, in a line; none where it tells nothing."""
    numbers = (("gain", camera.gain), ("read noise", camera.read_noise), ("offset", camera.offset))
    told = [f"{name} {finding.value:.3g}" for name, finding in numbers if finding.value is not None]
    return [f"camera, from the image: {', '.join(told)}"] if told else []
