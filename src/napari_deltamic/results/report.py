"""Writes the results of a fit: mesh, rendered image, measurements, settings, report, picture."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isfinite, prod
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from ..common.version import version_of
from ..common.writing import make_folder, write_atomically, written_together
from ..evidence.verdict import Verdict
from ..fitting import FitState
from ..fitting.history import History
from ..fourier.devices import choose_device
from ..fourier.native import threads
from ..geometry import save_mesh
from ..images.stacks import write_image
from ..measure import measure
from ..measure.of_fit import known_of
from ..runs.settings import RunSettings
from ..scene import Grid, Renderer, Scene
from ..scene.effects import Effects
from ..scene.light import structure_of
from .picture import picture_png
from .rules_of_a_fit import rules_of_a_fit

FILES = (
    "mesh.ply",
    "mesh.rec",
    "rendered.tif",
    "measurements.csv",
    "run.toml",
    "report.json",
    "picture.png",
)
PACKAGES = ("napari-deltamic", "torch", "numpy", "scipy", "scikit-image", "cholespy")


def write_results(
    folder: str | os.PathLike[str],
    state: FitState,
    image: ArrayLike,
    grid: Grid,
    settings: RunSettings,
    history: History,
    seconds: float,
    *,
    warnings: Sequence[str] = (),
    further: Mapping[str, Any] | None = None,
    explained: Mapping[int, float] | None = None,
    verdict: Verdict | None = None,
    table: str | None = None,
) -> list[Path]:
    """Write everything that a fit found; files of the same names are replaced, all or none.

    ``mesh.ply`` and ``mesh.rec`` (um), ``rendered.tif`` (as the microscope would show it),
    ``measurements.csv`` (one row a cell), ``run.toml`` (re-runs the fit), ``report.json`` and
    ``picture.png`` (slices with contours).

    Parameters
    ----------
    folder : path
        Made if it is not there.
    state : the last state of the fit.
    image : (Z, Y, X) measured; NaN where missing.
    grid : where the voxels lie.
    settings : the whole run.
    history : every state of the fit.
    seconds : s; how long the fit took.
    warnings : remarks that a reader of the report should see.
    further : sections of the report besides those that every fit has.
    explained : by region, the share of the variation around it that the fit explains.
    verdict : how good the shapes are, for the report and the table of cells.
    table : the text of ``measurements.csv``; None: all columns that can be measured here.

    Returns
    -------
    list of paths, in the order of ``FILES``.

    Raises
    ------
    InputError
        If the folder or a file cannot be written.
    """
    folder = Path(folder)
    make_folder(folder)
    paths = [folder / name for name in FILES]
    ply, rec, tif, csv, toml, report, png = paths
    rendered = np.asarray(state.rendered())
    facts = describe(state, grid, settings, history, seconds, warnings)
    facts |= plain_values(dict(further or {}))
    if verdict is not None:
        facts["verdict"] = plain_values(verdict.as_plain())
    judgements = {} if verdict is None else verdict.by_region()
    with written_together(report):
        save_mesh(state.mesh, ply)
        save_mesh(state.mesh, rec)
        write_image(tif, rendered, grid.voxel_size)
        if table is None:
            known = known_of(state, grid, explained=explained, judgements=judgements)
            table = measure(state.mesh, known).cells.to_csv()
        write_atomically(csv, table.encode())
        write_atomically(toml, (_missing(settings) + settings.to_toml()).encode())
        write_atomically(png, picture_png(image, rendered, state.mesh, grid))
        text = json.dumps(facts, indent=2, allow_nan=False) + "\n"
        write_atomically(report, text.encode())
    return paths


def _missing(settings: RunSettings) -> str:
    """Return a comment for ``run.toml`` on what is missing to repeat the run."""
    lost = [name for name in ("image", "seeds") if not getattr(settings, name)]
    if not lost:
        return ""
    return f"# Not in a file when this was written: {' and '.join(lost)}. Enter the path first.\n"


def describe(
    state: FitState,
    grid: Grid,
    settings: RunSettings,
    history: History,
    seconds: float,
    warnings: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the content of ``report.json``: plain values; numbers that are not finite are None."""
    fit = settings.fit
    device = choose_device(fit.device, prod(grid.shape))
    facts = {
        "version": version_of("napari-deltamic"),
        "engine": engine_used(state, grid, fit.image_accuracy, device),
        "accuracy": fit.image_accuracy,
        "iterations": state.iteration,
        "seconds": round(seconds, 3),
        "rules": rules_of_a_fit(),
        "converged": state.converged,
        "message": state.message,
        "warnings": list(warnings),
        "optics": {
            "model": type(state.optics).__name__,
            "sigma_um": list(state.optics.sigma_um),
            "parameters": {
                p.name: {"value": p.value, "unit": p.unit, "fitted": p.fitted}
                for p in state.optics.described()
            },
            "fitted": fit.fit_psf,
        },
        "effects": effects_found(settings.scene.effects, state.effects),
        "structure": structure_of(state.light),
        "light": asdict(state.light),
        "local_background": state.local_background is not None,
        "amplitude": state.amplitude,
        "background": state.background,
        "mesh": {
            "vertices": len(state.mesh.vertices),
            "faces": len(state.mesh.faces),
            "regions": len(state.mesh.region_ids()),
        },
        "grid": grid.as_plain(),
        "settings": settings.model_dump(mode="json"),
        "levels": history.levels(),
        "first_iteration": history.first,
        "loss": list(history.loss),
        "versions": {name: version_of(name) for name in PACKAGES},
    }
    found: dict[str, Any] = plain_values(facts)
    return found


def effects_found(start: Effects, end: Effects) -> list[dict[str, Any]]:
    """Return where each effect acts, whether it was fitted, and its numbers before and after."""
    found = []
    for effect in end.present():
        first = getattr(start, effect.name) or type(effect).neutral()
        before = {v.name: v.value for v in first.values()}
        found.append(
            {
                "name": effect.name,
                "where": effect.where,
                "fitted": bool(effect.fit and effect.bounds),
                "numbers": [
                    {"name": v.name, "unit": v.unit, "start": before.get(v.name), "value": v.value}
                    for v in effect.values()
                ],
            }
        )
    return found


def engine_used(state: FitState, grid: Grid, accuracy: float, device: torch.device) -> str:
    """Say in words what computes the images of a state at the last level."""
    method = Renderer(Scene.of(state.mesh, state.optics), grid, accuracy, device=device).plan.method
    return f"{device.type}, {method}, {threads()} threads"


def plain_values(value: Any) -> Any:
    """Convert a value, NumPy's included, to one that JSON can hold."""
    if isinstance(value, dict):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_values(item) for item in value]
    if isinstance(value, np.generic):
        return plain_values(value.item())
    if isinstance(value, float) and not isfinite(value):
        return None
    return value
