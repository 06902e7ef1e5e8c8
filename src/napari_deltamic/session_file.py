"""A whole session in one file, ``*.deltamic``: image, seeds, settings, result, saved states.

The file is a zip of NumPy arrays (``.npy``), ``run.toml`` with the settings and ``session.json``
with the rest; it needs no other file. See :mod:`napari_deltamic.archive`.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from math import isfinite, nan
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .archive import ArchiveReader, ArchiveWriter, MeshReader, MeshWriter, opened
from .errors import InputError
from .geometry import Mesh
from .inference import FitState
from .job import optics_of
from .optics import GaussianPSF, Optics
from .report import History
from .scene import Grid, expected_image
from .scene.effects import Effects
from .session_bead import keep_bead, with_bead
from .settings import RunSettings, validated
from .timeline import Moment

EXTENSION = ".deltamic"
VERSION = 1  # of the format; grows when older versions could not read a file
_FORMAT = "napari-deltamic session"
_WHAT = "a deltaMic session"
_STATE = (  # what of a state is a plain value
    "iteration",
    "level",
    "levels",
    "loss",
    "amplitude",
    "background",
    "blur",
    "converged",
    "message",
)
Triple = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class SavedImage:
    """The image that is fitted, and how its layer lies in the viewer's world.

    pixels : (Z, Y, X), of any real type; NaN where missing.
    voxel_size : um, Z, Y, X.
    scale, translate, units : of the layer, Z, Y, X; the scale is in units of the world.
    display : plain values that say how it is shown (contrast limits, colormap, ...).
    """

    name: str
    pixels: NDArray[Any]
    voxel_size: Triple
    scale: Triple
    translate: Triple
    units: tuple[str, str, str]
    display: dict[str, Any] = field(default_factory=dict)

    @property
    def grid(self) -> Grid:
        """Where its voxels lie, um from the centre of the first."""
        z, y, x = self.pixels.shape
        return Grid((z, y, x), self.voxel_size)


@dataclass(frozen=True, eq=False)
class SavedLayer:
    """A layer as it was placed: seeds, for example.

    kind : points, labels or surface.
    arrays : points: data (n, 3), size (n,); labels: data (Z, Y, X); surface: vertices (V, 3),
        faces (F, 3) and, where they are known, regions (F, 2).
    scale, translate, units : of the layer, Z, Y, X.
    options : further plain values (colours, symbols, ...).
    """

    kind: str
    name: str
    arrays: dict[str, NDArray[Any]]
    scale: Triple
    translate: Triple
    units: tuple[str, str, str]
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SavedResult:
    """What a fit reached.

    settings : of the fit; those of the session may have been changed since.
    start : where it started, um; None if that is not known.
    state : the last good one.
    history : its course; ``seconds`` s long.
    verdict, message : how it ended, in a word and in words.
    moments : the states that were kept on the way.
    counted : (Z, Y, X) bool: voxels that may count; None for all.
    """

    settings: RunSettings
    state: FitState
    history: History
    seconds: float = 0.0
    verdict: str = ""
    message: str = ""
    start: Mesh | None = None
    moments: tuple[Moment, ...] = ()
    counted: NDArray[np.bool_] | None = None


@dataclass(frozen=True, eq=False)
class Session:
    """Everything that a session file holds.

    settings : what the panels show.
    seeds : the layers that the seeds come from.
    panels : plain values of the panels that are no settings of a run.
    """

    settings: RunSettings
    image: SavedImage
    seeds: tuple[SavedLayer, ...] = ()
    result: SavedResult | None = None
    panels: dict[str, Any] = field(default_factory=dict)


def save_session(path: str | os.PathLike[str], session: Session) -> None:
    """Write a session; the file appears whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    archive = ArchiveWriter()
    meshes = MeshWriter(archive)
    facts: dict[str, Any] = {
        "format": _FORMAT,
        "version": VERSION,
        "written_by": f"napari-deltamic {_version()}",
        "image": _image_facts(archive, session.image),
        "seeds": [_layer_facts(archive, k, seed) for k, seed in enumerate(session.seeds)],
        "panels": session.panels,
        "result": _result_facts(archive, meshes, session.result) if session.result else None,
    }
    archive.add_text("run.toml", keep_bead(archive, "run/bead", session.settings).to_toml())
    archive.add_json("session.json", facts)
    archive.write(path)


def load_session(path: str | os.PathLike[str]) -> Session:
    """Read what :func:`save_session` wrote; arrays and numbers come back bit for bit.

    Raises
    ------
    InputError
        In one line: missing, not a session, damaged, or written by a newer version.
    """
    with opened(path, _WHAT) as archive:
        facts = archive.json("session.json")
        if not isinstance(facts, dict) or facts.get("format") != _FORMAT:
            raise InputError("session.json says nothing of this format")
        newer = int(facts["version"]) > VERSION
        session = None if newer else _session(archive, facts)
    if session is None:
        raise InputError(
            f"{path}: written by a newer version ({facts.get('written_by', 'unknown')}): "
            f"this is napari-deltamic {_version()}"
        )
    return session


# ---- writing -------------------------------------------------------------------------------------


def _image_facts(archive: ArchiveWriter, image: SavedImage) -> dict[str, Any]:
    archive.add_array("image", image.pixels)
    return {"voxel_size": image.voxel_size, **_place(image), "display": image.display}


def _layer_facts(archive: ArchiveWriter, index: int, layer: SavedLayer) -> dict[str, Any]:
    for name, array in layer.arrays.items():
        archive.add_array(f"seeds/{index}/{name}", array)
    return {
        "kind": layer.kind,
        "arrays": list(layer.arrays),
        **_place(layer),
        "options": layer.options,
    }


def _place(layer: SavedImage | SavedLayer) -> dict[str, Any]:
    return {
        "name": layer.name,
        "scale": layer.scale,
        "translate": layer.translate,
        "units": layer.units,
    }


def _result_facts(
    archive: ArchiveWriter, meshes: MeshWriter, result: SavedResult
) -> dict[str, Any]:
    state, history = result.state, result.history
    archive.add_text("result.toml", keep_bead(archive, "result/bead", result.settings).to_toml())
    archive.add_array("state/density", state.density)
    if state.pinned is not None:
        archive.add_array("state/pinned", np.asarray(state.pinned, bool))
    if result.counted is not None:
        archive.add_array("counted", result.counted)
    for name in ("loss", "blur"):
        archive.add_array(f"history/{name}", np.array(getattr(history, name), np.float64))
    archive.add_array("history/level", np.array(history.level, np.int64))
    # A table: the loss of a moment may be NaN, which JSON does not know.
    course = [(moment.iteration, moment.loss) for moment in result.moments]
    archive.add_array("moments/iteration_loss", np.array(course, np.float64).reshape(-1, 2))
    scalars = {name: getattr(state, name) for name in _STATE}
    # Unknown after a change by hand.
    scalars["loss"] = state.loss if isfinite(state.loss) else None
    return {
        "state": {
            **scalars,
            "mesh": meshes.add("state/vertices", state.mesh),
            "optics": _optics_facts(state.optics),
            "effects": state.effects.to_dict(),
            "pinned": state.pinned is not None,
        },
        "first": history.first,
        "seconds": result.seconds,
        "verdict": result.verdict,
        "message": result.message,
        "start": meshes.add("start/vertices", result.start) if result.start else None,
        "counted": result.counted is not None,
        "moments": [
            {
                "note": moment.note,
                "mesh": meshes.add(f"moments/{k}/vertices", moment.mesh),
                "optics": _optics_facts(moment.optics),
            }
            for k, moment in enumerate(result.moments)
        ],
    }


def _optics_facts(optics: Optics) -> dict[str, Any]:
    if not isinstance(optics, GaussianPSF):
        return {"model": "settings", "parameters": optics.parameters().tolist()}
    # Plain floats come back from JSON as they were.
    if optics.diagonal:
        return {"model": "gaussian", "sigma": list(optics.sigma_um)}
    return {"model": "gaussian", "covariance": optics.covariance.detach().tolist()}


# ---- reading -------------------------------------------------------------------------------------


def _session(archive: ArchiveReader, facts: Mapping[str, Any]) -> Session:
    image = facts["image"]
    found = SavedImage(
        pixels=archive.array("image"),
        voxel_size=_triple(image["voxel_size"]),
        display=dict(image["display"]),
        **_placed(image),
    )
    if found.pixels.ndim != 3:
        raise InputError("its image is not 3D")
    return Session(
        settings=_settings(archive, "run.toml"),
        image=found,
        seeds=tuple(_layer(archive, k, seed) for k, seed in enumerate(facts["seeds"])),
        result=_result(archive, facts["result"], found.grid) if facts["result"] else None,
        panels=dict(facts["panels"]),
    )


def _settings(archive: ArchiveReader, name: str) -> RunSettings:
    settings: RunSettings = validated(RunSettings, tomllib.loads(archive.text(name)))
    return with_bead(archive, name.replace(".toml", "/bead"), settings)


def _placed(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "name": str(facts["name"]),
        "scale": _triple(facts["scale"]),
        "translate": _triple(facts["translate"]),
        "units": tuple(str(u) for u in facts["units"]),
    }


def _layer(archive: ArchiveReader, index: int, facts: Mapping[str, Any]) -> SavedLayer:
    arrays = {name: archive.array(f"seeds/{index}/{name}") for name in facts["arrays"]}
    return SavedLayer(
        str(facts["kind"]), arrays=arrays, options=dict(facts["options"]), **_placed(facts)
    )


def _result(archive: ArchiveReader, facts: Mapping[str, Any], grid: Grid) -> SavedResult:
    settings, meshes = _settings(archive, "result.toml"), MeshReader(archive)
    first = optics_of(settings.scene)  # a PSF of which states hold only what was fitted
    course = {name: archive.array(f"history/{name}").tolist() for name in ("loss", "level", "blur")}
    shown = facts["state"]
    scalars: dict[str, Any] = {name: nan if shown[name] is None else shown[name] for name in _STATE}
    state = FitState(
        mesh=meshes.mesh(shown["mesh"]),
        optics=_optics(shown["optics"], first),
        density=archive.array("state/density"),
        # Earlier versions saved neither effects nor pins.
        effects=Effects(**shown.get("effects", settings.scene.effects.to_dict())),
        pinned=archive.array("state/pinned") if shown.get("pinned") else None,
        **scalars,
    )
    if len(state.density) != len(state.mesh.faces):
        raise InputError("its densities belong to another mesh")
    if state.pinned is not None and state.pinned.shape != (len(state.mesh.vertices),):
        raise InputError("its pins belong to another mesh")
    return SavedResult(
        settings=settings,
        state=_with_images(state, grid, settings),
        history=History(**course, first=int(facts["first"])),
        seconds=float(facts["seconds"]),
        verdict=str(facts["verdict"]),
        message=str(facts["message"]),
        start=meshes.mesh(facts["start"]) if facts["start"] else None,
        counted=archive.array("counted") if facts["counted"] else None,
        moments=tuple(
            _moment(meshes, moment, row, first)
            for moment, row in zip(
                facts["moments"], archive.array("moments/iteration_loss"), strict=True
            )
        ),
    )


def _moment(
    meshes: MeshReader, facts: Mapping[str, Any], row: NDArray[Any], first: Optics
) -> Moment:
    return Moment(
        iteration=int(row[0]),
        loss=float(row[1]),
        mesh=meshes.mesh(facts["mesh"]),
        optics=_optics(facts["optics"], first),
        note=str(facts["note"]),
    )


def _with_images(state: FitState, grid: Grid, settings: RunSettings) -> FitState:
    """The state, able to render itself as it was during the fit."""

    def rendered() -> NDArray[np.float32]:
        return expected_image(
            state.mesh,
            grid,
            state.optics,
            settings.fit.image_accuracy,
            state.amplitude,
            state.background,
            density=state.density,
            effects=state.effects,
        )

    return replace(state, _render=rendered)


def _optics(facts: Mapping[str, Any], first: Optics) -> Optics:
    if facts["model"] == "settings":
        return first.with_parameters(torch.tensor(facts["parameters"], dtype=torch.float64))
    if facts["model"] != "gaussian":
        raise InputError(f"a PSF of the unknown kind {facts['model']}")
    if "sigma" in facts:
        return GaussianPSF(_triple(facts["sigma"]))
    return GaussianPSF(covariance=np.asarray(facts["covariance"], np.float64))


def _triple(values: Iterable[Any]) -> Triple:
    z, y, x = (float(v) for v in values)
    return z, y, x


def _version() -> str:
    try:
        return version("napari-deltamic")
    except PackageNotFoundError:
        return "unknown"
