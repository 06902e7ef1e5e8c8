"""What a fit keeps of itself between two iterations, so that it can go on from there."""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..common.reading import json_values, one_reason
from ..errors import InputError
from ..geometry.mesh import Mesh
from ..scene.effects import Effects
from .growth_alarm import GrowthAlarm
from .lbfgs import Learnt
from .schedule import Progress
from .shape import Shape
from .topology import TopologyPolicy

if TYPE_CHECKING:
    from .run import Run

_COUNTS = ("iteration", "evaluations", "level_number")


def kept(run: Run) -> dict[str, np.ndarray]:
    """What a checkpoint keeps of a run whose objective is about to be posed."""
    shape = run.shape
    log = shape.log_density
    plain = {
        **{name: getattr(run, name) for name in _COUNTS},
        "upkeep": run.upkeep.to_dict(),
        "effects": run.effects.to_dict(),
        "progress": asdict(run.progress),
        "policy": run.policy.to_dict(),
        "density": shape.model,
        "density_known": log is not None,
    }
    return {
        "seed": run.seed,
        "vertices": shape.mesh.vertices_numpy(),
        "faces": shape.mesh.faces,
        "regions": shape.mesh.regions,
        "pinned": shape.pinned,
        "log_density": np.zeros(0) if log is None else log,
        "optics": run.optics.parameters().detach().numpy(),
        "level_optics": run.level_optics.parameters().detach().numpy(),
        "levels": np.array(run.levels),
        "run": np.array(json.dumps(plain)),
        **_of(run.learnt),
    }


def take_over(run: Run, found: dict[str, np.ndarray]) -> None:
    """Go on from a checkpoint; raises InputError if it is damaged or of another mesh or fit."""
    try:
        _take_over(run, found)
    except InputError:
        raise
    except Exception as error:  # whatever damaged values may lead to
        raise InputError(f"the checkpoint is damaged ({one_reason(error)})") from error


def _take_over(run: Run, found: dict[str, np.ndarray]) -> None:
    for name, values in found.items():
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError(f"the checkpoint is damaged: {name} is not finite")
    if not np.array_equal(found.get("seed", 0), run.seed):
        raise InputError("the checkpoint belongs to another mesh")
    other = InputError("the checkpoint belongs to a fit with other settings")
    if not np.array_equal(found["levels"], np.array(run.levels)):
        raise other
    if found["optics"].shape != tuple(run.optics.parameters().shape):
        raise other
    mesh = Mesh(found["vertices"], found["faces"], found["regions"])
    run.optics = run.optics.with_parameters(torch.from_numpy(found["optics"]))
    if found["pinned"].shape != (len(mesh.vertices),):
        raise InputError("the checkpoint is damaged: its pins are of another mesh")
    shape = Shape.begun(mesh, run.settings.density).with_pins(found["pinned"])
    if "run" not in found:  # of an earlier version: its optimiser starts anew
        run.shape = shape
        return
    plain = json_values(str(found["run"]))
    effects = Effects(**plain["effects"])
    if effects.names != run.effects.names or plain["density"] != run.settings.density:
        raise other
    if not 0 <= int(plain["level_number"]) <= len(run.levels):
        raise InputError("the checkpoint is damaged: it is of a level that there is not")
    if plain["density_known"]:
        if found["log_density"].shape != (len(mesh.faces),):
            raise InputError("the checkpoint is damaged: its densities are of another mesh")
        shape = shape.moved(mesh.vertices_numpy(), found["log_density"])
    run.shape, run.effects, run.growth = shape, effects, GrowthAlarm(mesh)
    run.level_optics = run.optics.with_parameters(torch.from_numpy(found["level_optics"]))
    for name in _COUNTS:
        setattr(run, name, int(plain[name]))
    run.upkeep.resume(plain["upkeep"])
    progress = plain["progress"]
    run.progress = Progress(**{**progress, "values": tuple(progress["values"])})
    run.policy = TopologyPolicy.from_dict(plain["policy"])
    run.learnt = _learnt(found)


def _of(learnt: Learnt | None) -> dict[str, np.ndarray]:
    if learnt is None or not learnt.pairs:
        return {}
    steps, changes = (np.stack(of_all) for of_all in zip(*learnt.pairs, strict=True))
    return {"steps": steps, "changes": changes, "scale": np.array(learnt.scale)}


def _learnt(found: dict[str, np.ndarray]) -> Learnt | None:
    if "steps" not in found:
        return None
    pairs = tuple(zip(found["steps"], found["changes"], strict=True))
    return Learnt(pairs, float(found["scale"]))


def seed(mesh: Mesh) -> np.ndarray:
    """What tells the starting mesh from others, whatever became of it."""
    counts = [len(mesh.vertices), len(mesh.faces)]
    return np.array([*counts, zlib.crc32(np.ascontiguousarray(mesh.faces).tobytes())])
