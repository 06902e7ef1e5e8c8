"""Writes the result of a fit into a session file and reads it back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from math import isfinite, nan
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..common.reading import toml_values
from ..common.triple import triple
from ..errors import InputError
from ..fitting import FitState
from ..fitting.history import History
from ..fitting.job import optics_of
from ..geometry.archive import ArchiveReader, ArchiveWriter, MeshReader, MeshWriter
from ..optics import GaussianPSF, Optics
from ..runs.run_files import with_second_file
from ..runs.settings import RunSettings, validated
from ..scene import Grid
from ..scene.effects import Effects
from ..scene.light import Light
from .session_bead import keep_bead, with_bead
from .session_facts import MomentFacts, ResultFacts, StateFacts
from .session_parts import SavedResult
from .timeline import Moment

# The fields of a state that are plain values.
_STATE = (
    *("iteration", "level", "levels", "amplitude", "background"),
    *("blur", "converged", "message", "cone", "unsure", "moving"),
)


def result_facts(archive: ArchiveWriter, meshes: MeshWriter, result: SavedResult) -> ResultFacts:
    """Write the result of a fit; returns facts by which :func:`saved_result` finds it again."""
    state, history = result.state, result.history
    archive.add_text("result.toml", keep_bead(archive, "result/bead", result.settings).to_toml())
    archive.add_array("state/density", state.density)
    if state.pinned is not None:
        archive.add_array("state/pinned", np.asarray(state.pinned, bool))
    if state.dimmed is not None:
        archive.add_array("state/dimmed", state.dimmed)
    if state.local_background is not None:
        archive.add_array("state/local_background", state.local_background)
    if result.counted is not None:
        archive.add_array("counted", result.counted)
    for name in ("loss", "blur"):
        archive.add_array(f"history/{name}", np.array(getattr(history, name), np.float64))
    archive.add_array("history/level", np.array(history.level, np.int64))
    # As an array: the loss of a moment may be NaN, which JSON does not have.
    course = [(moment.iteration, moment.loss) for moment in result.moments]
    archive.add_array("moments/iteration_loss", np.array(course, np.float64).reshape(-1, 2))
    return ResultFacts(
        state=StateFacts(
            **{name: getattr(state, name) for name in _STATE},
            loss=state.loss if isfinite(state.loss) else None,
            mesh=meshes.add("state/vertices", state.mesh),
            optics=_optics_facts(state.optics),
            effects=state.effects.to_dict(),
            light=asdict(state.light),
            pinned=state.pinned is not None,
            dimmed=state.dimmed is not None,
            local_background=state.local_background is not None,
        ),
        first=history.first,
        seconds=result.seconds,
        verdict=result.verdict,
        message=result.message,
        start=meshes.add("start/vertices", result.start) if result.start else None,
        counted=result.counted is not None,
        moments=[
            MomentFacts(
                note=moment.note,
                mesh=meshes.add(f"moments/{k}/vertices", moment.mesh),
                optics=_optics_facts(moment.optics),
            )
            for k, moment in enumerate(result.moments)
        ],
    )


def _optics_facts(optics: Optics) -> dict[str, Any]:
    if not isinstance(optics, GaussianPSF):
        return {"model": "settings", "parameters": optics.parameters().tolist()}
    # Plain floats come back from JSON bit for bit.
    if optics.diagonal:
        return {"model": "gaussian", "sigma": list(optics.sigma_um)}
    return {"model": "gaussian", "covariance": optics.covariance.detach().tolist()}


def saved_result(archive: ArchiveReader, facts: ResultFacts, grid: Grid) -> SavedResult:
    """Read the result that :func:`result_facts` wrote. InputError if missing or damaged."""
    settings, meshes = settings_of(archive, "result.toml"), MeshReader(archive)
    first = optics_of(settings.scene)  # states hold only those numbers of a PSF that were fitted
    course = {name: archive.array(f"history/{name}").tolist() for name in ("loss", "level", "blur")}
    shown = facts.state
    state = FitState(
        **{name: getattr(shown, name) for name in _STATE},
        loss=nan if shown.loss is None else shown.loss,
        mesh=meshes.mesh(shown.mesh),
        optics=_optics(shown.optics, first),
        density=archive.array("state/density"),
        effects=validated(Effects, shown.effects),
        light=Light.from_dict(shown.light),
        pinned=archive.array("state/pinned") if shown.pinned else None,
        dimmed=archive.array("state/dimmed") if shown.dimmed else None,
        local_background=(
            archive.array("state/local_background") if shown.local_background else None
        ),
        grid=grid,
        accuracy=settings.fit.image_accuracy,
    )
    if len(state.density) != len(state.mesh.faces):
        raise InputError("its densities belong to another mesh")
    if state.pinned is not None and state.pinned.shape != (len(state.mesh.vertices),):
        raise InputError("its pins belong to another mesh")
    if state.dimmed is not None and state.dimmed.shape != grid.shape:
        raise InputError("its nuclei belong to another image")
    if state.local_background is not None and state.local_background.shape != grid.shape:
        raise InputError("its local background belongs to another image")
    return SavedResult(
        settings=settings,
        state=state,
        history=History(**course, first=facts.first),
        seconds=facts.seconds,
        verdict=facts.verdict,
        message=facts.message,
        start=meshes.mesh(facts.start) if facts.start else None,
        counted=archive.array("counted") if facts.counted else None,
        moments=tuple(
            _moment(meshes, moment, row, first)
            for moment, row in zip(
                facts.moments, archive.array("moments/iteration_loss"), strict=True
            )
        ),
    )


def _moment(meshes: MeshReader, facts: MomentFacts, row: NDArray[Any], first: Optics) -> Moment:
    return Moment(
        iteration=int(row[0]),
        loss=float(row[1]),
        mesh=meshes.mesh(facts.mesh),
        optics=_optics(facts.optics, first),
        note=facts.note,
    )


def _optics(facts: Mapping[str, Any], first: Optics) -> Optics:
    if facts["model"] == "settings":
        return first.with_parameters(torch.tensor(facts["parameters"], dtype=torch.float64))
    if facts["model"] != "gaussian":
        raise InputError(f"a PSF of the unknown kind {facts['model']}")
    if "sigma" in facts:
        return GaussianPSF(triple(facts["sigma"]))
    return GaussianPSF(covariance=np.asarray(facts["covariance"], np.float64))


def settings_of(archive: ArchiveReader, name: str) -> RunSettings:
    """Read the settings of a run, with the image of their bead but without their other files."""
    settings: RunSettings = validated(RunSettings, toml_values(archive.text(name)))
    view = settings.scene.effects.view
    if view is not None and view.image:  # the session holds the image itself
        settings = with_second_file(settings, "")
    return with_bead(archive, name.replace(".toml", "/bead"), settings)
