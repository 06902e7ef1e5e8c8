"""Arrays and tensors that a mesh is given: told apart, checked and copied."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FARTHEST = 1e12  # um; products of three such lengths are still numbers


def is_tensor(array: object) -> bool:
    """True for a torch tensor; tests its attributes, so that geometry need not import torch."""
    return hasattr(array, "detach") and hasattr(array, "requires_grad")


def to_numpy(array: Any) -> NDArray[Any]:
    """Convert an array, a sequence or a tensor (detached, moved to the CPU) to a NumPy array."""
    return np.asarray(array.detach().cpu().numpy() if is_tensor(array) else array)


def checked_integers(values: Any, columns: int, name: str) -> IntArray:
    """Return an int64 copy, (n, columns). InputError, which calls it ``name``, if that fails."""
    try:
        array = to_numpy(values)
        if array.size == 0:
            return np.zeros((0, columns), dtype=np.int64)
        if not (np.isfinite(array).all() and (array == np.floor(array)).all()):
            raise InputError(f"{name} must be whole numbers")
        result = array.astype(np.int64)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{name} must be whole numbers of shape (n, {columns})") from error
    if result.ndim != 2 or result.shape[1] != columns:
        raise InputError(f"{name} must have shape (n, {columns}), not {result.shape}")
    return result


def checked_vertices(vertices: Any) -> Any:
    """Return a float64 copy, or the tensor itself. InputError unless finite and (n, 3)."""
    if not is_tensor(vertices):
        try:
            if np.iscomplexobj(vertices):
                raise TypeError("complex numbers")
            vertices = np.array(vertices, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError("vertices must be numbers of shape (n, 3)") from error
    elif not vertices.is_floating_point():
        raise InputError("a vertex tensor must hold floating point numbers")
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(f"vertices must have shape (n, 3), not {tuple(vertices.shape)}")
    places = to_numpy(vertices)
    n_bad = int((~np.isfinite(places)).any(axis=1).sum())
    if n_bad:
        raise InputError(f"{n_bad} of {len(vertices)} vertices are NaN or infinite")
    n_far = int((np.abs(places) >= FARTHEST).any(axis=1).sum())
    if n_far:
        raise InputError(f"{n_far} of {len(vertices)} vertices are {FARTHEST:g} um away or more")
    return vertices
