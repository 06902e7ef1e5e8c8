"""The dock widget: the document, and the panels that show it, one under the other."""

from __future__ import annotations

from functools import partial
from typing import Any

from napari.utils.notifications import show_info, show_warning
from qtpy.QtCore import QEvent, QSize
from qtpy.QtWidgets import QWidget

from .dock import Column, Header, ask_before_closing, bind_keys
from .document import Document
from .image_panel import ImagePanel
from .results.more_actions import CommandCopy, SessionBar
from .results.results_panel import ClickSelection, ResultsPanel
from .results.session import Parts
from .running.check_panel import CheckPanel
from .running.edits import Edits
from .running.footer import Footer
from .running.live_settings import LiveSettings
from .running.run_control import Judging, RunControl
from .seeding.seeds_panel import SeedsPanel
from .settings.effects_panel import EffectsPanel
from .settings.optics_panel import OpticsPanel
from .settings.preferences import PLUGIN, read_preferences
from .settings.settings_panel import SettingsPanel
from .tracking.panel import TrackPanel
from .viewing.frame import unwrapped
from .widgets import action, column
from .window_words import for_window

_WIDTH = 390  # px


class FitWidget(QWidget):
    """Pick an image, find the cells, fit: the mesh and the PSF converge in the viewer."""

    def __init__(self, napari_viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)  # napari knows the parameter by this name
        self._docked = False
        self.doc = doc = Document(unwrapped(napari_viewer))
        doc.told.connect(lambda text: show_info(for_window(text)))
        doc.warned.connect(lambda text: show_warning(for_window(text)))
        self.image = ImagePanel(doc, self)
        self.seeds = SeedsPanel(doc, self)
        self.settings = SettingsPanel(doc, OpticsPanel(doc, self), EffectsPanel(doc, self), self)
        self.control = RunControl(doc)
        self.edits = Edits(doc, self.control, self)
        self.live_settings = LiveSettings(doc, self.edits)
        self.judging = Judging(doc)
        self.footer = Footer(doc, self.control, self)
        self.running = CheckPanel(doc, self.edits, self.control, self)
        self.tracking = TrackPanel(doc, self)
        self.results = ResultsPanel(doc, self)
        clicks = self.seeds.corrections.bar
        # A click that corrects labels chooses no cell.
        chooses = ClickSelection(
            doc.viewer, lambda: None if clicks.tool else doc.link, self.results.choose
        )
        self.parts = Parts(doc, self.seeds, self.tracking)
        self.sessions = SessionBar(self.parts, self)
        self.commands = CommandCopy(doc, self)
        # With its window the widget is deleted without a word to Python.
        self.destroyed.connect(doc.close)
        self.running.fit_again.connect(self._fit_again)
        doc.began.connect(self._show_check)
        self.settings.psf_button.clicked.connect(self._show_psf)
        bind_keys(
            doc,
            {
                "Alt-C": self.seeds.find_cells.start,
                "Alt-F": self.start_or_stop,
                "Alt-P": self.footer.pause_button.click,
                "Alt-W": self.running.go_to_worst,
                "Alt-V": doc.look_further,
            },
        )
        doc.at_end(chooses.close_links)
        self._lay_out()
        preferences, remark = read_preferences()
        preferences.show(doc, self.settings.optics, self.seeds.preview)
        if remark:
            doc.warned.emit(remark)

    def start(self) -> None:
        """Start a fit of what is chosen; says in plain words what is missing."""
        self.control.start()

    def start_or_stop(self) -> None:
        """Start a fit of what is chosen, or end what runs."""
        if self.doc.work.task is None:
            self.start()
        else:
            self.stop()

    def stop(self) -> None:
        """End what runs; what it reached is kept."""
        self.doc.work.stop()

    def close_links(self) -> None:
        """End what runs, and let the viewer go; the widget is of no use after that."""
        self.seeds.preview.clear()
        self.doc.close()

    def _simulate(self) -> None:
        """Open the other widget of this plugin, in a tab: below, it would leave no room here."""
        self.doc.viewer.window.add_plugin_dock_widget(PLUGIN, "Simulate cells", tabify=True)

    def _fit_again(self) -> None:
        self.settings.estimate_all()
        self.start()

    def _show_check(self, fresh: bool) -> None:
        """Scroll to what a fit shows, once it begins."""
        self._column.show_part(self.running)

    def _show_psf(self) -> None:
        self._column.show_part(self.settings.psf_fold)

    def sizeHint(self) -> QSize:
        """Qt's: as wide as the table wants."""
        return QSize(_WIDTH, super().sizeHint().height())

    def event(self, event: QEvent | None) -> bool:
        """Qt's events; napari closes a dock by taking its widget out, without deleting it."""
        if event is not None and event.type() == QEvent.Type.ParentChange:
            if self.parent() is None and self._docked:
                self.close_links()
            self._docked = self.parent() is not None
            ask_before_closing(self, self.doc.would_end)
        return bool(super().event(event))

    def _lay_out(self) -> None:
        simulate = action("Simulate cells...", "", partial(self.doc.guarded, self._simulate), self)
        sessions, commands = self.sessions, self.commands
        own = (commands.copy_action, commands.folder_action, simulate)
        self.header = Header(((sessions.open_action, sessions.save_action), own), self)
        inner = QWidget(self)
        panels = (self.image, self.seeds, self.settings, self.tracking, self.running)
        shown = column(*panels, self.results, self.settings.advanced, of=inner)
        shown.setContentsMargins(2, 2, 2, 2)
        shown.addStretch()
        self._column = Column(inner, self)
        column(self.header, (self._column, 1), self.footer, of=self, spacing=2)
