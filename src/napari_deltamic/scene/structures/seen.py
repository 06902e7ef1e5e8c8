"""Effects that act on the object before its transform: how much of each part is seen."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ..effects import Effects
from ..effects.base import FaceEffect
from ..grid import Grid


def act_on_object(effects: Effects) -> bool:
    """Whether these effects change the object's transform."""
    faces = any(isinstance(effect, FaceEffect) for effect in effects.present())
    return faces or effects.depth is not None


def shares(
    weights: Tensor, places: Callable[[], Tensor], frame: Grid, effects: Effects
) -> list[Tensor]:
    """Apply the effects that act on the object to weights (N,) at places (N, 3) um.

    Two results if the PSF changes with depth: the weights seen through the PSF of the first slice,
    and through that of the last.
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
    """Return the only box, or two boxes stacked."""
    return seen[0] if len(seen) == 1 else torch.stack(seen)
