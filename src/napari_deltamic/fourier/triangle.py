"""The transform of one triangle in torch, used if the compiled extension is missing.

The same two branches as ``csrc/triangle_ft.h`` (read that file for the formulas): a Taylor series
about the centroid for small edge phases, a sorted divided difference for large ones.
"""

from __future__ import annotations

from math import comb, factorial

import torch
from torch import Tensor

TAU = 2.0


def _series(q: Tensor, r: Tensor, order: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return S, dS/dq and dS/dr of the Taylor series, as complex tensors."""
    complex_type = torch.complex64 if q.dtype == torch.float32 else torch.complex128
    s = torch.zeros_like(q, dtype=complex_type)
    sq, sr = torch.zeros_like(s), torch.zeros_like(s)
    for power in range(order // 3 + 1):
        a, slope = torch.zeros_like(q), torch.zeros_like(q)
        for j in range((order - 3 * power) // 2, -1, -1):  # Horner
            c = (-1) ** j * comb(j + power, power) / factorial(2 * j + 3 * power + 2)
            slope = slope * q + a
            a = a * q + c
        s = s + (1j**power) * (r**power * a)
        sq = sq + (1j**power) * (r**power * slope)
        if power:
            sr = sr + (1j**power) * (power * r ** (power - 1) * a)
    return s, sq, sr


def _small(d: Tensor, order: int) -> tuple[Tensor, Tensor]:
    a, b, c = (d[1] - d[2]) / 3, (d[2] - d[0]) / 3, (d[0] - d[1]) / 3
    q, r = a * a - b * c, a * b * c
    s, sq, sr = _series(q, r, order)
    gradient = torch.stack(
        [
            -1j * s / 3 + x * sq + (y * z + q / 3) * sr
            for x, y, z in ((a, b, c), (b, c, a), (c, a, b))
        ]
    )
    return s, gradient


def sinc(h: Tensor) -> tuple[Tensor, Tensor]:
    """Return sin h / h and its derivative, from the series where |h| < 1."""
    near = h.abs() < 1
    z = torch.where(near, h * h, 0.0)
    s, slope = torch.zeros_like(h), torch.zeros_like(h)
    for j in range(10, -1, -1):
        slope = slope * z + s
        s = s * z + (-1) ** j / factorial(2 * j + 1)
    far = torch.where(near, 1.0, h)
    sinc_far = torch.sin(far) / far
    return (
        torch.where(near, s, sinc_far),
        torch.where(near, 2 * h * slope, (torch.cos(far) - sinc_far) / far),
    )


def _large(d: Tensor) -> tuple[Tensor, Tensor]:
    p = d.abs().argmax(0, keepdim=True)  # the largest gap; its opposite vertex is the median one
    gap = d.gather(0, p)[0]
    x = d.gather(0, (p + 2) % 3)[0]
    y = -d.gather(0, (p + 1) % 3)[0]
    safe = gap.abs() >= TAU / 2  # the branch that is not used must stay finite, too
    gap, x, y = (
        torch.where(safe, gap, TAU),
        torch.where(safe, x, 0.0),
        torch.where(safe, y, TAU),
    )
    ea, eb = torch.exp(1j * (2 * x - y) / 6), torch.exp(1j * (2 * y - x) / 6)
    (sx, dsx), (sy, dsy) = sinc(x / 2), sinc(y / 2)
    s = 1j * (ea * sy - eb * sx) / gap
    gx = (s - eb * torch.complex(sx, dsx) / 2) / gap
    gy = (ea * torch.complex(sy, dsy) / 2 - s) / gap
    gm = -1j * s - gx - gy
    # g in the order median, x, y belongs to vertices p, p+1, p+2.
    gradient = torch.zeros(3, *s.shape, dtype=s.dtype, device=s.device)
    for k, g in enumerate((gm, gx, gy)):
        gradient.scatter_(0, (p + k) % 3, g[None])
    return s, gradient


def triangle_transform(d: Tensor) -> tuple[Tensor, Tensor]:
    """Return the transform of the unit simplex about its centroid, and its gradient.

    Parameters
    ----------
    d
        (3, ...) edge phases xi.e_p, float32 or float64, taken from edge vectors.

    Returns
    -------
    (...) complex S = exp(iC) F, and (3, ...) complex exp(iC) dF/dphase_p.
    """
    order = 9 if d.dtype == torch.float32 else 18
    small = d.abs().amax(0) < TAU
    s0, g0 = _small(torch.where(small, d, 0.0), order)
    s1, g1 = _large(d)
    return torch.where(small, s0, s1), torch.where(small, g0, g1)


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Return the cross product along the last axis, exactly 0 for parallel vectors of equal length.

    ``torch.linalg.cross`` fuses multiplications and leaves a rounding error there, whose direction
    would pass for the normal of a degenerate face.
    """
    az, ay, ax = a.unbind(-1)
    bz, by, bx = b.unbind(-1)
    return torch.stack([ay * bx - ax * by, ax * bz - az * bx, az * by - ay * bz], -1)
