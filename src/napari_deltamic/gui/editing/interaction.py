"""What a user can do while a fit runs and after it: settings, tools, history."""

from __future__ import annotations

from typing import Any

from qtpy.QtCore import QObject

from ..running.composition import Live, Panels
from ..running.live_settings import LiveSettings
from ..running.run_control import RunControl
from .edits import Edits
from .history import History
from .sculpt_tool import Sculptor


class Interaction(QObject):
    """The parts that change a fit by hand; each of them works by itself."""

    def __init__(
        self,
        viewer: Any,
        control: RunControl,
        panels: Panels,
        live: Live,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self.edits = Edits(control, self)
        self.settings = LiveSettings(control, self.edits, panels, live, self)
        self.history = History(control, self.edits, panels, live, self)
        self.sculptor = Sculptor(viewer, control, self.edits, panels, live, self)
        live.panels.append(self.sculptor)
