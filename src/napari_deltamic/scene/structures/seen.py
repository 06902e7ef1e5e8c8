"""Effects that act on the object, before it is transformed: how much of each part is seen."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ..effects import Effects
from ..effects.base import FaceEffect
from ..grid import Grid


def act_on_object(effects: Effects) -> bool:
    """Whether the object's transform is another with these effects."""
    faces = any(isinstance(effect, FaceEffect) for effect in effects.present())
    return faces or effects.depth is not None


def shares(
    weights: Tensor, places: Callable[[], Tensor], frame: Grid, effects: Effects
) -> list[Tensor]:
    """Weights (N,) with the effects that act on the object, each at its place (N, 3) um.

    Two where the PSF changes with depth: those seen through that of the first slice, and through
    that of the last.
    """
    if not act_on_object(effects):
        return [weights]
    at = places()
    for effect in effects.present():
        if isinstance(effect, FaceEffect):
            weights = weights * effect.face_weights(at, frame)
    if effects.depth is None:
        return [weights]
    last = weights * effects.depth.depths(at, frame)
    return [weights - last, last]


def joined_boxes(seen: list[Tensor]) -> Tensor:
    """One box, or two stacked."""
    return seen[0] if len(seen) == 1 else torch.stack(seen)
