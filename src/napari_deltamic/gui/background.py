"""Work in background threads: a function of which only the latest counts, or a generator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from qtpy.QtCore import QObject
from superqt.utils import create_worker

from .attempt import words_of


# Both are QObjects, though they have no signals: what a thread sends to one that is gone is then
# dropped by Qt. To a plain object PySide6 brings it all the same, and crashes.
class Background(QObject):
    """Runs one function at a time in a thread; of several asked for, the last one counts.

    A function that runs cannot be interrupted: its result is dropped, and the latest one asked
    for starts when it has ended. Made and used on the main thread, where both callbacks are
    called. After ``close`` neither is, and nothing is held but what still runs.

    Parameters
    ----------
    on_result : called with what the function returned.
    on_error : called with a sentence in plain words.
    """

    def __init__(self, on_result: Callable[[Any], None], on_error: Callable[[str], None]) -> None:
        super().__init__()
        self._on_result: Callable[[Any], None] | None = on_result
        self._on_error: Callable[[str], None] | None = on_error
        self._worker: Any = None
        self._slots: tuple[tuple[Any, Callable[..., None]], ...] = ()
        self._next: Callable[[], Any] | None = None
        self._awaited = False  # the result of what runs

    @property
    def busy(self) -> bool:
        """Whether a result is still to come."""
        return self._awaited or self._next is not None

    def ask(self, work: Callable[[], Any]) -> None:
        """Run a function without arguments; it must not know of any widget."""
        if self._on_result is None:
            return
        self._next = work
        if self._worker is None:
            self._start()
        else:
            self._awaited = False

    def drop(self) -> None:
        """No result is wanted any more."""
        self._next, self._awaited = None, False

    def close(self) -> None:
        """Call nobody any more."""
        self.drop()
        self._disconnect()
        self._on_result = self._on_error = None

    def _start(self) -> None:
        work, self._next = self._next, None
        # Errors are caught in the thread: this library drops any RuntimeError without a word.
        worker: Any = create_worker(_caught, work, _start_thread=False, _ignore_errors=True)
        self._worker, self._awaited = worker, True
        self._slots = ((worker.returned, self._tell), (worker.finished, self._finish))
        for signal, slot in self._slots:
            signal.connect(slot)
        worker.start()

    def _tell(self, outcome: tuple[Any, str]) -> None:
        if not self._awaited:
            return
        self._awaited = False
        result, error = outcome
        if error and self._on_error is not None:
            self._on_error(error)
        elif not error and self._on_result is not None:
            self._on_result(result)

    def _finish(self) -> None:
        self._disconnect()
        if self._next is not None:
            self._start()

    def _disconnect(self) -> None:
        for signal, slot in self._slots:
            signal.disconnect(slot)
        self._slots = ()
        self._worker = None


class BackgroundSteps(QObject):
    """A generator in a thread: brings what it yields, and once what it returned.

    It can be stopped where it yields. Made and used on the main thread, where all is called back;
    nobody is after ``close``. Errors have to be caught in the generator: this library drops any
    RuntimeError without a word.

    Parameters
    ----------
    steps : the generator function; it must not know of any widget.
    arguments : of it.
    on_step : called with what it yields.
    on_end : called with what it returned; None if it was stopped.
    failed : makes what it would have returned where ``on_step`` raised; it is stopped then.
    on_warning : called with a warning and its category.
    """

    def __init__(
        self,
        steps: Callable[..., Any],
        arguments: Sequence[Any],
        on_step: Callable[[Any], None],
        on_end: Callable[[Any], None],
        failed: Callable[[Exception], Any],
        on_warning: Callable[[str, type[Warning]], None] | None = None,
    ) -> None:
        super().__init__()
        self._on_step, self._on_end, self._failed = on_step, on_end, failed
        self._on_warning = on_warning
        self._returned: Any = None
        self._worker: Any = create_worker(
            steps, *arguments, _start_thread=False, _ignore_errors=True
        )
        self._slots: tuple[tuple[Any, Callable[..., None]], ...] = (
            (self._worker.yielded, self._step),
            (self._worker.returned, self._note),
            (self._worker.warned, self._warn),
            (self._worker.finished, self._finish),
        )
        for signal, slot in self._slots:
            signal.connect(slot)

    def start(self) -> None:
        """Start the thread."""
        self._worker.start()

    @property
    def running(self) -> bool:
        """Whether it has been neither closed nor ended."""
        return bool(self._slots)

    @property
    def stopping(self) -> bool:
        """Whether it was asked to end."""
        return bool(self._worker.abort_requested)

    def stop(self) -> None:
        """End it where it next yields."""
        self._worker.quit()

    def close(self) -> None:
        """End it and call nobody any more."""
        if self.running:
            self._worker.quit()
            self._disconnect()

    def _step(self, step: Any) -> None:
        if not self.running:
            return
        try:
            self._on_step(step)
        except Exception as error:  # what cannot be shown should not go on unseen
            self._returned = self._failed(error)
            self._worker.quit()

    def _note(self, returned: Any) -> None:
        self._returned = returned

    def _warn(self, warning: tuple[Any, ...]) -> None:
        if self._on_warning is not None:
            self._on_warning(str(warning[0]), warning[1])

    def _finish(self) -> None:
        self._disconnect()
        self._on_end(self._returned)

    def _disconnect(self) -> None:
        for signal, slot in self._slots:
            signal.disconnect(slot)
        self._slots = ()


class BackgroundRun:
    """What a ``BackgroundSteps`` does for those that watch it: it is started, stopped and ended."""

    _thread: BackgroundSteps

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it has been neither closed nor ended."""
        return self._thread.running

    @property
    def stopping(self) -> bool:
        """Whether it was asked to end."""
        return self._thread.stopping

    def stop(self) -> None:
        """End it after the present iteration; what it reached is kept."""
        self._thread.stop()

    def close(self) -> None:
        """End it and call nobody any more."""
        self._thread.close()


def _caught(work: Callable[[], Any]) -> tuple[Any, str]:
    """What the function returns and '', or None and what went wrong."""
    try:
        return work(), ""
    except Exception as error:
        return None, words_of(error)
