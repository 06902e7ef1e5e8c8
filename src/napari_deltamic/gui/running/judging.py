"""Judges fits that have ended, and shows the images that tell where they are right and wrong."""

from __future__ import annotations

from functools import partial

from qtpy.QtCore import QObject

from ...fitting import FitState
from ...results.judged import Compared, Spread, compared, judge
from ..document import Document, Record
from .worker import Snapshot


class Judging(QObject):
    """Judges results in the background, and shows what is rendered where it is wanted."""

    def __init__(self, doc: Document, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._doc = doc
        self._asked: tuple[Record, FitState | None] | None = None
        self._background = doc.background(self._add, doc.warned.emit)
        self._spread = Spread()
        doc.shown.connect(self._show_snapshot)
        doc.began.connect(self._began)
        doc.result_changed.connect(self._judge)
        doc.image.changed.connect(self._place)
        doc.view_changed.connect(self._place)

    @property
    def busy(self) -> bool:
        return self._background.busy

    def _began(self, fresh: bool) -> None:
        if self._doc.running:
            self._background.drop()  # what was found is of an earlier fit

    def _show_snapshot(self, snapshot: Snapshot) -> None:
        """What a fit that runs has rendered, if it has."""
        record = self._doc.record
        if snapshot.rendered is not None and record is not None and not self._background.busy:
            self._asked = (record, None)
            self._background.ask(partial(compared, snapshot.rendered, snapshot.job, self._spread))

    def _judge(self) -> None:
        """Render the result, and look at what it leaves unexplained."""
        record = self._doc.result
        if record is not None and not self._doc.running and record.judged is None:
            self._asked = (record, record.state)
            self._background.ask(partial(judge, *record.of_fit(), self._spread))

    def _add(self, images: Compared) -> None:
        asked, self._asked = self._asked, None
        if asked is None or (asked[1] is not None and asked[0].state is not asked[1]):
            return
        record, doc = asked[0], self._doc
        record.link.take_images(images.rendered, images.residual)
        if images.judged is not None:
            record.judge(images.judged)
            if record is doc.record:
                doc.judged.emit()
        self._place()

    def _place(self) -> None:
        """Each image is shown as its own record has it."""
        for record in self._doc.records.values():
            own = record is self._doc.record
            record.link.look(self._doc.view if own else "image")
