"""Changes by hand in the running fit or in its result; undo and redo."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QObject

from ...errors import InputError
from ...fitting import Change
from ...fitting.by_hand import changed_by_hand
from ...fitting.pending import usable
from ...geometry import Mesh
from ...geometry.carry import carried
from ..document import Document
from ..record import Present
from ..widgets import Signal

_DEEPEST = 30  # steps that can be undone
OTHER_PSF = "the PSF was of another kind then, which a fit cannot change to while it runs"


@dataclass(frozen=True, eq=False)
class _Step:
    note: str
    back: Change  # what takes it back
    of: Mesh  # that the pins in it belong to, where it brings no mesh


@dataclass(frozen=True, eq=False)
class _Asked:
    """Pins of a mesh that the fit has not adopted yet."""

    pinned: NDArray[np.bool_]
    mesh: Mesh
    number: int  # snapshots include them from this change on


class Edits(QObject):
    """Hands changes to the running fit or the result, and remembers how to undo them."""

    changed = Signal()  # what can be undone, or what is pinned
    settings_undone = Signal(object)  # the Change that took settings, optics or effects back

    def __init__(self, doc: Document, control: Any, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._doc, self._control = doc, control
        doc.began.connect(self._began)
        doc.shown.connect(self._shown)
        doc.ended.connect(self._ended)
        for signal in (doc.image.changed, doc.work.changed):
            signal.connect(self._tell)
        self._asked: _Asked | None = None
        self._told: NDArray[np.bool_] | None = None  # pins of the last state shown

    @property
    def undo_note(self) -> str:
        """What undo would take back; '' for nothing."""
        return self._note(self._steps()[0])

    @property
    def redo_note(self) -> str:
        """What redo would do again; '' for nothing."""
        return self._note(self._steps()[1])

    @property
    def pinned(self) -> NDArray[np.bool_] | None:
        """(V,) bool: which vertices of the newest mesh are pinned; None without a mesh."""
        present = self._doc.present()
        return None if present is None else self._pins(present)

    def pinned_on(self, mesh: Mesh) -> NDArray[np.bool_] | None:
        """The same for another mesh of this fit, which may have other triangles."""
        present = self._doc.present()
        if present is None:
            return None
        return carried(self._pins(present), present.state.mesh, mesh)

    def shift(self, shift: NDArray[np.float64], note: str, of: Mesh | None = None) -> None:
        """Move vertices, (V, 3) um, of a mesh of this fit; of the newest, where none is given.

        InputError where there is nothing that they could belong to.
        """
        present = self._present()
        mesh = present.state.mesh
        shift = _suited(shift, of, mesh)
        if present.running:
            self._remember(note, self._back(Change(mesh=mesh), present), mesh)
            self._control.ask_shift(shift, note, mesh)
        else:
            self.change(Change(mesh=mesh.with_vertices(mesh.vertices_numpy() + shift)), note)

    def pin(self, which: NDArray[np.bool_], pinned: bool, of: Mesh | None = None) -> None:
        """Pin or free vertices, (V,) bool, of a mesh of this fit; by default of the newest."""
        present = self._present()
        which = _suited(which, of, present.state.mesh)
        before = self._pins(present)
        after = before | which if pinned else before & ~which
        if not np.array_equal(before, after):
            self.change(Change(pinned=after), "pin" if pinned else "unpin")

    def free_all(self) -> None:
        pinned = self.pinned
        if pinned is not None and pinned.any():
            self.pin(pinned, False)

    def change(self, change: Change, note: str) -> None:
        """Make any change. InputError if that is not possible; then nothing has changed."""
        present = self._present()
        _check(change, present)
        back = self._back(change, present)
        self._apply(change, present, note)
        done, undone = self._steps()
        if done and _leads_back(change, done[-1].back):  # as if neither had been
            done.pop()
            undone.clear()
            self.changed.emit()
            return
        self._remember(note, back, present.state.mesh)

    def go_on_from(self, mesh: Mesh, optics: Any, note: str) -> None:
        """Let the fit continue from another of its states, or start one from there."""
        present = self._present()
        pinned = carried(self._pins(present), present.state.mesh, mesh)
        change = Change(mesh=mesh, optics=optics, pinned=pinned)
        if present.running:
            self.change(change, note)
            return
        _check(change, present)
        back = self._back(change, present)
        self._control.go_on_from(mesh, optics, pinned)
        # The new run has them from its second state on.
        self._asked = _Asked(pinned, mesh, 1) if pinned.any() else None
        if mesh is not present.state.mesh or optics is not present.state.optics:
            self._remember(note, back, present.state.mesh)

    def undo(self) -> None:
        done, undone = self._steps()
        self._take(done, undone, "undo")

    def redo(self) -> None:
        done, undone = self._steps()
        self._take(undone, done, "redo")

    def _began(self, fresh: bool) -> None:
        if fresh:  # another mesh
            self._asked = self._told = None
        self.changed.emit()

    def _shown(self, snapshot: Any) -> None:
        """Signal what is pinned once the fit has adopted it, or when its vertices change."""
        taken = self._asked is not None and snapshot.changes >= self._asked.number
        if taken:
            self._asked = None
        if taken or snapshot.state.pinned is not self._told:
            self._told = snapshot.state.pinned
            self.changed.emit()

    def _ended(self) -> None:
        self._asked = None  # what came too late is in the result
        for record in self._doc.records.values():
            for steps in (record.done, record.undone):
                steps[:] = [step for step in steps if not _is_of_fit_alone(step.back)]
        self.changed.emit()

    def _tell(self) -> None:
        self.changed.emit()

    def _steps(self) -> tuple[list[_Step], list[_Step]]:
        """The steps that can be undone, and redone, in the present record."""
        record = self._doc.record
        return ([], []) if record is None else (record.done, record.undone)

    def _note(self, steps: list[_Step]) -> str:
        return steps[-1].note if steps and self._doc.present() is not None else ""

    def _take(self, source: list[_Step], other: list[_Step], word: str) -> None:
        if not source:
            return
        present, step = self._present(), source[-1]
        change, mesh = step.back, present.state.mesh
        if change.mesh is None and change.pinned is not None:
            change = replace(change, pinned=carried(change.pinned, step.of, mesh))
        _check(change, present)
        back = self._back(change, present)
        source.pop()
        self._apply(change, present, f"{word} {step.note}")
        other.append(_Step(step.note, back, mesh))
        if (change.settings, change.optics, change.effects) != (None, None, None):
            self.settings_undone.emit(change)
        self.changed.emit()

    def _present(self) -> Present:
        present = self._doc.present()
        if present is None:
            raise InputError("there is nothing to change yet: run a fit first")
        return present

    def _pins(self, present: Present) -> NDArray[np.bool_]:
        """(V,) bool: what is pinned on the newest mesh, or will be once the fit has adopted it."""
        state, asked = present.state, self._asked
        if present.running and asked is not None and asked.number > present.changes:
            return carried(asked.pinned, asked.mesh, state.mesh)
        if state.pinned is None:
            return np.zeros(len(state.mesh.vertices), bool)
        return np.asarray(state.pinned, bool)

    def _back(self, change: Change, present: Present) -> Change:
        """The change that undoes a change: the present values of all that it changes."""
        mesh = present.state.mesh
        values: dict[str, Any] = {
            "mesh": mesh,
            "pinned": self._pins(present),
            "optics": present.state.optics,
            "settings": present.job.settings.fit,
            "effects": present.state.effects,
        }
        changed = {f.name for f in fields(change) if getattr(change, f.name) is not None}
        if "mesh" in changed:
            changed.add("pinned")  # they are of its vertices
        return Change(**{name: values[name] for name in changed})

    def _apply(self, change: Change, present: Present, note: str) -> None:
        mesh = present.state.mesh
        if present.running:
            number = self._control.ask(change, note, mesh)
            if change.pinned is not None:
                self._asked = _Asked(change.pinned, change.mesh or mesh, number)
        elif change.mesh is not None or change.optics is not None:
            self._control.replace_result(changed_by_hand(present.state, present.job, change), note)
        elif change.pinned is not None and self._doc.result is not None:
            self._doc.result.pin(change.pinned)

    def _remember(self, note: str, back: Change, of: Mesh) -> None:
        done, undone = self._steps()
        done.append(_Step(note, back, of))
        del done[:-_DEEPEST], undone[:]
        self.changed.emit()


def _is_of_fit_alone(change: Change) -> bool:
    """Whether a change concerns settings or effects only, which a result no longer uses."""
    return all(one is None for one in (change.mesh, change.pinned, change.optics))


def _leads_back(change: Change, back: Change) -> bool:
    """Whether a change of settings or effects is the one that undoes the last one."""
    if not (_is_of_fit_alone(change) and _is_of_fit_alone(back)):
        return False
    return change.effects == back.effects and _chosen(change) == _chosen(back)


def _chosen(change: Change) -> Any:
    """The settings of a change without the levels, which the software may have set."""
    return None if change.settings is None else change.settings.model_copy(update={"levels": None})


def can_take(optics: Any, present: Present) -> bool:
    """Whether the fit or result can continue with a PSF: a running fit keeps its kind."""
    now = present.state.optics
    same = type(optics) is type(now) and optics.parameters().shape == now.parameters().shape
    return same or not present.running


def _check(change: Change, present: Present) -> None:
    """Raise InputError if the fit or result cannot take a change."""
    if change.optics is not None and not can_take(change.optics, present):
        raise InputError(f"{OTHER_PSF}: stop the fit first")
    state, job = present.state, present.job
    usable(change, state.mesh, state.optics, job, running=present.running)


def _suited(values: Any, of: Mesh | None, mesh: Mesh) -> Any:
    """Values for a mesh's vertices, from those for another one. InputError if they suit neither."""
    values = values if of is None else carried(values, of, mesh)
    if len(values) != len(mesh.vertices):
        raise InputError("there is another mesh now: try again")
    return values
