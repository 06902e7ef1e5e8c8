"""The dock widget: the document, the panels that show it, and what lies around them."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from napari.utils.notifications import show_info, show_warning
from qtpy.QtCore import QEvent, QObject, QPoint, QSize, Qt, QUrl
from qtpy.QtGui import QDesktopServices
from qtpy.QtWidgets import QDockWidget, QFrame, QMenu, QScrollArea, QWidget

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
from .widgets import action, button, column, confirmed, row
from .window_words import for_window
from .work import one_shot

DOCS = "https://github.com/napari-deltamic/napari-deltamic/blob/main/docs/napari.md"
_WIDTH = 390  # px
_SETTLED = 1000  # ms in which all is there that a fit shows at its end; chosen


class FitWidget(QWidget):
    """Pick an image, find the cells, fit: the mesh and the PSF converge in the viewer."""

    def __init__(self, napari_viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)  # napari knows the parameter by this name
        self._docked = False
        self.doc = doc = Document(unwrapped(napari_viewer))
        doc.told.connect(lambda text: show_info(for_window(text)))
        doc.warned.connect(lambda text: show_warning(for_window(text)))
        doc.failed.connect(self._failed)
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
        for slot in (self.settings.estimate_all, self.start):
            self.running.fit_again.connect(slot)
        bind_keys(doc, self._keys())
        doc.at_end(partial(chooses.presses.listen, False))
        self._lay_out()
        preferences, remark = read_preferences()
        preferences.show(doc, self.settings.optics, self.seeds.preview)
        if remark:
            doc.warned.emit(remark)

    def start(self) -> None:
        """Start a fit of what is chosen; if something is missing, the user is told what."""
        self.control.start()

    def start_or_stop(self) -> None:
        """Start a fit of what is chosen, or stop what runs."""
        if self.doc.work.task is None:
            self.start()
        else:
            self.stop()

    def stop(self) -> None:
        """Stop what runs; what it reached is kept."""
        self.doc.work.stop()

    def _failed(self, text: str) -> None:
        """Warn of what the footer says if it cannot be seen."""
        if not self.isVisible():
            show_warning(for_window(text))

    def close_links(self) -> None:
        """Stop what runs, and release the viewer; the widget is of no use after that."""
        self.seeds.preview.clear()
        self.doc.close()

    def _keys(self) -> Mapping[str, Callable[[], Any]]:
        """The actions of keys in the viewer.

        No Alt: with it, Linux and Windows open napari's menus, and macOS types other letters.
        """
        return {
            "Shift-C": self.seeds.find_cells.start,
            "Shift-F": self.start_or_stop,
            "Shift-H": self.footer.pause_button.click,
            "Shift-W": self.running.go_to_worst,
            "Shift-S": self.doc.look_further,
        }

    def _simulate(self) -> None:
        """Open the plugin's other widget in a tab: below this one there would be no room."""
        self.doc.viewer.window.add_plugin_dock_widget(PLUGIN, "Simulate cells", tabify=True)

    def sizeHint(self) -> QSize:
        """Called by Qt: as wide as the table needs."""
        return QSize(_WIDTH, super().sizeHint().height())

    def event(self, event: QEvent | None) -> bool:
        """Called by Qt: napari closes a dock by taking its widget out, without deleting it."""
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
        scrolled = Column(inner, self)
        column(self.header, (scrolled, 1), self.footer, of=self, spacing=2)
        self.doc.began.connect(partial(scrolled.show_part, self.running))
        self.doc.ended.connect(partial(self._show_end, scrolled))
        self.settings.psf_button.clicked.connect(
            partial(scrolled.show_part, self.settings.psf_fold)
        )

    def _show_end(self, scrolled: Column) -> None:
        """Scroll to how a fit went, unless the user looks at another image."""
        if not self.doc.name_of_other(self.doc.record):
            scrolled.show_part(self.running)


class Header(QWidget):
    """A menu of actions, in groups, and a button for the docs."""

    def __init__(self, groups: Sequence[Sequence[Any]], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        more = button("More", "Sessions, the command of a run, simulated cells.", None, self)
        self.menu = QMenu(more)
        self.menu.setToolTipsVisible(True)
        for group in groups:
            self.menu.addSeparator()  # the first of a menu is not shown
            self.menu.addActions(group)
        more.setMenu(self.menu)
        tip = "Open the page of the docs about this window."
        helps = button("?", tip, partial(QDesktopServices.openUrl, QUrl(DOCS)), self)
        helps.setAccessibleName("help")
        helps.setFixedWidth(30)
        row((QWidget(self), 1), more, helps, of=self).setContentsMargins(0, 2, 4, 0)


class Column(QScrollArea):
    """A scroll area that scrolls only vertically, so it is never narrower than its content."""

    def __init__(self, shown: QWidget, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWidget(shown)
        shown.installEventFilter(self)
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self._part: QWidget | None = None
        self._soon = one_shot(self, self._go)  # when what was just shown has its place
        bar = self.verticalScrollBar()
        if bar is not None:
            bar.actionTriggered.connect(self._forget)
        self._late = one_shot(self, self._forget, _SETTLED)

    def show_part(self, part: QWidget, event: Any = None) -> None:
        """Scroll until a part of the content is at the top, so that what follows it is seen too.

        Where there is not yet enough below it, that is done if there is soon, unless the user
        scrolls first.
        """
        self._part = part
        self._soon.start()
        self._late.start()

    def _go(self) -> None:
        shown, bar = self.widget(), self.verticalScrollBar()
        if self._part is None or shown is None or bar is None or self._part.isHidden():
            self._forget()
            return
        top = self._part.mapTo(shown, QPoint()).y()
        bar.setValue(top)
        if bar.maximum() >= top:
            self._forget()

    def _forget(self, action: int = 0) -> None:
        self._part = None

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Called by Qt for events of the content: its width may change late, with the theme."""
        kinds = (QEvent.Type.LayoutRequest, QEvent.Type.Resize)
        shown, bar = self.widget(), self.verticalScrollBar()
        if shown is not None and bar is not None and event is not None and event.type() in kinds:
            self.setMinimumWidth(shown.minimumSizeHint().width() + bar.sizeHint().width() + 2)
            if self._part is not None:
                self._soon.start()
        return bool(super().eventFilter(watched, event))


def bind_keys(doc: Document, actions: Mapping[str, Callable[[], Any]]) -> None:
    """Bind keys of the viewer, as napari writes them, to actions until the window is closed.

    napari takes no keys of a viewer from a manifest.
    """
    for key, press in actions.items():
        doc.viewer.bind_key(key, lambda viewer, press=press: press(), overwrite=True)
        doc.at_end(partial(doc.viewer.bind_key, key, None, overwrite=True))


def ask_before_closing(widget: QWidget, lost: Callable[[], str]) -> None:
    """Make the close button of a widget's dock ask first if something would be lost.

    Whoever takes the widget out of its dock by other means, as scripts do, is not asked.

    lost : what that is, in words; '' for nothing. It must not hold the widget.
    """
    dock: Any = widget.parent()
    # What napari's button calls; no public way leads there. Where it is missing, nobody is asked.
    close = getattr(dock, "destroyOnClose", None)
    if not isinstance(dock, QDockWidget) or close is None:
        return
    own, docked = weakref.ref(widget), weakref.ref(dock)

    def closed() -> None:
        shown: QWidget | None = own()
        found: Any = docked()
        if found is None:
            return
        text = lost() if shown is not None and found.widget() is shown else ""
        if shown is None or not text or agreed(shown, text):
            type(found).destroyOnClose(found)

    dock.destroyOnClose = closed  # type: ignore[attr-defined]


def agreed(widget: QWidget, text: str) -> bool:
    """Whether the user wants to close the dock although something would be lost."""
    return confirmed(widget, "Close deltaMic?", text, "Close anyway", "Keep it open")
