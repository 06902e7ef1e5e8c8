"""What a fit keeps of itself between two iterations, so that it can go on from there."""

from __future__ import annotations

import json
import zlib
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..errors import InputError
from ..geometry.mesh import Mesh
from ..scene.effects import Effects
from .density import DensityField
from .health import GrowthAlarm
from .optimiser import AdamUniform
from .preconditioner import components

if TYPE_CHECKING:
    from .run import Run


def kept(run: Run) -> dict[str, np.ndarray]:
    """What a checkpoint keeps of a run."""
    return {
        "vertices": run.mesh.vertices_numpy(),
        "faces": run.mesh.faces,
        "regions": run.mesh.regions,
        "seed": run.seed,
        "slivers": np.array(run.upkeep.left),
        "optics": run.optics.parameters().numpy(),
        "level_optics": run.level_optics.parameters().numpy(),
        "window_start": run.window_start,
        "pinned": run.pinned,
        "effects": np.array(json.dumps(run.effects.to_dict())),
        "levels": np.array(run.levels),
        "iteration": np.array(run.iteration),
        "level": np.array(run.level_number),
        "step_factor": np.array(run.step_factor),
        "halvings": np.array(run.halvings),
        "losses": np.array(run.losses),
        **{f"adam_{k}": np.copy(v) for k, v in run.adam.state().items()},
        **{f"density_{k}": np.copy(v) for k, v in run.density.state().items()},
        **{f"topology_{k}": np.copy(v) for k, v in run.topology.state().items()},
    }


def take_over(run: Run, found: dict[str, np.ndarray]) -> None:
    """Go on from a checkpoint; raises InputError if it belongs to another mesh."""
    own = kept(run)
    if not np.array_equal(found.get("seed", 0), run.seed):
        raise InputError("the checkpoint belongs to another mesh")
    if set(found) != set(own) or not np.array_equal(found["levels"], own["levels"]):
        raise InputError("the checkpoint belongs to a fit with other settings")
    run.mesh = Mesh(found["vertices"], found["faces"], found["regions"])
    run.pieces = components(run.mesh)
    run.adam = AdamUniform(run.pieces, 3)
    run.density = DensityField(run.mesh, run.pieces, run.settings.density)
    run.window_start, run.pinned = found["window_start"], found["pinned"]
    run.upkeep.left = float(found["slivers"])
    run.growth = GrowthAlarm(run.mesh)
    own = kept(run)
    effects = Effects(**json.loads(str(found["effects"])))
    fixed = [name for name in own if name != "losses" and not name.startswith("topology_")]
    changed = any(found[name].shape != own[name].shape for name in fixed)
    if changed or effects.names != run.effects.names:
        raise InputError("the checkpoint belongs to a fit with other settings")
    run.effects = effects
    run.optics = run.optics.with_parameters(torch.from_numpy(found["optics"]))
    run.level_optics = run.optics.with_parameters(torch.from_numpy(found["level_optics"]))
    run.iteration = int(found["iteration"])
    run.level_number = int(found["level"])
    run.step_factor = float(found["step_factor"])
    run.halvings = int(found["halvings"])
    run.losses = list(found["losses"])
    run.adam.load({k.removeprefix("adam_"): v for k, v in found.items() if k.startswith("adam_")})
    run.density.load(
        {k.removeprefix("density_"): v for k, v in found.items() if k.startswith("density_")}
    )
    run.topology.load(
        {k.removeprefix("topology_"): v for k, v in found.items() if k.startswith("topology_")}
    )


def seed(mesh: Mesh) -> np.ndarray:
    """What tells the starting mesh from others, whatever became of it."""
    counts = [len(mesh.vertices), len(mesh.faces)]
    return np.array([*counts, zlib.crc32(np.ascontiguousarray(mesh.faces).tobytes())])
