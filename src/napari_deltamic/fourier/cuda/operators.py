"""Registers the kernels with torch, beside those for the CPU (:mod:`..closed_form`).

Autograd, ``torch.compile`` and dispatch by device then work. If the kernels are missing, the
computation runs on the CPU, which is slow and gives one warning.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor

from ..closed_form import _band_ft_backward, _mesh_ft, _mesh_ft_backward, band_ft
from . import transform
from .device import kernels


def _registered(operator: Any, compute: Callable[..., Any]) -> Callable[..., Any]:
    """Register how kernels compute an operator, whose last argument is whether it is single."""

    def run(*given: Any) -> Any:
        *arguments, single = given
        device = arguments[0].device
        k = kernels(device, single)
        if k is not None:
            return compute(k, *arguments)
        found = operator(
            *(a.detach().resolve_conj().cpu() if isinstance(a, Tensor) else a for a in given)
        )
        return found.to(device) if isinstance(found, Tensor) else tuple(t.to(device) for t in found)

    operator.register_kernel("cuda")(run)
    return run


_mesh_ft_cuda = _registered(_mesh_ft, transform.list_forward)
_mesh_ft_backward_cuda = _registered(_mesh_ft_backward, transform.list_backward)
_band_ft_cuda = _registered(band_ft, transform.band_forward)
_band_ft_backward_cuda = _registered(_band_ft_backward, transform.band_backward)
