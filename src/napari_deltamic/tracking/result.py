"""The results of tracking: frames, events, and where each cell comes from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, InstanceOf, PlainSerializer

from ..common.triple import Triple
from ..errors import InputError
from ..fitting.model.state import FitState
from ..geometry.judgement import Judgement
from ..geometry.mesh import Mesh

EventKind = Literal["divided", "ended", "alarm"]
# A number that may not be known: NaN here, None in files, as JSON has no NaN.
Known = Annotated[
    float,
    BeforeValidator(lambda value: nan if value is None else value),
    PlainSerializer(lambda value: value if isfinite(value) else None),
]


@dataclass(frozen=True)
class Event:
    """What happened to a cell.

    kind : "divided"; "ended" if it has left or vanished; "alarm" if it may no longer be the same
        cell.
    frame, cell : when, and to which.
    text : in plain words.
    daughters : the two numbers of a division.
    """

    kind: EventKind
    frame: int
    cell: int
    text: str
    daughters: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class FrameResult:
    """The result of one frame; reports hold all of it but the mesh, which has a file of its own.

    frame, time : number from 0, and seconds.
    mesh : with a region for each cell that is alive; None where the frame was left out.
    message : why it was left out, or what the fit has to say.
    events : in the order in which they happened.
    loss, iterations, seconds, sigma_um : of the fit; NaN and 0 where there was none.
    psf : its parameters after the fit, as :meth:`Optics.parameters` gives them; () for unknown.
    structure : what shines, membrane, interior or both; empty where it is not known.
    moving : um: where the surface still moves; None where it rests.
    grade, judgement : good, fair or poor, and why; empty if it was not judged.
    judged : the same of each cell, with the predicted error of its shape.
    """

    frame: int
    time: Annotated[float, Field(alias="time_s")]
    mesh: Annotated[InstanceOf[Mesh] | None, Field(exclude=True)] = None
    message: str = ""
    events: tuple[Event, ...] = ()
    loss: Known = nan
    iterations: int = 0
    seconds: float = 0.0
    sigma_um: tuple[Known, Known, Known] = (nan, nan, nan)
    psf: tuple[float, ...] = ()
    structure: str = ""
    moving: Triple | None = None
    grade: str = ""
    judgement: str = ""
    judged: Mapping[int, Judgement] = field(default_factory=dict)

    @property
    def cells(self) -> tuple[int, ...]:
        """Numbers of the cells in the frame."""
        return () if self.mesh is None else tuple(self.mesh.region_ids().tolist())


@dataclass(frozen=True)
class TrackState:
    """One step of tracking.

    frame : the one being fitted.
    mesh : as it is now; None in a frame that is left out.
    fit : the state of the frame's fit; None between fits.
    done : the frame's result, with its last state only.
    last_fit : with ``done``, the last state of the fit, to render or measure.
    """

    frame: int
    mesh: Mesh | None
    fit: FitState | None = None
    done: FrameResult | None = None
    last_fit: FitState | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Lineage:
    """The life of a cell, as far as it was seen.

    parent : the cell that it came from by division; 0 for cells of the first frame.
    first, last : its first and last frame.
    end : why it ends before the series does; "" if it does not.
    """

    cell: int
    parent: int
    first: int
    last: int
    end: str = ""


def lineage(results: Iterable[FrameResult]) -> list[Lineage]:
    """Return the life of every cell, ordered by number."""
    seen: dict[int, list[int]] = {}
    parents: dict[int, int] = {}
    ends: dict[int, str] = {}
    for result in results:
        for cell in result.cells:
            seen.setdefault(cell, []).append(result.frame)
        for event in result.events:
            if event.kind == "divided":
                parents.update(dict.fromkeys(event.daughters, event.cell))
            if event.kind != "alarm":
                ends[event.cell] = event.text
    return [
        Lineage(cell, parents.get(cell, 0), frames[0], frames[-1], ends.get(cell, ""))
        for cell, frames in sorted(seen.items())
    ]


def surface_4d(
    results: Sequence[FrameResult],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Join all frames: vertices (N, 4) T, Z, Y, X; faces (M, 3); and the cell of each vertex.

    T counts frames, the rest is um. The surface of each cell is closed, so a wall between two is
    there twice: each cell can be shown alone, in its own colour. InputError if no frame has a mesh.
    """
    vertices, faces, cells, offset = [], [], [], 0
    for result in results:
        for cell in result.cells:
            assert result.mesh is not None
            own = result.mesh.region_surface(cell)
            places = own.vertices_numpy()
            vertices.append(np.column_stack([np.full(len(places), float(result.frame)), places]))
            faces.append(own.faces + offset)
            cells.append(np.full(len(places), cell))
            offset += len(places)
    if not vertices:
        raise InputError("no frame has a mesh")
    return np.concatenate(vertices), np.concatenate(faces), np.concatenate(cells)
