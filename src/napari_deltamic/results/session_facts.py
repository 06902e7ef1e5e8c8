"""What ``session.json`` holds: the plain part of a session, checked by pydantic when it is read.

Arrays and meshes lie beside it in the archive; here are their names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter

from ..common.triple import Triple
from ..tracking import FrameResult

Plain = dict[str, Any]
MeshName = dict[str, str | int]  # by which a MeshReader finds it


@dataclass(frozen=True, kw_only=True)
class Placed:
    """A layer in the viewer's world; scale and translate along Z, Y, X in its units."""

    name: str
    scale: Triple
    translate: Triple
    units: tuple[str, str, str]


@dataclass(frozen=True, kw_only=True)
class ImageFacts(Placed):
    """Of an image; voxel_size : um. display : how it is shown."""

    voxel_size: Triple
    display: Plain


@dataclass(frozen=True, kw_only=True)
class LayerFacts(Placed):
    """Of a layer of seeds; arrays : their names under ``seeds/``. options : how it is shown."""

    kind: str
    arrays: list[str]
    options: Plain


@dataclass(frozen=True, kw_only=True)
class StateFacts:
    """Of a state of a fit; loss : None where it is not known, as after a change by hand."""

    mesh: MeshName
    optics: Plain
    iteration: int
    level: int
    levels: int
    loss: float | None
    amplitude: float
    background: float
    blur: float
    converged: bool
    message: str
    effects: Plain
    light: Plain
    pinned: bool
    dimmed: bool
    cone: bool
    unsure: bool
    moving: Triple | None


@dataclass(frozen=True, kw_only=True)
class MomentFacts:
    """Of a state on the way."""

    note: str
    mesh: MeshName
    optics: Plain


@dataclass(frozen=True, kw_only=True)
class ResultFacts:
    """Of the result of a fit; counted : whether not all voxels did."""

    state: StateFacts
    first: int
    seconds: float
    verdict: str
    message: str
    start: MeshName | None
    counted: bool
    moments: list[MomentFacts]


@dataclass(frozen=True, kw_only=True)
class TracksFacts:
    """Of a series; time : scale, translation and unit. meshes : of each frame, if it has one."""

    time: tuple[float, float, str]
    seconds: float
    shared_ground: bool
    frames: list[FrameResult]
    meshes: list[MeshName | None]


@dataclass(frozen=True, kw_only=True)
class SessionFacts:
    """Of a session; second : its second view."""

    format: str
    version: int
    written_by: str
    image: ImageFacts
    seeds: list[LayerFacts]
    panels: Plain
    result: ResultFacts | None
    second: ImageFacts | None
    tracks: TracksFacts | None


SESSION: TypeAdapter[SessionFacts] = TypeAdapter(SessionFacts)
