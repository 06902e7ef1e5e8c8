"""How uneven the inside of each cell is, which a model of even insides cannot show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ..fitting.job import FitInput
from ..fitting.model.amplitudes import all_flat, inside_over_membrane
from ..fitting.model.level import differences
from ..fitting.model.saturation import filled_in
from ..fitting.model.state import FitState
from ..fitting.objective.evening import unevenness
from ..geometry.labels.voxels import voxel_labels
from ..scene.light import INSIDES
from ..scene.render import expected_image

_ACCURACY = 1e-2  # of images that are only compared where they are brightest


def inside_shares(state: FitState) -> dict[int, float]:
    """Inside / (inside + membrane peak) of each cell: the share of its inside in the brightness."""
    over = inside_over_membrane(state.light, state.optics.sigma_um)
    regions = state.mesh.region_ids()
    each = over * np.abs(state.light.of_cells(regions))
    return {int(k): float(r / (1 + r)) for k, r in zip(regions, each, strict=True)}


def uneven_insides(job: FitInput, state: FitState, rendered: np.ndarray) -> dict[int, float]:
    """Standard deviation of the relative brightness deep inside each cell, noise left out.

    Parameters
    ----------
    rendered
        (Z, Y, X) image of the state.
    """
    if state.light.interior <= 0 or not state.amplitude > 0:
        return {}
    grid, mesh = job.grid, state.mesh
    given = mesh, grid, state.optics, _ACCURACY
    alone = replace(state.light, membrane=0.0)
    shown = expected_image(*given, state.amplitude, 0.0, effects=state.effects, light=alone)
    share = expected_image(*given, 1.0, 0.0, light=INSIDES) / float(np.prod(grid.voxel_size))
    image = filled_in(np.asarray(job.image, np.float64), rendered)
    known = np.isfinite(image)
    left = np.where(known, image - rendered, 0.0)
    counted = known if job.counted is None else known & job.counted
    widths = np.asarray(state.optics.sigma_um) / np.asarray(grid.voxel_size)
    noise = differences(torch.from_numpy(left)).numpy()
    shown = shown.astype(np.float64)
    share = share.astype(np.float64)
    flat = all_flat(mesh, job.optics)
    found = unevenness(left + shown, shown, share, noise, widths, counted, flat)
    if found is None:
        return {}
    labels = voxel_labels(mesh, grid.shape, grid.voxel_size, grid.origin)
    cells = {int(k): found.deep & (labels == k) for k in mesh.region_ids()}
    return {k: float(found.gain[own].std()) for k, own in cells.items() if own.any()}
