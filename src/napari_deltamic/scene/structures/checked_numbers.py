"""Checks the numbers of structures and converts them to tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError
from ...geometry.arrays import FARTHEST, FloatArray, is_tensor, to_numpy

Values = float | np.ndarray | Tensor
_LARGEST_DENSITY = 1e30  # so that its products with areas and volumes are numbers


def as_tensor(values: Any) -> Tensor:
    """Return a tensor as it is; anything else as a float64 tensor."""
    return values if is_tensor(values) else torch.tensor(np.asarray(values, dtype=np.float64))


def one_each(values: Values, count: int) -> Tensor:
    """Expand one number for all to (count,); return several as they are."""
    return torch.as_tensor(values, dtype=torch.float64).expand(count)


def checked_positions(values: Any, name: str) -> FloatArray:
    """Return positions (N, 3) um. InputError unless they are finite and of that shape."""
    try:
        found = to_numpy(values).astype(np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers of shape (N, 3), in um") from None
    if found.ndim != 2 or found.shape[1] != 3:
        raise InputError(f"{name} must have shape (N, 3), not {found.shape}")
    if not (np.abs(found) < FARTHEST).all():  # false for NaN, too
        raise InputError(f"{name} must be finite numbers (um)")
    return found


def check_numbers(values: Any, count: int | None, name: str, of: str) -> None:
    """Raise InputError unless values are one finite number, or one for each of ``count``."""
    try:
        found = to_numpy(values).astype(np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} takes numbers, not {values!r}") from None
    if found.ndim and count is not None and found.shape != (count,):
        raise InputError(
            f"{name} must be one number, or one per {of} ({count}), not shape {found.shape}"
        )
    if not (np.abs(found) < _LARGEST_DENSITY).all():  # false for NaN, too
        raise InputError(f"{name} must be finite, and below {_LARGEST_DENSITY:g}")
