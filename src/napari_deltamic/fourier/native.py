"""The compiled loops: looked up and chosen once, with one warning if they are missing."""

from __future__ import annotations

import os
import warnings
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError, SlowPathWarning


@cache
def native() -> ModuleType | None:
    """Return the compiled extension, or None, after one warning, if it was not built."""
    try:
        from . import _mesh_ft  # type: ignore[attr-defined]
    except ImportError:
        warnings.warn(
            "the compiled extension of napari-deltamic is missing: images are computed in torch, "
            "8 to 10 times slower by the particle-mesh, 40 to 150 times by the closed form; "
            "cells share no walls and meshes are not remeshed, so fits may end elsewhere "
            "(to get it back, reinstall with a C++ compiler and --no-cache-dir)",
            SlowPathWarning,
            stacklevel=3,
        )
        return None
    return _mesh_ft


def simd_level() -> str:
    """Return the instruction set in use: the best one, or the one named by DELTAMIC_SIMD.

    Raises
    ------
    InputError
        If DELTAMIC_SIMD names one that this processor or build does not have.
    """
    module = native()
    if module is None:
        return "none"
    levels = module.simd_levels()
    asked = os.environ.get("DELTAMIC_SIMD")
    if asked and asked not in levels:
        raise InputError(f"DELTAMIC_SIMD={asked}: choose one of {', '.join(levels)}")
    return asked or levels[-1]


def threads() -> int:
    """Return the number of worker threads, which is torch's."""
    return torch.get_num_threads()


def run(module: Any, name: str, single: bool, *given: Any) -> None:
    """Run a loop of the extension in single or in double precision."""
    loop = getattr(module, f"{name}_{'f32' if single else 'f64'}")
    loop(*given, threads(), simd_level())


def double(t: Tensor) -> np.ndarray:
    """Return a tensor as the loops take it."""
    return t.detach().to(torch.float64).contiguous().numpy()


def complex_type(single: bool) -> torch.dtype:
    """Return complex64 or complex128."""
    return torch.complex64 if single else torch.complex128
