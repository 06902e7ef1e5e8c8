"""The dock widget: the panels, one under the other, and the wires between them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from napari.utils.notifications import show_info, show_warning
from qtpy.QtCore import QEvent, QObject, QSize, Qt
from qtpy.QtWidgets import (
    QApplication,
    QFileDialog,
    QFrame,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from ..common.description import described
from ..results.exchange import labels_of
from ..runs.seeds import Seeds
from ..runs.settings import RunSettings, SceneSettings
from .accuracy.accuracy_forecast import AccuracyForecast
from .accuracy.accuracy_measure import MeasureControl
from .attempt import attempt
from .closing import ask_before_closing
from .editing.interaction import Interaction
from .effects.effects_check import EffectsCheck
from .effects.effects_panel import EffectsPanel
from .fields import tip_of
from .header import Header
from .optics.optics_panel import OpticsPanel
from .panels.image_panel import ImagePanel
from .panels.preferences import read_preferences
from .panels.settings_panel import SettingsPanel
from .plain import unwrapped
from .results.command_copy import CommandCopy, Wanted
from .results.results_panel import ResultsPanel
from .results.selection import ClickSelection
from .results.session import Parts, capture, restore
from .results.session_bar import SessionBar
from .running.composition import Live, Panels
from .running.run_control import RunControl
from .running.run_panel import RunPanel
from .running.run_progress import Snapshot
from .running.worker import FitRun
from .seeding.seeds_panel import SeedsPanel
from .tracking.control import TrackControl
from .tracking.panel import TrackPanel
from .viewing.cell_features import labels_layer
from .viewing.viewer_link import ViewerLink

_WIDTH = 390  # px


class _Column(QScrollArea):
    """Scrolls up and down only, so it is never narrower than what it shows."""

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Qt's, of what it shows; the theme, which decides how wide things are, may come late."""
        kinds = (QEvent.Type.LayoutRequest, QEvent.Type.Resize)
        if event is not None and event.type() in kinds:
            self._fit_width()
        return bool(super().eventFilter(watched, event))

    def _fit_width(self) -> None:
        shown, bar = self.widget(), self.verticalScrollBar()
        if shown is not None and bar is not None:
            self.setMinimumWidth(shown.minimumSizeHint().width() + bar.sizeHint().width() + 2)


class FitWidget(QWidget):
    """Pick an image, place seeds, run: the mesh and the PSF converge in the viewer."""

    def __init__(self, napari_viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        viewer = unwrapped(napari_viewer)  # napari knows the parameter by this name
        self._docked = False
        self.header = Header(self)
        self.image = ImagePanel(viewer, self)
        self.seeds = SeedsPanel(viewer, self.image, self)
        optics = OpticsPanel(viewer, tip_of(described(SceneSettings)["sigma"]), self)
        effects = EffectsPanel(viewer, self.image, self)
        self.settings = SettingsPanel(self.image, optics, effects, self)
        self.running = RunPanel(self)
        self.track_panel = TrackPanel(self)
        self.results = ResultsPanel(lambda action: attempt(action, _warn), self)
        panels = Panels(self.image, self.seeds, self.settings, self.running, self.results)
        self._live = live = Live(panels=[self.image, self.seeds])
        seeds = self.seeds
        live.panels.append(
            # A click that corrects labels chooses no cell.
            ClickSelection(
                viewer,
                lambda: None if seeds.corrections.bar.tool else live.link,
                self.results.choose,
            )
        )
        self.control = RunControl(viewer, panels, live, _tell, _warn, parent=self)
        self.interaction = Interaction(viewer, self.control, panels, live, self)
        self.forecast = AccuracyForecast(viewer, panels, live, self.control, self)
        self.measuring = MeasureControl(viewer, panels, live, self.control, self.forecast, self)
        self.tracking = TrackControl(
            viewer, self.track_panel, panels, live, self.control, _tell, _warn, self
        )
        self.checking = EffectsCheck(panels, live, self.control, self)
        live.panels += [self.forecast, self.measuring, self.tracking, self.checking]
        live.panels += [self.settings.optics, self.settings.effects.second]
        self.parts = parts = Parts(viewer, panels, self.control, live, self.tracking)
        self.sessions = SessionBar(partial(capture, parts), partial(restore, parts), _warn, self)
        self.commands = CommandCopy(self._folder, self._copied, self._not_copied)
        live.panels += [self.sessions, self.commands]
        # With its window the widget is deleted without a word to Python.
        self.destroyed.connect(self._live.close)
        self.header.copy_command.connect(self._copy_command)
        self._viewer = viewer
        self.header.simulate.connect(self._simulate)
        self.control.shown.connect(self._show_psf)
        self.control.ended.connect(self._show_last_psf)
        self.control.began.connect(self._show_check)
        self.running.again.clicked.connect(self._fit_again)
        self.image.changed.connect(self._show_own_psf)
        self.results.cell_chosen.connect(self._go_to)
        self.results.cells_chosen.connect(self._highlight)
        self.results.remarked.connect(_warn)
        self.results.coloured.connect(self._colour_cells)
        self.results.measured.connect(self._describe_cells)
        self.results.labels_wanted.connect(self._labels_wanted)
        for part in (self.results, self.sessions):
            part.saved.connect(lambda path: _tell(f"saved {path}"))
        self._lay_out()
        preferences, remark = read_preferences()
        preferences.show(panels, self.control)
        if remark:
            _warn(remark)

    @property
    def run(self) -> FitRun | None:
        """The run under way, or the last one."""
        return self._live.run

    @property
    def link(self) -> ViewerLink | None:
        """What shows the last run in the viewer."""
        return self._live.link

    def run_settings(self, seeds: Seeds | None = None) -> RunSettings:
        """The whole run as it is shown, the same object that the command line makes."""
        return self.control.run_settings(seeds)

    def start(self) -> None:
        """Start a fit of what is chosen; says in plain words what is missing."""
        self.control.start()

    def pause(self, paused: bool) -> None:
        """Let the fit wait, or go on."""
        self.control.pause(paused)

    def stop(self) -> None:
        """End the fit; what it reached is kept."""
        self.control.stop()

    def guarded(self, action: Callable[[], None]) -> None:
        """Run something that may fail; the user reads why, without a traceback."""
        self.control.guarded(action)

    def close_links(self) -> None:
        """End what runs, and let the viewer go; the widget is of no use after that."""
        self.seeds.clear_preview()
        self._live.close()

    # ----------------------------------------------------------------------------------- inside

    def _show_psf(self, snapshot: Snapshot) -> None:
        self.settings.optics.picture.show_optics(snapshot.state.optics)

    def _show_last_psf(self) -> None:
        present = self.control.present()
        if present is not None:
            self.settings.optics.picture.show_optics(present.state.optics)

    def _show_own_psf(self) -> None:
        link = self._live.link
        if link is not None and link.image_layer is not self.image.layer:
            self.settings.optics.show_own()

    def _go_to(self, center: tuple[float, float, float]) -> None:
        if self._live.link is not None:
            self._live.link.go_to(center)

    def _highlight(self, regions: frozenset[int]) -> None:
        if self._live.link is not None:
            self._live.link.highlight(regions)

    def _colour_cells(self) -> None:
        if self._live.link is not None:
            key = self.results.coloured_by
            numbers = self.results.table.numbers(key) if key else None
            self._live.link.colour_by(numbers)
            self.results.show_scale(numbers)

    def _describe_cells(self) -> None:
        if self._live.link is not None:
            self._live.link.describe(self.results.table.rows)

    def _simulate(self) -> None:
        """Open the other widget of this plugin, in a dock of its own."""
        self.guarded(partial(_open_simulator, self._viewer))

    def _labels_wanted(self) -> None:
        self.guarded(self._add_labels)

    def _add_labels(self) -> None:
        link, last = self._live.link, self.results.last
        if link is None or last is None or link.shown is None:
            return
        layer = labels_layer(
            labels_of(link.shown, last[1].grid),
            self.results.table.rows,
            link.frame,
            f"{link.image_layer.name} labels",
        )
        link.viewer.add_layer(layer)

    def _copy_command(self) -> None:
        self.control.tried(self._copy)

    def _copy(self) -> None:
        frame, pixels = self.image.frame(), self.image.stack()
        seeds = self.seeds.seeds(frame)
        settings = self.run_settings(seeds)
        self.running.tell("putting the command together ...")
        second = self.settings.effects.second.pixels()
        self.commands.copy(Wanted(settings, pixels, frame.grid(pixels.shape), seeds, second))

    def _folder(self) -> str:
        self.running.tell("")
        title = "Folder for the image and the seeds, which are not in files yet"
        return str(QFileDialog.getExistingDirectory(self, title))

    def _copied(self, text: str) -> None:
        self.running.tell("")
        clipboard: Any = QApplication.clipboard()
        clipboard.setText(text)
        _tell(f"copied: {text}")

    def _not_copied(self, reason: str) -> None:
        self.running.tell(reason)
        _warn(reason)

    def _fit_again(self) -> None:
        """With all that a fit can estimate."""
        self.settings.fit_psf.setChecked(True)
        self.settings.density.setCurrentText("smooth")
        self.start()

    def _show_check(self, fresh: bool) -> None:
        """Scroll to what a fit shows, once it begins."""
        self._column.ensureWidgetVisible(self.running, 0, 0)

    def sizeHint(self) -> QSize:
        """Qt's: as wide as the table wants."""
        return QSize(_WIDTH, super().sizeHint().height())

    def event(self, event: QEvent | None) -> bool:
        """Qt's events; napari closes a dock by taking its widget out, without deleting it."""
        if event is not None and event.type() == QEvent.Type.ParentChange:
            if self.parent() is None and self._docked:
                self.close_links()
            self._docked = self.parent() is not None
            ask_before_closing(self, self._live.would_end)
        return bool(super().event(event))

    def _lay_out(self) -> None:
        clicks = self.seeds.corrections.bar
        self.header.offer(
            [
                self.sessions.open_action,
                self.sessions.save_action,
                clicks.load_action,
                clicks.save_action,
            ]
        )
        inner = QWidget(self)
        column = QVBoxLayout(inner)
        column.setContentsMargins(2, 2, 2, 2)
        panels = (self.image, self.seeds, self.settings, self.track_panel)
        for panel in (*panels, self.running, self.results, self.settings.advanced):
            column.addWidget(panel)
        column.addStretch()
        scroll = _Column(self)
        scroll.setWidget(inner)
        inner.installEventFilter(scroll)
        scroll.setWidgetResizable(True)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        self._column = scroll
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self.header)
        layout.addWidget(scroll, 1)
        layout.addWidget(self.running.footer)


def _open_simulator(viewer: Any) -> None:
    viewer.window.add_plugin_dock_widget("napari-deltamic", "Simulate cells")


def _tell(text: str) -> None:
    show_info(text)


def _warn(text: str) -> None:
    show_warning(text)
