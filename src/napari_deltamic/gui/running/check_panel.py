"""How a fit went: its grade, what is shown of it, where it is wrong, and what can be corrected."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from qtpy.QtWidgets import QGroupBox, QLabel, QVBoxLayout, QWidget

from ...common.words import counted
from ...fitting.history import History
from ...results.judged import Judged, told
from ...results.moved_numbers import MovedNumber, moved_numbers
from ..document import VIEWS, Document
from ..record import Record
from ..widgets import Fold, Note, Signal, button, filled, narrow_box, row
from ..window_words import for_window
from .edits import Edits
from .gain_curve import GainCurve
from .history_bar import HistoryBar
from .sculpt_tool import EditBar
from .worker import Snapshot

_SLICES = {"XY": (0, 1, 2), "XZ": (1, 0, 2), "YZ": (2, 0, 1)}
_TITLE = "4  Check"
_JUDGING = "Judging the shapes ..."
_SCALE = (
    "Measured minus rendered; the colour bar is in standard deviations of the noise. Green is "
    "brighter than rendered, magenta darker."
)
# Of an image whose pixels are others than those that were fitted, or that lies elsewhere.
_GOES_ON = {
    "pixels": "The fit goes on with the earlier pixels of the image; the next one takes those that "
    "it has now.",
    "place": "The fit goes on where the image was; the next one takes the place of the image.",
}
_FITTED = {
    "pixels": "Fitted to other pixels than the image has now: fit again for a grade.",
    "place": "Fitted where the image no longer lies: move it back, or fit again for a grade.",
}


class CheckPanel(QGroupBox):
    """Shows how a fit went, and what can be done with it."""

    fit_again = Signal()  # with all that a fit can estimate

    def __init__(self, doc: Document, edits: Edits, control: Any, parent: QWidget) -> None:
        super().__init__(_TITLE, parent)
        self._doc = doc
        self._of_other_fit = False  # whether the note is about a fit of another image, which runs
        self._offset = 0  # iterations of the runs before the present one
        self.away, self.away_row = Note(self, "fair"), QWidget(self)
        tip = "Move the slider to the time of the result."
        self.away_go = button("Go there", tip, self._go_to_time, self)
        self.other_image = Note(self, "fair", style="font-weight: bold;")
        self.rescued, self.rescued_row = Note(self, "fair"), QWidget(self)
        tip = "Show the results of the chosen image instead; this result is then lost."
        self.let_go = button("Let it go", tip, doc.let_go_rescued, self)
        self.verdict, self.grade = Note(self, style=""), Note(self, style="font-weight: bold;")
        tip = "Go to where the image differs most from the rendered one."
        self.worst = button("Worst place", tip, self.go_to_worst, self)
        tip = "Go to where the surface moves most."
        self.moving = button("Show where the surface still moves", tip, self.go_to_moving, self)
        self.stray = Note(self)
        self.stray_row = QWidget(self)
        self._next_stray, self._grading = 0, False
        self.stray_go = button("Show", "Go to the next of them.", self._go_to_stray, self)
        tip = "Add a point for the next fit in each of them where a cell can start."
        self.stray_add = button("Add", tip, self._add_strays, self)
        tip = (
            "Fit once more from these cells, and also estimate how wide the PSF is and how bright "
            "each part of the membranes is."
        )
        title = "Fit again: estimate PSF and brightness"
        self.again = button(title, tip, self.fit_again, self)
        self.remarks = Fold("", Note(), self)
        self.note = Note(self)
        self.edit = EditBar(doc, control, edits, self)
        self.history = HistoryBar(doc, edits, control, self)
        self.curve = GainCurve(self)
        self.numbers = LiveNumbers(self)
        tip = (
            "<b>rendered</b>: what the microscope would see of the present surfaces. "
            f"<b>residual</b>: {_SCALE}"
        )
        self.view = narrow_box(self, "what is shown", tip, VIEWS, 5)
        self.scale = Note(self)  # of the residual, to which napari's bar gives no unit
        tip = "Look at slices across another axis."
        self.slice = narrow_box(self, "slices", tip, _SLICES, 3)
        self._lay_out()
        self._connect()
        self._show_slice()
        self._show()

    @property
    def strays(self) -> Sequence[Any]:
        """The bright things in the image that no cell explains."""
        return () if self._judged is None else self._judged.strays

    @property
    def _judged(self) -> Judged | None:
        """What is known about the result if it belongs to the image as it is now; else None."""
        doc = self._doc
        return None if doc.result is None or doc.other else doc.result.judged

    def tell(self, text: str) -> None:
        """Show in a line what came of something that the user did."""
        doc = self._doc
        self._of_other_fit = doc.running and bool(doc.name_of_other(doc.record))
        self.note.say(text)
        self._hide_if_empty()

    def go_to_worst(self) -> None:
        """Move the view to where the image differs most from the rendered one."""
        spots, link = () if self._judged is None else self._judged.found.spots, self._doc.link
        if spots and link is not None:
            worst, kind = spots[0], "brighter" if spots[0].z > 0 else "darker"
            place = ", ".join(f"{at:.1f}" for at in worst.position)
            link.go_to(worst.position)
            self.tell(
                f"At ({place}) {link.frame.length} the image is {kind} than rendered, by "
                f"{abs(worst.z):.0f} standard deviations of the noise."
            )

    def go_to_moving(self) -> None:
        """Move the view to where the surface still moves, as the verdict says."""
        record, link = self._doc.record, self._doc.link
        state = None if record is None else record.state
        if state is not None and state.moving is not None and link is not None:
            link.go_to(state.moving)

    def _go_to_time(self) -> None:
        if self._doc.link is not None:
            self._doc.link.go_to_time()

    def _show_time(self, event: Any = None) -> None:
        """Say to which time the panel belongs if the viewer shows another one."""
        link = None if self.edit.isHidden() else self._doc.link
        time = "" if link is None or link.at_time else link.time_in_words
        self.away.say(f"This is of {time}, not of the time shown." if time else "")
        self.away_row.setVisible(bool(time))

    def _connect(self) -> None:
        doc = self._doc
        self.view.currentTextChanged.connect(doc.look)
        self.slice.activated.connect(self._turn)
        doc.listen(doc.viewer.dims.events.current_step, self._show_time)
        for turned in (doc.viewer.dims.events.order, doc.viewer.dims.events.ndim):
            doc.listen(turned, self._show_slice)
        doc.noted.connect(self.tell)
        doc.unnoted.connect(self._forget_note)
        doc.work.changed.connect(self._work_changed)
        doc.began.connect(self._began)
        doc.shown.connect(self._show_snapshot)
        doc.view_changed.connect(self._show_view)
        doc.grading.connect(self._grade)
        for signal in (doc.image.changed, doc.result_changed, doc.judged, doc.ended):
            signal.connect(self._show)
        doc.image.replaced.connect(partial(self.note.say, ""))  # it is of the image before
        doc.image.looked.connect(self._look_again)
        doc.looked_back.connect(self._look_back)

    def _work_changed(self) -> None:
        if self._doc.running:  # which just began, or else nothing of it is lost
            self.note.say("")
            self._show()

    def _show(self) -> None:
        """Show all that is known about the running fit, or else about the chosen image."""
        doc, record = self._doc, self._doc.record
        lost = doc.rescued
        name = "" if lost is None else lost.link.image_layer.name
        self.rescued.say(
            f"Of '{name}', which was removed: export what you need; the next fit takes its place."
            if name
            else ""
        )
        self.rescued_row.setVisible(lost is not None and doc.image.layer is not None)
        if self._of_other_fit and not doc.running:
            self.note.say("")
        ended = None if doc.running else record
        words = ("", "") if ended is None else ended.words
        if ended is not None and ended.by_hand:
            words = "", words[1]  # how the fit ended is no praise of what is shown
        self._show_verdict(*words)
        self.other_image.say(self._other_in_words())
        valid = ended if doc.in_sight and not doc.other else None
        self._show_grade(valid)
        state = None if valid is None else valid.state
        self.moving.setVisible(state is not None and state.moving is not None)
        known = record is not None and (record.state is not None or (doc.running and doc.begun))
        shown = known and doc.in_sight
        self.curve.setVisible(shown)
        other = doc.name_of_other(record)
        # What the fit of another image has come to is not to be seen.
        for part in (self._looks, self.edit, self.history):
            part.setVisible(shown and not other)
        if other:
            self.edit.use(None)
        self._show_view()
        title = f"{_TITLE}: fit of {other}" if other else _TITLE
        self.setTitle(record.link.with_time(title) if record is not None and shown else title)
        self._show_time()
        if ended is not None and ended.reached is not None:
            history, moments = ended.reached.history, ended.timeline.moments
            newest = moments[-1].iteration if moments else 0
            self._offset = newest and newest - (history.first + len(history.loss) - 1)
            self._show_curve(history)
            self.numbers.show_numbers(moved_numbers(*ended.of_fit()))
        if not shown:
            self.numbers.hide()
        self._hide_if_empty()

    def _look_again(self) -> None:
        """Update if the image has become another than the fitted one, or the same again."""
        if self.other_image.text() != self._other_in_words():
            self._show()

    def _other_in_words(self) -> str:
        """A text if the image is no longer as it was fitted; else ''."""
        doc = self._doc
        other = doc.other if doc.in_sight else ""
        if not other:
            return ""
        if other != "size":
            return (_GOES_ON if doc.running else _FITTED)[other]
        size = doc.other_size
        if doc.running:
            return f"The fit goes on with {size}; the next one takes the size of the image."
        return f"Fitted with {size}, but its voxel size is now different: fit again for a grade."

    def _began(self, fresh: bool) -> None:
        moments = self._doc.timeline.moments
        self._offset = 0 if fresh or not moments else moments[-1].iteration
        self._show()

    def _show_snapshot(self, snapshot: Snapshot) -> None:
        history = self._doc.run.history
        self._show_curve(history)
        if self._doc.moment is None:
            self.numbers.show_numbers(moved_numbers(snapshot.state, snapshot.job))

    def _show_curve(self, history: History) -> None:
        noted = {m.iteration - self._offset for m in self._doc.timeline.moments if m.note}
        self.curve.show_losses(history.loss, history.level, history.first, noted)

    def _show_view(self) -> None:
        """Show which view is chosen, and how to read it."""
        self.view.setCurrentText(self._doc.view)
        self.scale.say(
            _SCALE if self._doc.view == "residual" and self.edit.isVisibleTo(self) else ""
        )

    def _show_verdict(self, verdict: str, text: str) -> None:
        """Show how the fit ended, in the first line of a text, and its other lines as remarks."""
        said, *remarks = text.split("\n")
        self.verdict.say(said, verdict)
        self.remarks.set_title(counted(len(remarks), "remark"))
        self.remarks.content.say("\n".join(remarks))
        self.remarks.unfold(False)
        self.remarks.setVisible(bool(remarks))

    def _grade(self, waits: bool) -> None:
        self._grading = waits
        self._show()

    def _show_grade(self, record: Record | None) -> None:
        """Show how well the shapes explain the image, and what can be done about it."""
        known = None if record is None else record.judged
        grade = "" if known is None else known.verdict.grade
        length = "" if record is None else record.link.frame.length
        stopped = record is not None and record.words[0] == "stopped"
        waits = _JUDGING if self._grading and record is not None else ""
        text = waits if known is None else told(known, length, stopped=stopped)
        if record is not None and record.by_hand:  # no fit has looked at these shapes
            text, grade = "Changed by hand: continue the fit.", ""
        if text != waits and self._doc.moment is not None:
            text = f"Of the end: {text}"
        self.grade.say(text, grade)
        self.worst.setVisible(known is not None and bool(known.found.spots))
        fit = None if record is None or record.job is None else record.job.settings.fit
        all_estimated = fit is not None and fit.fit_psf and fit.density == "smooth"
        self.again.setVisible(grade in ("fair", "poor") and not all_estimated)
        n = 0 if known is None else len(known.strays)
        self.stray_row.setVisible(n > 0)
        places = "bright place has" if n == 1 else "bright places have"
        self.stray.say(f"{n} {places} no cell" if n else "")

    def _look_back(self) -> None:
        """Mark the moment that is shown, and say whether the grade is of another one."""
        doc, moment = self._doc, self._doc.moment
        self.curve.show_moment(None if moment is None else moment.iteration - self._offset)
        if not doc.running:
            self._show_grade(doc.record if doc.in_sight and not doc.other else None)

    def _show_slice(self, event: Any = None) -> None:
        """Show which slices the viewer has, whoever chose them; nothing for other orders."""
        dims = self._doc.viewer.dims
        first = dims.ndim - 3
        shown = {axis - first for axis in dims.order[-2:]}
        names = (name for name, order in _SLICES.items() if set(order[1:]) == shown)
        self.slice.setCurrentIndex(self.slice.findText(next(names, "")))

    def _turn(self, index: int) -> None:
        """Show slices across another axis; axes before Z, Y, X stay as they are."""
        dims = self._doc.viewer.dims
        first = dims.ndim - 3
        order = _SLICES[self.slice.currentText()]
        dims.ndisplay = 2
        dims.order = (*range(first), *(first + axis for axis in order))
        self._doc.viewer.reset_view()

    def _go_to_stray(self) -> None:
        strays, link = self.strays, self._doc.link
        if strays and link is not None:
            link.go_to(strays[self._next_stray % len(strays)].position)
            self._next_stray += 1

    def _add_strays(self) -> None:
        things = [(stray.middle, stray.position) for stray in self.strays]
        if things:
            self._doc.guarded(lambda: self._doc.points_wanted.emit(things))

    def _forget_note(self, text: str) -> None:
        if self.note.text() == for_window(text):
            self.tell("")

    def _hide_if_empty(self) -> None:
        """Show the panel only while it has something to say."""
        parts = (self.curve, self.verdict, self.note)
        self.setHidden(all(part.isHidden() for part in parts))

    def _lay_out(self) -> None:
        self._looks = QWidget(self)
        row(QLabel("show", self), (self.view, 2), (self.slice, 1), of=self._looks)
        row((self.away, 1), self.away_go, of=self.away_row)
        row((self.rescued, 1), self.let_go, of=self.rescued_row)
        row((self.stray, 1), self.stray_go, self.stray_add, of=self.stray_row)
        ended = row((self.verdict, 1), self.worst)
        whose = self.rescued_row, self.away_row, self.other_image
        said = self.grade, self.again, ended, self.moving, self.note
        more = self.remarks, self.stray_row
        shown = self._looks, self.scale, self.curve, self.history, self.edit, self.numbers
        filled(QVBoxLayout(self), *whose, *said, *more, *shown)


class LiveNumbers(Fold):
    """The fitted parameters of PSF and effects: at the start, and now."""

    def __init__(self, parent: QWidget | None = None) -> None:
        self.table = QLabel()
        super().__init__("Fitted parameters", self.table, parent)
        self.show_numbers([])

    def show_numbers(self, numbers: list[MovedNumber]) -> None:
        self._numbers = numbers
        rows = [("", "start", "now"), *self.texts()]
        cells = ("".join(f"<td align=right>&nbsp; {text}</td>" for text in row) for row in rows)
        self.table.setText(f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>")
        self.setVisible(bool(numbers))

    def texts(self) -> list[tuple[str, str, str]]:
        return [number.texts for number in self._numbers]
