"""What fits of one image have reached, and what of it can be changed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..fitting import FitState
from ..fitting.by_hand import is_again, is_by_hand
from ..fitting.history import History
from ..fitting.job import FitInput, following
from ..measure import measure_cells
from ..results.judged import Judged
from ..results.session_parts import SavedResult
from ..results.timeline import Timeline
from .viewing.viewer_link import ViewerLink

_KEPT = 5  # results that undo may lead back to; chosen: each holds images


@dataclass(frozen=True, eq=False)
class Fitted:
    """A result: what a fit ended with, or what was made of that by hand."""

    state: FitState
    job: FitInput
    history: History
    seconds: float
    words: tuple[str, str]


@dataclass(eq=False)
class Record:
    """What fits of one image have reached.

    words : how the last one ended: in a word, and in text.
    reached : the result; None before there is one.
    rows : measurements of its cells.
    judged : how good it is, once that is known.
    pixels : gives the voxels of the layer that were fitted, as long as they are there.
    done, undone : changes by hand that can be undone, and done again.
    fitted : what the last fits ended with, whatever was changed by hand since.
    saved : the result that a session file holds; None for none.
    """

    link: ViewerLink
    timeline: Timeline = field(default_factory=Timeline)
    words: tuple[str, str] = ("", "")
    reached: Fitted | None = None
    rows: Sequence[Mapping[str, Any]] = ()
    judged: Judged | None = None
    pixels: Callable[[], Any] | None = None
    done: list[Any] = field(default_factory=list)
    undone: list[Any] = field(default_factory=list)
    fitted: deque[Fitted] = field(default_factory=lambda: deque(maxlen=_KEPT))
    saved: Fitted | None = None

    @property
    def state(self) -> FitState | None:
        """The state of the result; None before there is one."""
        return None if self.reached is None else self.reached.state

    @property
    def job(self) -> FitInput | None:
        """The job that led to the result; None before there is one."""
        return None if self.reached is None else self.reached.job

    @property
    def unsaved(self) -> bool:
        """Whether there is a result that no session file holds."""
        return self.reached is not None and self.reached is not self.saved

    @property
    def by_hand(self) -> bool:
        """Whether the result was changed by hand after the fit."""
        return self.state is not None and is_by_hand(self.state)

    def of_fit(self) -> tuple[FitState, FitInput]:
        """State and job of the result. InputError if there is none."""
        if self.reached is None:
            raise InputError("there is no result yet: run a fit first")
        return self.reached.state, self.reached.job

    def begin(self, fresh: bool) -> None:
        """A fit has begun; fresh : from seeds, not from a state of the last fit."""
        self.words, self.judged = ("", ""), None
        if fresh:
            self.timeline = Timeline()
            self.forget()
        else:
            self.timeline.go_on()

    def reopen(self, saved: SavedResult) -> None:
        """Take over how an earlier fit went, and how it ended."""
        self.timeline, self.words = Timeline(saved.moments), (saved.verdict, saved.message)
        self.forget()

    def forget(self) -> None:
        """Forget what undo and redo would lead back to."""
        self.fitted.clear()
        self.done, self.undone = [], []

    def end(self, verdict: str, text: str) -> None:
        self.words = verdict, text

    def show(self, state: FitState, note: str = "", *, passing: bool = False) -> None:
        """Show a state of the fit; note : what the user changed to get there."""
        self.timeline.add(state, note)
        self.link.show_mesh(state.mesh, passing=passing)

    def take(self, state: FitState, job: FitInput, history: History, seconds: float) -> None:
        """Take a state as the result, of which the quality is not known yet."""
        self.reached = Fitted(state, job, history, seconds, self.words)
        self.rows, self.judged = measure_cells(state.mesh), None
        if not self.by_hand:
            self.fitted.append(self.reached)

    def take_changed(self, state: FitState, note: str) -> None:
        """Take a state that was changed by hand, or the end of a fit if undo leads back to it."""
        before, again = self.reached, [one for one in self.fitted if is_again(state, one.state)]
        if again:
            before = again[-1]
            state = replace(before.state, pinned=state.pinned)
            self.fitted.remove(before)
            self.words = before.words
        assert before is not None, "what is changed is the result"
        job = before.job if again else following(before.job, state)
        self.show(state, note)
        self.take(state, job, before.history, before.seconds)

    def pin(self, pinned: NDArray[np.bool_]) -> None:
        """Note which vertices of the result are pinned, (V,), for a fit that goes on."""
        if self.reached is not None:
            state = replace(self.reached.state, pinned=pinned)
            self.reached = replace(self.reached, state=state)

    def judge(self, judged: Judged) -> None:
        """Take over the verdict on the result, with the grades of each cell."""
        self.judged = judged
        rows = [{**row, **judged.cells.get(int(row["region"]), {})} for row in self.rows]
        if self.link.frame.box is not None:  # the image that was fitted is a region of the user's
            for row in rows:
                note = str(row.get("note") or "")
                row["note"] = note.replace("border of the image", "border of the region")
        self.rows = rows


@dataclass(frozen=True, eq=False)
class Present:
    """What there is to change.

    running : whether a fit goes on from it.
    changes : the number of the last change that the state includes, while a fit runs.
    """

    state: FitState
    job: FitInput
    running: bool
    changes: int = 0
