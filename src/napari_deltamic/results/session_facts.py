"""The content of ``session.json``: plain values, checked by pydantic when they are read.

Arrays and meshes lie beside it in the archive; these classes hold their names.
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
    """A layer's place in the viewer's world; scale and translate are along Z, Y, X in its units."""

    name: str
    scale: Triple
    translate: Triple
    units: tuple[str, str, str]


@dataclass(frozen=True, kw_only=True)
class ImageFacts(Placed):
    """An image; voxel_size : um. display : how it is shown."""

    voxel_size: Triple
    display: Plain


@dataclass(frozen=True, kw_only=True)
class LayerFacts(Placed):
    """A layer of seeds; arrays : their names under ``seeds/``. options : how it is shown."""

    kind: str
    arrays: list[str]
    options: Plain


@dataclass(frozen=True, kw_only=True)
class StateFacts:
    """A state of a fit; loss : None if it is not known, as after a change by hand."""

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
    local_background: bool = False
    cone: bool
    unsure: bool
    moving: Triple | None


@dataclass(frozen=True, kw_only=True)
class MomentFacts:
    """A state that was kept on the way of a fit."""

    note: str
    mesh: MeshName
    optics: Plain


@dataclass(frozen=True, kw_only=True)
class ResultFacts:
    """The result of a fit; counted : whether a mask says which voxels count (else all do)."""

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
    """A tracked series; time : scale, translation, unit. meshes : of each frame; None for none."""

    time: tuple[float, float, str]
    seconds: float
    shared_ground: bool
    frames: list[FrameResult]
    meshes: list[MeshName | None]


@dataclass(frozen=True, kw_only=True)
class SessionFacts:
    """A whole session; second : image of its second view."""

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
