"""What the parts of the widget share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ...accuracy.forecast import Experience
from ..background import BackgroundRun
from ..panels.image_panel import ImagePanel
from ..panels.settings_panel import SettingsPanel
from ..results.results_panel import ResultsPanel
from ..seeding.seeds_panel import SeedsPanel
from ..viewing.viewer_link import ViewerLink
from .run_panel import RunPanel
from .worker import FitRun


@dataclass
class Live:
    """What must end with the widget; it knows nothing of the widget, and so outlives it."""

    run: FitRun | None = None
    link: ViewerLink | None = None
    tracking: BackgroundRun | None = None
    experience: Experience = field(default_factory=Experience)  # from the last run
    panels: list[Any] = field(default_factory=list)

    @property
    def occupied(self) -> str:
        """What runs, and what to do so that something else can; '' for nothing."""
        if self.run is not None and self.run.running:
            return "a fit is running already: stop it first"
        if self.tracking is not None and self.tracking.running:
            return "cells are being tracked already: stop that first"
        return ""

    def would_end(self) -> str:
        """What closing the widget would end, and what is kept of it; '' for nothing."""
        if self.run is not None and self.run.running:
            return "A fit is running. Its meshes stay in the viewer, but its table and history go."
        if self.tracking is not None and self.tracking.running:
            return (
                "Cells are being tracked. The frames done stay in the viewer, but their table goes."
            )
        return ""

    def close(self, gone: Any = None) -> None:
        """End everything; once is enough."""
        if self.run is not None:
            self.run.close()
        if self.link is not None:
            self.link.close()
        for panel in self.panels:
            panel.close_links()
        self.run = self.link = self.tracking = None
        self.panels = []


@dataclass(frozen=True)
class Panels:
    """The panels that say what to run and show how it goes."""

    image: ImagePanel
    seeds: SeedsPanel
    settings: SettingsPanel
    running: RunPanel
    results: ResultsPanel
