"""The band that an image needs, and how far a PSF reaches, from its OTF."""

from __future__ import annotations

from math import ceil, log, pi, sqrt
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from ..common.triple import Triple
from ..fourier.falloff import Falloff

# An OTF that is not round treats the directions of a surface unevenly; found to cost up to 1.8.
_DIRECTIONS = 0.5
_REACH_SHARE = 0.3  # of the accuracy: what may wrap around from the other side
_NODES = 24  # of half an axis
_LARGEST = sqrt(3.0)  # scale of the ellipsoid that holds the box of the support


class _HasOTF(Protocol):
    def otf(self, axes: tuple[Tensor, Tensor, Tensor]) -> Tensor: ...
    def support(self) -> Triple: ...
    def width(self) -> Triple: ...
    @property
    def extent(self) -> Triple: ...


def band_radius(
    optics: _HasOTF, blur: Triple, error: float, falloff: Falloff
) -> tuple[Triple, float]:
    """Return the ellipsoid that holds all of an image but ``error`` (relative, L2).

    Like :func:`napari_deltamic.fourier.falloff.band_error`, but sums the OTF as it is, as it need
    not fall like a Gaussian.

    Parameters
    ----------
    blur
        A further Gaussian blur, um along Z, Y, X.
    error, falloff
        Allowed error of the image; its falloff in widths of the blurred PSF.

    Returns
    -------
    Half axes along Z, Y, X (rad/um), and the largest |OTF| outside.
    """
    ends = [
        min(k, sqrt(2 * log(1 / 1e-9)) / b if b > 0 else np.inf)
        for k, b in zip(optics.support(), blur, strict=True)
    ]
    # Nodes are denser towards zero, where the OTF of a widefield PSF is a narrow peak.
    t = (np.arange(_NODES) + 0.5) / _NODES
    half, half_weight = t**2, 2 * t / _NODES
    whole = np.concatenate([-half[::-1], half])
    whole_weight = np.concatenate([half_weight[::-1], half_weight])
    nodes = [whole * ends[0], whole * ends[1], half * ends[2]]
    shapes = ((-1, 1, 1), (1, -1, 1), (1, 1, -1))
    z, y, x = (torch.from_numpy(n).reshape(s) for n, s in zip(nodes, shapes, strict=True))
    otf = optics.otf((z, y, x)).abs().numpy()
    k = [n.reshape(s) for n, s in zip(nodes, shapes, strict=True)]
    for b, component in zip(blur, k, strict=True):
        otf = otf * np.exp(-0.5 * (b * component) ** 2)
    widths = np.hypot(optics.width(), blur)
    squared = sum((w * c) ** 2 for w, c in zip(widths, k, strict=True))
    weights = [w.reshape(s) for w, s in zip((whole_weight,) * 2 + (half_weight,), shapes)]  # noqa: B905
    power = otf**2 * weights[0] * weights[1] * weights[2]
    power = power * falloff.of(np.asarray(squared))
    scale = np.sqrt(sum((c / e) ** 2 for c, e in zip(k, ends, strict=True))).reshape(-1)
    order = np.argsort(scale)[::-1]
    beyond = np.sqrt(np.cumsum(power.reshape(-1)[order]) / power.sum())
    last = int(np.searchsorted(beyond, _DIRECTIONS * error))
    reached = float(scale[order[last]]) if last else _LARGEST
    outside = otf.reshape(-1)[order[: max(last, 1)]].max()
    radius = tuple(reached * e for e in ends)
    return radius, float(np.clip(outside, 1e-15, 0.5))  # type: ignore[return-value]


def reach(optics: _HasOTF, accuracy: float) -> Triple:
    """Return distances (um) by axis beyond which a flat surface adds less than the accuracy (L2).

    From the PSF summed over planes, which is the image of a flat surface.
    """
    found = []
    for axis, (k, extent) in enumerate(zip(optics.support(), optics.extent, strict=True)):
        step = pi / (1.5 * extent)
        n = ceil(k / step)
        along = torch.arange(-n, n + 1, dtype=torch.float64) * step
        axes = [torch.zeros(1, 1, 1, dtype=torch.float64) for _ in range(3)]
        shape = [1, 1, 1]
        shape[axis] = -1
        axes[axis] = along.reshape(shape)
        otf = optics.otf((axes[0], axes[1], axes[2])).reshape(-1).to(torch.complex128)
        x = torch.linspace(0, extent, max(64, ceil(extent * k)), dtype=torch.float64)
        phase = x[:, None] * along
        even, odd = torch.cos(phase) @ otf.real, torch.sin(phase) @ otf.imag
        power = (2 * (even**2 + odd**2)).numpy()  # of both sides: (even + odd)^2 + (even - odd)^2
        beyond = np.sqrt(np.cumsum(power[::-1])[::-1] / power.sum())
        # For accuracy 0 it is the whole extent.
        within = np.flatnonzero(beyond <= _REACH_SHARE * accuracy)
        found.append(float(x[within[0]]) if accuracy > 0 and len(within) else extent)
    z, y, x_reach = found
    return z, y, x_reach
