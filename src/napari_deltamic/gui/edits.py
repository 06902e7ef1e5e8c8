"""What a user changes by hand, in the fit under way or in its result; undo and redo."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QObject

from ..errors import InputError
from ..geometry import Mesh
from ..inference import Change, FitState
from ..job import FitInput
from ..scene import render
from .qt import Signal
from .waiting import usable

_DEEPEST = 30  # steps that can be undone


@dataclass(frozen=True, eq=False)
class Present:
    """What there is to change.

    running : whether a fit goes on from it.
    """

    state: FitState
    job: FitInput
    running: bool


@dataclass(frozen=True, eq=False)
class _Step:
    note: str
    back: Change  # what takes it back


class Edits(QObject):
    """Hands changes to whatever there is, and remembers how to take them back.

    Parameters
    ----------
    control : the run.
    """

    changed = Signal()  # what can be undone, or what is pinned
    settings_undone = Signal(object)  # the Change that took settings or optics back

    def __init__(self, control: Any, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._control = control
        control.began.connect(self._began)
        self.pinned: NDArray[np.bool_] | None = None
        self._done: list[_Step] = []
        self._undone: list[_Step] = []

    @property
    def undo_note(self) -> str:
        """What undo would take back; '' for nothing."""
        return self._done[-1].note if self._done else ""

    @property
    def redo_note(self) -> str:
        """What redo would do again; '' for nothing."""
        return self._undone[-1].note if self._undone else ""

    def _began(self, fresh: bool) -> None:
        if fresh:  # another mesh
            self.pinned = None
            self._done, self._undone = [], []
            self.changed.emit()

    def shift(self, shift: NDArray[np.float64], note: str) -> None:
        """Move vertices, (V, 3) um. InputError where there is nothing that they could belong to."""
        present = self._present()
        mesh = present.state.mesh
        if len(shift) != len(mesh.vertices):
            raise InputError("there is another mesh now: try again")
        if present.running:
            self._remember(note, Change(mesh=mesh))
            self._control.ask_shift(shift, note)
        else:
            self.change(Change(mesh=mesh.with_vertices(mesh.vertices_numpy() + shift)), note)

    def pin(self, which: NDArray[np.bool_], pinned: bool) -> None:
        """Pin vertices, or free them, (V,) bool."""
        present = self._present()
        if len(which) != len(present.state.mesh.vertices):
            raise InputError("there is another mesh now: try again")
        before = self._pins(present.state.mesh)
        after = before | which if pinned else before & ~which
        if not np.array_equal(before, after):
            self.change(Change(pinned=after), "pin" if pinned else "unpin")

    def free_all(self) -> None:
        """Free all pinned vertices."""
        if self.pinned is not None and self.pinned.any():
            self.pin(self.pinned, False)

    def change(self, change: Change, note: str) -> None:
        """Change anything. InputError where it cannot be; then all is as before."""
        present = self._present()
        usable(change, present.state.mesh, present.state.optics, present.job)
        back = self._back(change, present)
        self._apply(change, present, note)
        self._remember(note, back)

    def go_on_from(self, mesh: Mesh, optics: Any, note: str) -> None:
        """Let the fit go on from another state of it, or start one from there."""
        present = self._present()
        change = Change(mesh=mesh, optics=optics)
        if present.running:
            self.change(change, note)
            return
        usable(change, present.state.mesh, present.state.optics, present.job)
        self._control.go_on_from(mesh, optics, self.pinned)
        if mesh is not present.state.mesh or optics is not present.state.optics:
            self._remember(note, self._back(change, present))

    def undo(self) -> None:
        """Take back the last change."""
        self._take(self._done, self._undone, "undo")

    def redo(self) -> None:
        """Do again what was undone last."""
        self._take(self._undone, self._done, "redo")

    # ----------------------------------------------------------------------------------- inside

    def _take(self, source: list[_Step], other: list[_Step], word: str) -> None:
        if not source:
            return
        present, step = self._present(), source[-1]
        usable(step.back, present.state.mesh, present.state.optics, present.job)
        back = self._back(step.back, present)
        source.pop()
        self._apply(step.back, present, f"{word} {step.note}")
        other.append(_Step(step.note, back))
        if step.back.settings is not None or step.back.optics is not None:
            self.settings_undone.emit(step.back)
        self.changed.emit()

    def _present(self) -> Present:
        present: Present | None = self._control.present()
        if present is None:
            raise InputError("there is nothing to change yet: run a fit first")
        return present

    def _pins(self, mesh: Mesh) -> NDArray[np.bool_]:
        if self.pinned is None or len(self.pinned) != len(mesh.vertices):
            return np.zeros(len(mesh.vertices), bool)
        return self.pinned

    def _back(self, change: Change, present: Present) -> Change:
        """What takes a change back: of what it changes, the present values."""
        mesh = present.state.mesh
        values: dict[str, Any] = {
            "mesh": mesh,
            "pinned": self._pins(mesh),
            "optics": present.state.optics,
            "settings": present.job.settings.fit,
        }
        changed = [f.name for f in fields(change) if getattr(change, f.name) is not None]
        return Change(**{name: values[name] for name in changed})

    def _apply(self, change: Change, present: Present, note: str) -> None:
        if present.running:
            self._control.ask(change, note)
        elif change.mesh is not None or change.optics is not None:
            self._control.replace_result(changed_by_hand(present.state, present.job, change), note)
        if change.pinned is not None:
            self.pinned = change.pinned

    def _remember(self, note: str, back: Change) -> None:
        self._done = [*self._done, _Step(note, back)][-_DEEPEST:]
        self._undone = []
        self.changed.emit()


def changed_by_hand(state: FitState, job: FitInput, change: Change) -> FitState:
    """A state with other vertices or another PSF; its loss is not known."""
    mesh, optics, density = state.mesh, state.optics, state.density
    if change.mesh is not None:
        if len(change.mesh.faces) != len(density):
            density = np.ones(len(change.mesh.faces))  # of other triangles: not known
        mesh = change.mesh
    if change.optics is not None:
        optics = change.optics.detach()
    grid, settings = job.grid, job.settings
    amplitude, background = state.amplitude, state.background

    def rendered() -> NDArray[np.float32]:
        image = render(
            mesh,
            grid,
            optics,
            settings.fit.image_accuracy,
            density=density,
            pixel_integration="pixel_integration" in settings.scene.effects,
        )
        return (amplitude * image.detach() + background).numpy().astype(np.float32)

    return replace(
        state,
        mesh=mesh,
        optics=optics,
        density=density,
        loss=float("nan"),
        converged=False,
        message="changed by hand after the fit",
        _render=rendered,
        _checkpoint=dict,
    )
