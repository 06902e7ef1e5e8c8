"""What runs beside the window: one long task at a time, and short functions.

Nothing in a thread knows of a widget or of Qt, and no thread calls one: the main thread looks a few
times a second and shows what it finds. A slow viewer gets fewer states, not a queue. The threads
are Python's own: Qt's have as many places as there are cores, for all that runs in napari, and end
the process if one of them is still at work when the application goes.
"""

from __future__ import annotations

import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from napari.utils import progress
from psygnal import Signal
from qtpy.QtCore import QObject, QTimer

from ..errors import TOLD, InputError, Stopped
from .calm import Calm
from .window_words import words_of

INTERVAL = 1 / 15  # s between two looks at a task
LONGEST_REST = 0.5  # s that a slow viewer is left alone, at most
_LOOK_EVERY = 10  # ms, for the result of a function
# They are kept: to start one waits for it, and where a fit is at work that takes a while.
_THREADS = ThreadPoolExecutor(32, "deltaMic")


@dataclass(frozen=True)
class Outcome:
    """How a fit or tracking ended, also in plain words.

    message : its first line is the verdict; each of those after it is a remark.
    """

    verdict: Literal["converged", "ended", "done", "stopped", "failed"]
    message: str


class Task:
    """A long task. Its thread runs ``steps``; all else belongs to the main thread.

    Attributes
    ----------
    title : what runs, as in "a fit is running".
    kept : what closing the window would leave of it; '' where nobody need be asked.
    gives_way : whether it ends where another task is to start.
    stage : what the thread is doing, in words.
    """

    title = ""
    kept = ""
    gives_way = False
    share: float | None = None  # of it that is done, where that is known

    def __init__(self) -> None:
        self.running = True  # until its end was told, or it was closed
        self.stopping = self.paused = False
        self.stage = ""
        self.done = False  # by the thread, last
        self.outcome: Any = None
        self.remarks: deque[Warning] = deque()  # for users

    def steps(self) -> Generator[None, None, Any]:
        """Run in the thread; it can be stopped where it yields, and returns the outcome."""
        raise NotImplementedError

    def failed(self, error: Exception) -> Any:
        """The outcome if the thread, or showing its results, raised an error."""
        return words_of(error)

    def look(self) -> None:
        """Show what there is."""

    def end(self, outcome: Any) -> None:
        """Take the outcome: that of ``steps``, or of ``failed``; None if it was stopped."""

    def stop(self) -> None:
        """Stop it where it next yields."""
        self.stopping = True

    def step(self, text: str) -> None:
        """Note in the thread what is done, if it is another thing.

        Raises where it was stopped, for what cannot yield.
        """
        if self.stopping:
            raise Stopped
        self.stage = text or self.stage

    def close(self) -> None:
        """End it without callbacks; its thread may run on for a while, but holds no widget."""
        self.stop()
        self.running = False
        for name in [name for name in vars(self) if name.startswith("_on_")]:
            setattr(self, name, _nobody)


class Question(Task):
    """A task made from one generator function; it ends when another task starts.

    Parameters
    ----------
    steps : called with the question, for its steps; see :meth:`Task.steps`.
    on_end : called with the answer, or with why there is none; with None where it was stopped.
    shape : of the image, which tells how much memory is needed.

    Attributes
    ----------
    found : what its thread has found so far.
    """

    gives_way = True

    def __init__(
        self,
        title: str,
        steps: Callable[[Question], Generator[None, None, Any]],
        on_end: Callable[[Any], None],
        shape: Sequence[int] | None = None,
    ) -> None:
        super().__init__()
        self.title, self.stage = title, "preparing"
        self._steps, self._shape = steps, shape
        self.found: list[Any] = []
        self._on_end = on_end

    def steps(self) -> Generator[None, None, Any]:
        """What the thread runs."""
        return self._steps(self)

    def failed(self, error: Exception) -> str:
        return words_of(error, self._shape)

    def end(self, outcome: Any) -> None:
        self._on_end(outcome)


class Work(QObject):
    """The one task under way: fits, tracking, evidence and measurements take turns."""

    changed = Signal()  # a task began, or ended
    looked = Signal()  # at the task under way
    remarked = Signal(object)  # a warning of its thread

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.interval = INTERVAL  # s between two looks
        self.task: Task | None = None
        self._activity: Any = None  # in napari's activity dock
        self._calm = Calm()
        self._timer = one_shot(self, self._tick)

    @property
    def occupied(self) -> str:
        """A text on what runs and must be stopped first; '' if another task can start."""
        task = self.task
        if task is None or task.gives_way:
            return ""
        return f"{task.title} already: stop it first"

    def start(self, task: Task) -> None:
        """Start a task. InputError if another one runs that does not give way."""
        if self.occupied:
            raise InputError(self.occupied)
        if self.task is not None:
            self.stop()
        self.task = task
        self._calm.begin()
        self._activity = progress(total=0, desc=f"deltaMic: {task.title}")
        self.changed.emit()
        _THREADS.submit(_run, task)
        self._timer.start(0)

    def stop(self) -> None:
        """End the task; what it reached is kept. One that gives way ends before its thread does."""
        task = self.task
        if task is not None:
            task.stop()
            self.looked.emit()  # whoever shows the task says so at once
            if task.gives_way:
                self._end(task, None)

    def pause(self, paused: bool) -> None:
        if self.task is not None:
            self.task.paused = paused

    def look_at_most(self, often: float) -> None:
        """Set how often per second the main thread looks, at most."""
        self.interval = 1 / often

    def close(self) -> None:
        """End the task, without callbacks."""
        with suppress(RuntimeError):  # the application may have ended before
            self._timer.stop()
        task, self.task = self.task, None
        if task is not None:
            task.close()
        self._close_activity()

    def _tick(self) -> None:
        task, began = self.task, time.monotonic()
        if task is None:
            return
        done, outcome = task.done, None
        try:
            while task.remarks:
                self.remarked.emit(task.remarks.popleft())
            task.look()
            self.looked.emit()
            outcome = task.outcome
        except Exception as error:  # what cannot be shown should not go on unseen
            task.stop()
            done, outcome = True, task.failed(error)
        if task is not self.task:
            return  # it was closed meanwhile
        if done:  # in a slot of its own: its last state has just been shown
            QTimer.singleShot(0, partial(self._ended, task, outcome))
        else:
            # Called when the viewer has drawn what it was given.
            QTimer.singleShot(0, partial(self._again, began))

    def _again(self, began: float) -> None:
        if self.task is not None and not self._timer.isActive():
            # Drawing without a GPU takes the cores that the task needs.
            rest = rest_after(time.monotonic() - began)
            self._timer.start(round(1000 * max(self.interval, rest)))

    def _ended(self, task: Task, outcome: Any) -> None:
        if task is self.task:
            self._end(task, outcome)

    def _end(self, task: Task, outcome: Any) -> None:
        self._timer.stop()
        self.task, task.running = None, False
        self._close_activity()
        task.end(outcome)
        self.changed.emit()

    def _close_activity(self) -> None:
        self._calm.end()
        activity, self._activity = self._activity, None
        if activity is not None:
            activity.close()


def one_shot(parent: QObject, slot: Callable[[], None], wait: int = 0) -> QTimer:
    """A timer that calls a slot once, ``wait`` ms after it was last started."""
    timer = QTimer(parent)
    timer.setSingleShot(True)
    timer.setInterval(wait)
    timer.timeout.connect(slot)
    return timer


def _nobody(*news: Any) -> None:
    """Called instead of callbacks of a closed task."""


def rest_after(drawing: float) -> float:
    """The pause (s) that a viewer is given that took ``drawing`` (s) to draw."""
    # Ten updates a second come first, as long as the task gets a quarter of the cores.
    return min(2 * drawing, max(0.1 - drawing, 0.3 * drawing), LONGEST_REST)


def _run(task: Task) -> None:
    """Run a task; what its thread does."""
    steps, outcome = task.steps(), None

    def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, TOLD):
            task.remarks.append(message)

    with warnings.catch_warnings():
        warnings.filterwarnings("always", category=UserWarning)
        warnings.showwarning = show
        try:
            while not task.stopping and threading.main_thread().is_alive():
                next(steps)
            steps.close()
        except StopIteration as end:
            outcome = end.value
        except Exception as error:
            outcome = None if task.stopping else task.failed(error)
    task.outcome = outcome
    task.done = True


class Background(QObject):
    """Runs one function at a time in a thread; of several asked for, the last one counts.

    A function that runs cannot be interrupted: its result is dropped, and the latest one asked
    for starts when it has ended. Made and used on the main thread, where all callbacks are
    called. After ``close`` none is, and nothing is held but what still runs.

    Parameters
    ----------
    on_error : called with a sentence in plain words.
    """

    def __init__(self, on_error: Callable[[str], None]) -> None:
        super().__init__()
        self._on_error: Callable[[str], None] | None = on_error
        self._call: Future[Any] | None = None
        self._then: Callable[[Any], None] | None = None  # None: nobody awaits what runs
        self._next: tuple[Callable[[], Any], Callable[[Any], None]] | None = None
        self._soon: Callable[[], None] | None = None
        self._waiting = one_shot(self, self._waited)
        self._timer = QTimer(self)
        self._timer.setInterval(_LOOK_EVERY)
        self._timer.timeout.connect(self._look)

    @property
    def busy(self) -> bool:
        """Whether a result is still to come."""
        return any(one is not None for one in (self._then, self._next, self._soon))

    def soon(self, ask: Callable[[], None], wait: int) -> None:
        """Call ``ask`` on the main thread, unless this is called again within ``wait`` ms.

        It replaces what is awaited.
        """
        if self._on_error is not None:
            self.drop()
            self._soon = ask
            self._waiting.start(wait)

    def ask(self, work: Callable[[], Any], then: Callable[[Any], None]) -> None:
        """Run a function without arguments, and then another one with what it returned.

        The first must not know of any widget.
        """
        if self._on_error is not None:
            self._then, self._next = None, (work, then)
            self._look()

    def drop(self) -> None:
        """Drop what is under way: its result is no longer wanted."""
        self._then = self._next = self._soon = None

    def close(self) -> None:
        """Make no further calls."""
        self.drop()
        with suppress(RuntimeError):  # the application may have ended before
            self._timer.stop()
            self._waiting.stop()
        self._call = self._on_error = None

    def _waited(self) -> None:
        ask, self._soon = self._soon, None
        if ask is not None:
            ask()

    def _look(self) -> None:
        """Hand over the result of a function that has ended, and start the last one asked for."""
        call = self._call
        if call is not None and not call.done():
            return
        self._timer.stop()
        self._call = None
        try:
            if call is not None:
                self._tell(call)
        finally:
            if self._call is None and self._next is not None:
                (work, self._then), self._next = self._next, None
                self._call = _THREADS.submit(work)
                self._timer.start()

    def _tell(self, call: Future[Any]) -> None:
        then, self._then, error = self._then, None, call.exception()
        if then is not None and error is None:
            then(call.result())
        elif then is not None and isinstance(error, Exception) and self._on_error is not None:
            self._on_error(words_of(error))
