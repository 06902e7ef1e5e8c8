"""What saves and opens sessions; files are written and read in the background."""

from __future__ import annotations

from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path

from qtpy.QtCore import QObject, QTimer
from qtpy.QtWidgets import QFileDialog, QWidget

from ...errors import InputError
from ...results.session_file import EXTENSION, Session, load_session, save_session
from ..attempt import attempt
from ..document import Document
from ..qt import QAction
from ..work import Background

_KIND = f"deltaMic session (*{EXTENSION})"


class SessionBar(QObject):
    """*Open session...* and *Save session...*.

    Parameters
    ----------
    capture : gives the session that is shown, and a remark about it ('' for none).
    restore : shows a session, step by step.
    doc : the document.
    parent : Qt's, over which files are asked for.
    """

    def __init__(
        self,
        capture: Callable[[], tuple[Session, str]],
        restore: Callable[[Session], Generator[None]],
        doc: Document,
        parent: QWidget,
    ) -> None:
        super().__init__(parent)
        self._shown_in = parent
        self._doc, self._capture, self._restore = doc, capture, restore
        doc.parts.append(self)
        self.open_action, self.save_action = QAction(self), QAction(self)
        self.open_action.setToolTip(
            "Open a .deltamic file: image, cells, settings, meshes, table and history come back "
            "as they were."
        )
        self.save_action.setToolTip(
            "Save image, cells, settings, meshes and history in one file. Of a 4D image, the time "
            "that is fitted; all of it where cells were tracked."
        )
        self._saving = Background(self._saved, self._not_saved)
        self._opening = Background(self._opened, self._not_opened)
        self._steps: Generator[None] | None = None  # that are left of showing a session
        self.open_action.triggered.connect(self._ask_open)
        self.save_action.triggered.connect(self._ask_save)
        self._show(saving=False, opening=False)

    @property
    def busy(self) -> bool:
        """Whether a file is being written or read."""
        return self._saving.busy or self._opening.busy or self._steps is not None

    def save(self, path: str) -> None:
        """Save what is shown now. InputError if there is nothing that could be saved."""
        session, remark = self._capture()
        if remark:
            self._doc.warned.emit(remark)
        self._saving.ask(partial(_save, path, session))
        self._show(saving=True)

    def open(self, path: str) -> None:
        """Open a session; it is shown when it has been read."""
        self._opening.ask(partial(load_session, path))
        self._show(opening=True)

    def close_links(self) -> None:
        """Call nobody any more; a file that is being written is written to its end."""
        self._saving.close()
        self._opening.close()
        self._steps = None

    def _saved(self, path: str) -> None:
        self._show(saving=False)
        self._doc.told.emit(f"saved {path}")

    def _not_saved(self, reason: str) -> None:
        self._show(saving=False)
        self._doc.warned.emit(reason)

    def _opened(self, session: Session) -> None:
        self._steps = self._restore(session)
        self._go_on()

    def _go_on(self) -> None:
        """The next step; then the window has its turn."""
        steps, self._steps = self._steps, None
        if steps is None:
            return
        attempt(partial(self._take_step, steps), self._doc.warned.emit)
        self._show(opening=self._steps is not None)

    def _take_step(self, steps: Generator[None]) -> None:
        for _ in steps:
            self._steps = steps
            QTimer.singleShot(0, self._go_on)
            break

    def _not_opened(self, reason: str) -> None:
        self._show(opening=False)
        self._doc.warned.emit(reason)

    def _ask_open(self, checked: bool = False) -> None:
        path, _ = QFileDialog.getOpenFileName(self._shown_in, "Open session", "", _KIND)
        if path:
            attempt(partial(self.open, path), self._doc.warned.emit)

    def _ask_save(self, checked: bool = False) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self._shown_in, "Save session", f"session{EXTENSION}", _KIND
        )
        if path:
            attempt(partial(self._save_as, path), self._doc.warned.emit)

    def _save_as(self, path: str) -> None:
        if Path(path).suffix.lower() != EXTENSION:
            path += EXTENSION
            if Path(path).exists():  # of which the dialog did not warn
                raise InputError(f"{path} is there already: choose it, or another name")
        self.save(path)

    def _show(self, saving: bool | None = None, opening: bool | None = None) -> None:
        """What is under way; None leaves it as it is."""
        for action, busy, words in (
            (self.open_action, opening, ("Open session...", "Opening ...")),
            (self.save_action, saving, ("Save session...", "Saving ...")),
        ):
            if busy is not None:
                action.setEnabled(not busy)
                action.setText(words[busy])


def _save(path: str, session: Session) -> str:
    save_session(path, session)
    return path
