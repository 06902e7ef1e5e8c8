"""Runs operators for GPUs on the CPU if something is missing."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


def on_cpu(operator: Any, *arguments: Any, back_to: torch.device) -> Any:
    """Run an operator's CPU kernel and return its results, one tensor or several, on a device."""
    given = (a.detach().resolve_conj().cpu() if isinstance(a, Tensor) else a for a in arguments)
    found = operator(*given)
    if isinstance(found, Tensor):
        return found.to(back_to)
    return tuple(t.to(back_to) for t in found)
