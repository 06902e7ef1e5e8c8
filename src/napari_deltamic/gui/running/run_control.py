"""Drives a fit: its start and end, what it shows, what is changed in it; and its verdict."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...accuracy.experience import Learned
from ...accuracy.forecast import Forecast
from ...accuracy.outlook import expected
from ...common.words import counted, duration
from ...errors import InputError
from ...fitting import Change, FitState
from ...fitting.by_hand import changed_by_hand
from ...fitting.job import FitInput, scene_with
from ...fitting.pending import usable
from ...geometry import Mesh
from ...results.judged import Compared, Spread, compared, judge
from ...runs.settings import NEAR_LEVELS
from ..document import Document
from ..record import Record
from ..window_words import attempt
from ..work import Outcome
from .worker import FitRun, Snapshot


class RunControl:
    """Runs fits, one at a time, from the document to the viewer."""

    def __init__(self, doc: Document) -> None:
        self._doc = doc
        self._asked: list[tuple[int, str]] = []  # changes by number, until the fit has them
        self._lets_go = False

    def start(self) -> None:
        """Start a fit of what is chosen; if something is missing, the user is told what."""
        if not self._doc.busy():
            attempt(self._start, self._doc.failed.emit)

    # ------------------------------------------------------------------- changes on the way

    def ask(self, change: Change, note: str, of: Mesh) -> int:
        """Ask the fit to continue from a change, made on a mesh; the note is told when it does.

        Snapshots include it from the number returned on.
        """
        number = int(self._doc.run.waiting.add(change, of))
        self._asked.append((number, note))
        return number

    def ask_shift(self, shift: NDArray[np.float64], note: str, of: Mesh) -> None:
        """Ask the fit to continue with its vertices moved, (V, 3) um."""
        self._asked.append((self._doc.run.waiting.shift(shift, of), note))

    def replace_result(self, state: FitState, note: str) -> None:
        """Take a state as the result: one changed by hand, or the fit's own again after undo."""
        record = self._doc.result
        if record is None:
            return
        record.take_changed(state, note)
        self._doc.result_changed.emit()
        now = "was changed by hand" if record.by_hand else "is that of the fit again"
        self._doc.noted.emit(f"{note}: the result {now}")

    def go_on_from(self, mesh: Mesh, optics: Any, pinned: NDArray[np.bool_] | None) -> None:
        """Start a fit from a state of the last one, with little blur. InputError if it cannot."""
        doc, record = self._doc, self._doc.result
        if doc.work.occupied:
            raise InputError(doc.work.occupied)
        if record is None or record.job is None:
            raise InputError("there is no fit of this image to go on from")
        link = record.link
        if link.image_layer not in doc.viewer.layers:
            raise InputError("the image of that fit is no longer open")
        fit = doc.settings.fit_settings().model_copy(update={"levels": NEAR_LEVELS})
        scene = scene_with(record.job.settings.scene, optics)
        # The seeds of that fit would not repeat this one.
        job = record.job.with_settings(fit=fit, scene=scene, seeds="")
        job = replace(job, mesh=mesh, optics=optics)
        some = pinned is not None and pinned.any()
        first = Change(mesh=mesh, pinned=pinned) if some else None
        doc.mend_link(record)
        self._launch(record, lambda: job, fresh=False, first=first)

    def hold(self, mesh: Mesh) -> None:
        """Show a mesh, whatever the fit does, until ``let_go``."""
        self._lets_go = False
        if self._doc.link is not None:
            self._doc.link.hold(mesh)

    def let_go(self) -> None:
        """Show the newest mesh again, as soon as the fit has adopted all changes."""
        self._lets_go = bool(self._asked)
        if self._doc.link is not None and not self._lets_go:
            self._doc.link.let_go()

    # ------------------------------------------------------------------------------------- runs

    def _start(self) -> None:
        doc = self._doc
        prepare, frame = doc.prepared()
        record = doc.record_for(frame)
        doc.finish_placing.emit(True)
        self._launch(record, prepare, fresh=True)

    def _launch(
        self,
        record: Record,
        prepare: Callable[[], FitInput],
        *,
        fresh: bool,
        first: Change | None = None,
    ) -> None:
        doc, self._asked = self._doc, []
        run = FitRun(
            prepare,
            partial(self._show, record),
            partial(self._ended, record),
            self._not_taken,
            partial(_after, doc.learned, doc.image.key()),
            first,
        )
        doc.start(run, record, fresh=fresh)

    def _show(self, record: Record, snapshot: Snapshot) -> None:
        doc, state = self._doc, snapshot.state
        doc.begin(record)
        note = self._taken_over(snapshot)
        record.show(state, note, passing=True)
        if self._lets_go:
            self.let_go()
        if note:
            doc.noted.emit(f"{note} from iteration {state.iteration}")
        doc.shown.emit(snapshot)

    def _taken_over(self, snapshot: Snapshot) -> str:
        """The notes of changes that the fit has adopted since the last snapshot."""
        notes = [note for number, note in self._asked if number <= snapshot.changes]
        self._asked = [(n, note) for n, note in self._asked if n > snapshot.changes]
        return ", ".join(dict.fromkeys(notes))

    def _not_taken(self, reason: str) -> None:
        self._asked = []
        self.let_go()
        self._doc.refuse(reason)

    def _ended(self, record: Record, outcome: Outcome) -> None:
        attempt(partial(self._end, record, outcome), self._doc.failed.emit)
        self._doc.attempt(self._doc.ended.emit)

    def _end(self, record: Record, outcome: Outcome) -> None:
        doc, run = self._doc, self._doc.run
        state, job = run.state, run.job
        doc.said.emit("")
        text, *remarks = outcome.message.split("\n")
        if state is not None:
            done = "" if "iteration" in text else f"{counted(state.iteration, 'iteration')}, "
            text += f" ({done}{duration(run.seconds)})"
        name = doc.name_of_other(record)
        if outcome.verdict == "failed" and name:
            doc.warned.emit(f"fit of {name}: {outcome.message}")
        elif outcome.verdict == "failed" and state is not None:
            doc.warned.emit(outcome.message)
        elif outcome.verdict == "failed":
            doc.failed.emit(outcome.message)
        if state is None or job is None:
            doc.result_changed.emit()  # of an earlier result, how good it is still holds
            return
        doc.begin(record)
        record.end(outcome.verdict, "\n".join([text, *remarks]))
        record.show(state)
        record.take(state, job, run.history, run.seconds)
        doc.result_changed.emit()
        late, notes = run.left, ", ".join(note for _, note in self._asked)
        self._asked = []
        if late is not None and (late.mesh is not None or late.optics is not None):
            usable(late, state.mesh, state.optics, job)
            self.replace_result(changed_by_hand(state, job, late), notes)
        elif late is not None and late.pinned is not None:
            record.pin(late.pinned)
        if self._lets_go:
            self.let_go()


def _after(learned: Learned, image: tuple[Hashable, ...], job: FitInput) -> Forecast | None:
    """The forecast of a job, corrected by earlier runs; None if there is none."""
    found = expected(job)
    return found and found.after(learned.about(found.kind, image))


class Judging:
    """Judges results in the background, and shows rendered images where wanted."""

    def __init__(self, doc: Document) -> None:
        self._doc = doc
        self.background = doc.background(self._failed)
        self._spread = Spread()
        self._asked_of: FitState | None = None  # that is being judged
        doc.shown.connect(self._show_snapshot)
        doc.began.connect(self._began)
        doc.result_changed.connect(self._judge)
        doc.image.changed.connect(self._image_changed)
        doc.image.looked.connect(self._place)
        doc.view_changed.connect(self._place)

    def _began(self, fresh: bool) -> None:
        if self._doc.running:
            self.background.drop()  # what was found is of an earlier fit

    def _show_snapshot(self, snapshot: Snapshot) -> None:
        """Show what a running fit has rendered, if anything."""
        record = self._doc.record
        if snapshot.rendered is not None and record is not None and not self.background.busy:
            work = partial(compared, snapshot.rendered, snapshot.job, self._spread)
            self.background.ask(work, partial(self._add, record, None))

    def _judge(self) -> None:
        """Render and judge the result, in the background."""
        record = self._doc.result
        under_way = self.background.busy and record is not None and record.state is self._asked_of
        if record is not None and not (self._doc.running or record.judged or under_way):
            self._asked_of = record.state
            self._doc.grading.emit(True)
            work = partial(judge, *record.of_fit(), self._spread)
            self.background.ask(work, partial(self._add, record, record.state))

    def _failed(self, text: str) -> None:
        self._doc.warned.emit(text)
        self._doc.grading.emit(False)

    def _image_changed(self) -> None:
        """Judge a result when its image is chosen, if another one was chosen when it ended."""
        self._place()
        self._judge()

    def _add(self, record: Record, state: FitState | None, images: Compared) -> None:
        """Take over images and verdict: of a result, or, without a state, of a running fit."""
        if state is not None and record.state is not state:
            return
        doc = self._doc
        self._place()  # first: where nothing is to be seen, no layers are made
        record.link.take_images(images.rendered, images.residual)
        if images.judged is not None:
            record.judge(images.judged)
            if record is doc.record:
                doc.judged.emit()

    def _place(self) -> None:
        """Show the images of the present record, and hide those of others."""
        for record in self._doc.records.values():
            own = record is self._doc.record and self._doc.in_sight
            own = own and record.link.of_chosen
            record.link.look(self._doc.view if own else "image")
