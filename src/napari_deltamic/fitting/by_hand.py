"""A state of a fit whose vertices or PSF were changed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ..geometry.carry import carried
from .job import FitInput
from .model.change import Change
from .model.state import FitState

_CHANGED = "changed by hand after the fit"


def is_by_hand(state: FitState) -> bool:
    """Whether a state was changed by hand, so that no fit has judged it; sessions keep that."""
    return state.message == _CHANGED


def is_again(state: FitState, before: FitState) -> bool:
    """Whether changes by hand have led back to an earlier state: undo hands over its very mesh."""
    one, other = state.optics, before.optics
    if state.mesh is not before.mesh or type(one) is not type(other):
        return False
    return one is other or torch.equal(one.parameters(), other.parameters())


def changed_by_hand(state: FitState, job: FitInput, change: Change) -> FitState:
    """A state with other vertices or another PSF; its loss is not known."""
    mesh, optics, density = state.mesh, state.optics, state.density
    pinned = state.pinned
    if change.mesh is not None:
        if pinned is not None:
            pinned = carried(pinned, mesh, change.mesh)
        if len(change.mesh.faces) != len(density):
            density = np.ones(len(change.mesh.faces))  # of other triangles: not known
        mesh = change.mesh
    if change.optics is not None:
        optics = change.optics.detach()
    if change.pinned is not None:
        pinned = change.pinned
    return replace(
        state,
        mesh=mesh,
        optics=optics,
        density=density,
        pinned=pinned,
        loss=float("nan"),
        converged=False,
        message=_CHANGED,
        moving=None,
        grid=job.grid,
        accuracy=job.settings.fit.image_accuracy,
        _image=None,
        _checkpoint=dict,
    )
