"""Track and save; the cells of the frame that is shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from qtpy.QtWidgets import (
    QCheckBox,
    QFileDialog,
    QGroupBox,
    QLabel,
    QVBoxLayout,
    QWidget,
)

from ...common.words import counted
from ...measure import measure_cells
from ...tracking import FrameResult, TrackSettings
from ..cell_table import CellTable
from ..widgets import Note, Signal, button, filled, row


class TrackPanel(QGroupBox):
    """Shown for an image over time; ``save`` brings the folder that was chosen."""

    save = Signal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("Track", parent)
        tip = (
            "Fit the frame shown from the seeds, and every later frame from the one before. Cells "
            "keep their numbers."
        )
        self.track_button = button("Track", tip, None, self)
        tip = "Go on after the last frame that was tracked."
        self.go_on_button = button("Go on", tip, None, self)
        self.divisions = QCheckBox("cells may divide", self)
        self.divisions.setChecked(TrackSettings().divisions)
        described = TrackSettings.model_fields["divisions"].description
        self.divisions.setToolTip(f"<qt>{described}</qt>")
        self.verdict, self.frame = Note(self, style="font-weight: bold;"), QLabel(self)
        self.frame.setWordWrap(True)
        self.table = CellTable(self)
        tip = "A mesh for each frame, tracks.csv, surface.npz, report.json and run.toml."
        self.save_button = button("Save all frames...", tip, self._ask, self)
        buttons = row(self.track_button, self.go_on_button, self.divisions)
        shown = self.verdict, self.frame, self.table, self.save_button
        filled(QVBoxLayout(self), buttons, *shown)
        self.allow(True, can_go_on=False)
        self.show_frame(None)

    def allow(self, allowed: bool, *, can_go_on: bool) -> None:
        """Which buttons can be pressed."""
        self.track_button.setEnabled(allowed)
        self.go_on_button.setVisible(can_go_on and allowed)
        self.divisions.setEnabled(allowed)
        self.save_button.setEnabled(allowed)

    def show_verdict(self, verdict: str, text: str) -> None:
        self.verdict.say(text, verdict)

    def show_frame(
        self,
        result: FrameResult | None,
        *,
        tracked: bool = False,
        colours: Mapping[int, int] | None = None,
    ) -> None:
        """The cells of a frame, and what happened in it; None for one that was not tracked.

        tracked : whether there are other frames to look at.
        colours : of the cells, see ``colour_indices``.
        """
        for widget in (self.frame, self.save_button):
            widget.setVisible(tracked)
        self.table.setVisible(result is not None and result.mesh is not None)
        if result is None:
            self.frame.setText("not tracked at this time")
            return
        if result.mesh is None:
            self.frame.setText(result.message)
            return
        self.table.show_rows(measure_cells(result.mesh), colours)
        cells = counted(len(result.cells), "cell")
        words = [f"time {result.frame}: {cells}", *_told(result)]
        self.frame.setText("; ".join(words))

    def _ask(self) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Folder for the frames")
        if folder:
            self.save.emit(folder)


def _told(result: FrameResult) -> Sequence[str]:
    return [event.text for event in result.events] + [result.message] * bool(result.message)
