"""Changes that a user has made and a fit has not yet taken over."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry import Mesh
from ..geometry.carry import carried
from ..optics import Optics
from .job import FitInput
from .model.change import Change
from .model.checks import check_mesh, check_psf
from .model.problem import Problem


@dataclass(frozen=True, eq=False)
class Taken:
    """What waited: one change for all, and the number of the last one in it."""

    change: Change
    shift: NDArray[np.float64] | None
    number: int
    shifted: Mesh | None = None  # whose vertices the shift moves
    pins_of: Mesh | None = None  # whose vertices are to be pinned

    def on(self, mesh: Mesh) -> Change:
        """The change for a mesh that meanwhile moved on: the newest that was yielded.

        It may have other triangles by now. InputError if the change cannot be made of it any more.
        """
        changed, pinned = self.change.mesh, self.change.pinned
        start = mesh if changed is None else changed
        if pinned is not None and self.pins_of is not None:
            pinned = carried(pinned, self.pins_of, start)
        if self.shift is not None:
            shift = self.shift
            if self.shifted is not None:
                shift = carried(shift, self.shifted, start)
            if len(shift) != len(start.vertices):
                raise InputError("the surface was remeshed meanwhile: try again")
            changed = start.with_vertices(start.vertices_numpy() + shift)
        return replace(self.change, mesh=changed, pinned=pinned)


class Waiting:
    """Hands changes from the main thread to that of the fit; several are merged into one.

    Of each thing the last change counts. Shifts of vertices add up, and are added to the vertices
    that the fit has when it takes them over, so that no progress is lost.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._change = Change()
        self._shift: NDArray[np.float64] | None = None
        self._shifted: Mesh | None = None
        self._pins_of: Mesh | None = None
        self._number = 0
        self._taken = 0

    @property
    def any(self) -> bool:
        """Whether something waits."""
        return self._number > self._taken

    def add(self, change: Change, of: Mesh | None = None) -> int:
        """Let a change wait, made of a mesh (where it brings none of its own); its number."""
        given = {f.name: getattr(change, f.name) for f in fields(change)}
        given = {name: value for name, value in given.items() if value is not None}
        with self._lock:
            if change.mesh is not None:
                self._shift = self._shifted = None
            if change.pinned is not None:
                self._pins_of = of if change.mesh is None else change.mesh
            self._change = replace(self._change, **given)
            self._number += 1
            return self._number

    def shift(self, shift: NDArray[np.float64], of: Mesh | None = None) -> int:
        """Let a shift of the vertices of a mesh wait, (V, 3) um; its number."""
        with self._lock:
            before = self._shift
            if before is not None and of is not None and self._shifted is not None:
                before = carried(before, self._shifted, of)
            self._shift = shift if before is None else before + shift
            self._shifted = of
            self._number += 1
            return self._number

    def take(self) -> Taken | None:
        """What waits, if anything; nothing does afterwards."""
        with self._lock:
            if self._number == self._taken:
                return None
            taken = Taken(self._change, self._shift, self._number, self._shifted, self._pins_of)
            self._change, self._shift, self._taken = Change(), None, self._number
            self._shifted = self._pins_of = None
            return taken


def usable(
    change: Change, mesh: Mesh, optics: Optics, job: FitInput, *, running: bool = True
) -> None:
    """InputError if a fit cannot take a change: it would end by it.

    The mesh and the PSF are those that the fit has. One that does not run takes any kind of PSF:
    the next one begins with it.
    """
    settings = job.settings.fit
    if change.optics is not None:
        check_psf(change.optics, job.grid)
        change = change if running else replace(change, optics=None)
    if change.settings is not None:
        # Levels that the software chose are not noted in the settings.
        change = replace(
            change, settings=change.settings.model_copy(update={"levels": settings.levels})
        )
    change.check(mesh, optics, settings)
    if change.mesh is not None:
        check_mesh(change.mesh, job.grid)
    if change.effects is not None:
        Problem.of(job.image, job.grid, job.counted).counted_with(change.effects)
