"""The effects that are considered, each with the numbers at which it changes nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ..errors import InputError
from ..optics import Optics
from ..scene.effects import KINDS, Effect, Effects
from ..scene.effects.base import VoxelEffect

CONSIDERED = tuple(
    name
    for name, kind in KINDS.items()
    if not issubclass(kind, VoxelEffect) and not kind.needs_data
)


def chosen_candidates(names: Sequence[str] | None, present: Effects) -> tuple[str, ...]:
    """Names of the effects to consider (None: all), without those already present.

    Raises
    ------
    InputError
        If one is unknown, or cannot be judged from one image.
    """
    for name in names or ():
        if name in KINDS and KINDS[name].needs_data:
            raise InputError(
                f"{name} is data, which no single image can call for: name its file among the "
                "effects of the fit"
            )
        if name not in CONSIDERED:
            raise InputError(
                f"'{name}' is not an effect that an image can show the need for: choose from "
                f"{', '.join(CONSIDERED)}"
            )
    wanted = CONSIDERED if names is None else names
    return tuple(n for n in CONSIDERED if n in wanted and n not in present.names)


def variants(name: str, optics: Optics) -> list[Effect]:
    """The effect where it changes nothing; several, for each width tried, if it has widths."""
    found = [KINDS[name].neutral()]
    base = float(np.mean(optics.sigma_um[1:]))
    for field, tried in KINDS[name].tried_widths.items():
        bounds = KINDS[name].bounds[field]
        widths = [min(max(k * base, bounds.low), bounds.high) for k in tried]
        found = [one.model_copy(update={field: w}) for one in found for w in widths]
    return found


def allowed(effect: Effect, present: Effects) -> bool:
    """Whether neither the effect itself nor one that could pass for it is present."""
    return effect.name not in present.names and not any(
        other in present.names for other in effect.contradicts
    )


def points_inwards(effect: Effect, estimate: np.ndarray) -> bool:
    """Whether an effect's bounds allow a step towards the estimate: light is not negative.

    An effect without numbers is there or not, whichever is nearer.
    """
    if not effect.bounds:
        return bool(estimate[0] > 0.5)
    before = effect.parameters().numpy()
    after = effect.with_parameters(effect.parameters() + _tensor(estimate)).parameters().numpy()
    told = estimate != 0
    return bool(((after - before)[told] * estimate[told] > 0).any())


def beyond_bounds(effect: Effect) -> bool:
    """Whether a number of the effect is at its bound: it then stands for something else."""
    if not effect.bounds:
        return False
    return any(bool(at.any()) for at in effect.at_bounds())


def at_estimate(effect: Effect, estimate: np.ndarray) -> Effect:
    """The effect with its numbers changed by the estimate, as far as their bounds allow."""
    if not effect.bounds:
        return effect
    return effect.with_parameters(effect.parameters() + _tensor(estimate))


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, dtype=float))
