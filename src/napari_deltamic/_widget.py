"""The dock widget: panels, one run at a time, and the link to the viewer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from napari.utils.notifications import show_info, show_warning
from qtpy.QtCore import QEvent, Qt
from qtpy.QtGui import QResizeEvent
from qtpy.QtWidgets import QApplication, QFileDialog, QScrollArea, QVBoxLayout, QWidget

from .cli.messages import failure
from .errors import InputError
from .gui.command import command, needs_folder, with_files
from .gui.frame import Frame
from .gui.image_panel import ImagePanel
from .gui.results_panel import ResultsPanel
from .gui.run_panel import RunPanel
from .gui.seeds import Seeds
from .gui.seeds_panel import SeedsPanel
from .gui.settings_panel import SettingsPanel
from .gui.viewer_link import ViewerLink
from .gui.worker import FitRun, Outcome, Snapshot
from .inference.checks import check_image
from .job import FitInput, assemble
from .settings import RunSettings


class _Column(QScrollArea):
    """Scrolls up and down only, so it is never narrower than what it shows."""

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        """Qt's; by now the theme, which decides how wide things are, has been applied."""
        shown, bar = self.widget(), self.verticalScrollBar()
        if shown is not None and bar is not None:
            self.setMinimumWidth(shown.minimumSizeHint().width() + bar.sizeHint().width() + 2)
        super().resizeEvent(event)


@dataclass
class _Live:
    """What must end with the widget; it knows nothing of the widget, and so outlives it."""

    run: FitRun | None = None
    link: ViewerLink | None = None
    panels: list[Any] = field(default_factory=list)

    def close(self, gone: Any = None) -> None:
        """End everything; once is enough."""
        if self.run is not None:
            self.run.close()
        if self.link is not None:
            self.link.close()
        for panel in self.panels:
            panel.close_links()
        self.run = self.link = None
        self.panels = []


class FitWidget(QWidget):
    """Pick an image, place seeds, run: the mesh and the PSF converge in the viewer."""

    def __init__(self, napari_viewer: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._viewer = viewer = napari_viewer  # napari knows the parameter by this name
        self._live = _Live()
        self._docked = False
        self.image = ImagePanel(viewer, self)
        self.seeds = SeedsPanel(viewer, self.image, self)
        self.settings = SettingsPanel(self.image, self)
        self.running = RunPanel(self)
        self.results = ResultsPanel(self.guarded, self)
        self._live.panels = [self.image, self.seeds]
        # With its window the widget is deleted without a word to Python.
        self.destroyed.connect(self._live.close)
        self._lay_out()
        self.running.run.connect(self.start)
        self.running.pause.connect(self.pause)
        self.running.stop.connect(self.stop)
        self.running.copy_command.connect(self._copy_command)
        self.running.rendered_toggled.connect(self._show_images)
        self.running.residual_toggled.connect(self._show_images)
        self.results.cell_chosen.connect(self._go_to)
        self.results.saved.connect(lambda path: show_info(f"saved {path}"))

    # ------------------------------------------------------------------------------------- runs

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
        seeds = seeds or self.seeds.seeds(self.image.frame())
        return RunSettings(
            image=self.image.path(),
            seeds=seeds.path,
            scene=self.settings.scene_settings(),
            fit=self.settings.fit_settings(),
        )

    def start(self) -> None:
        """Start a fit of what is chosen; says in plain words what is missing."""
        if self._live.run is not None and self._live.run.running:
            show_info("a fit is running already: stop it first")
            return
        self.guarded(self._start)

    def pause(self, paused: bool) -> None:
        """Let the fit wait, or go on."""
        if self._live.run is not None:
            self._live.run.pause(paused)

    def stop(self) -> None:
        """End the fit; what it reached is kept."""
        if self._live.run is not None:
            self._live.run.stop()
            self.running.say("stopping ...")

    def guarded(self, action: Callable[[], None]) -> None:
        """Run something that may fail; the user reads why, without a traceback."""
        try:
            action()
        except InputError as error:
            self._complain(str(error))
        except Exception as error:  # a bug, but no reason to frighten a user or to lose the fit
            self._complain(str(failure(error)))

    def close_links(self) -> None:
        """End what runs, and let the viewer go; the widget is of no use after that."""
        self._live.close()

    # ----------------------------------------------------------------------------------- inside

    def _start(self) -> None:
        frame = self.image.frame()
        seeds = self.seeds.seeds(frame)
        settings = self.run_settings(seeds)
        pixels, grid = self.image.stack(), None
        grid = frame.grid(pixels.shape)
        check_image(pixels, grid)

        def prepare() -> FitInput:
            return assemble(settings, pixels, grid, seeds.mesh(pixels, grid), seeds.kind)

        self._link_to(frame)
        self.seeds.finish_placing()
        self._live.run = FitRun(prepare, self._show, self._ended, show_warning)
        self._live.run.show_rendered(self._wants_images())
        self.running.psf.show_sigma("start", settings.scene.sigma or (0, 0, 0))
        self.running.set_running(True)
        self.running.say("preparing the seeds ...")
        self._live.run.start()

    def _link_to(self, frame: Frame) -> None:
        """A link for the image chosen; that of the last run if its layers are still of use."""
        old = self._live.link
        if old is not None:
            same = old.image_layer is self.image.layer and old.frame == frame
            if same and old.surface in self._viewer.layers:
                return
            old.close()
        self._live.link = ViewerLink(self._viewer, self.image.layer, frame, self._lost)

    def _show(self, snapshot: Snapshot) -> None:
        run, link = self._live.run, self._live.link
        if run is None or link is None:
            return
        state = snapshot.state
        link.show_mesh(state.mesh)
        if snapshot.rendered is not None:
            residual = self.running.residual.isChecked()
            link.show_rendered(snapshot.rendered, snapshot.job.image if residual else None)
            link.show_layers(self.running.rendered.isChecked(), residual)
        panel = self.running
        panel.show_progress(run.history, state.level, state.levels, snapshot.iterations_per_second)
        panel.psf.show_sigma("now", state.optics.sigma_um)

    def _ended(self, outcome: Outcome) -> None:
        self.guarded(lambda: self._end(outcome))

    def _end(self, outcome: Outcome) -> None:
        run, state = self._live.run, outcome.state
        self.running.set_running(False)
        self.running.say("")
        text = outcome.message
        if state is not None:
            text += f" ({state.iteration} iterations, {outcome.seconds:.1f} s)"
        self.running.show_verdict(outcome.verdict, text)
        if outcome.verdict == "failed":
            self._complain(outcome.message)
        if state is None or outcome.job is None or run is None or self._live.link is None:
            return
        if self._live.link.surface is None or self._live.link.surface in self._viewer.layers:
            self._live.link.show_mesh(state.mesh)
        self.results.show_result(state, outcome.job, run.history, outcome.seconds)

    def _lost(self, reason: str) -> None:
        """A layer that the fit needs is gone: end it, keep what it reached."""
        run = self._live.run
        if run is not None and run.running and not run.stopping:
            run.stop()
            show_warning(f"the fit ends, as {reason}; its result can still be saved")

    def _wants_images(self) -> bool:
        return self.running.rendered.isChecked() or self.running.residual.isChecked()

    def _show_images(self, checked: bool) -> None:
        rendered, residual = self.running.rendered.isChecked(), self.running.residual.isChecked()
        if self._live.run is not None:
            self._live.run.show_rendered(rendered or residual)
        if self._live.link is None:
            return
        if checked and self._live.run is not None and not self._live.run.running:
            self.guarded(self._render_last)
        self._live.link.show_layers(rendered, residual)

    def _render_last(self) -> None:
        last = self.results.last
        if last is not None and self._live.link is not None:
            self._live.link.show_rendered(last[0].rendered(), last[1].image)

    def _copy_command(self) -> None:
        self.guarded(self._copy)

    def _copy(self) -> None:
        frame = self.image.frame()
        seeds = self.seeds.seeds(frame)
        settings, pixels = self.run_settings(seeds), self.image.stack()
        grid = frame.grid(pixels.shape)
        if needs_folder(settings):
            folder = QFileDialog.getExistingDirectory(
                self, "Folder for the image and the seeds, which are not in files yet"
            )
            if not folder:
                return
            settings = with_files(settings, pixels, grid, seeds, Path(folder))
        output = str(Path(settings.seeds).with_name("result"))
        missing = bool(np.isnan(pixels).any()) if pixels.dtype.kind == "f" else False
        text = command(settings, output, missing=missing)
        clipboard: Any = QApplication.clipboard()
        clipboard.setText(text)
        show_info(f"copied: {text}")

    def _go_to(self, center: tuple[float, float, float]) -> None:
        if self._live.link is None or not np.isfinite(center).all():
            return
        world = self._live.link.frame.to_world(center)
        n = self._viewer.dims.ndim
        self._viewer.dims.set_point(range(n - 3, n), [float(w) for w in world])
        scene = getattr(self._viewer, "scene", self._viewer)  # before napari 0.9, the viewer itself
        scene.camera.center = tuple(float(w) for w in world)

    def _complain(self, message: str) -> None:
        self.running.show_verdict("failed", message)
        show_warning(message)

    # ------------------------------------------------------------------------------------ window

    def event(self, event: QEvent | None) -> bool:
        """Qt's events; napari closes a dock by taking its widget out, without deleting it."""
        if event is not None and event.type() == QEvent.Type.ParentChange:
            if self.parent() is None and self._docked:
                self.close_links()
            self._docked = self.parent() is not None
        return bool(super().event(event))

    def _lay_out(self) -> None:
        inner = QWidget(self)
        column = QVBoxLayout(inner)
        column.setContentsMargins(2, 2, 2, 2)
        for panel in (self.image, self.seeds, self.settings, self.running, self.results):
            column.addWidget(panel)
        column.addStretch()
        scroll = _Column(self)
        scroll.setWidget(inner)
        scroll.setWidgetResizable(True)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(scroll)
