"""The paper's own scheme, in vectorised torch: what the engine is compared with.

Written from the equations of Ichbiah et al. (ICCV 2025) with two corrections, without which it is
wrong: the exponents are exp(-i s), and g takes the phases of the vertices, not of the edges. The
division by the total area is left out; it is one choice of amplitude.

    u_T = 2 A f,   f = g(v1.xi, v2.xi, v3.xi)
    g(s, t, u) = -e^{-is} / ((s-t)(s-u)) - e^{-it} / ((t-u)(t-s)) - e^{-iu} / ((u-s)(u-t))

and, where two phases are closer than sqrt(eps), the formulas of the special cases. These are rare,
so they are patched in where they occur, which is faster than the usual way of vectorised code:
every formula everywhere, then a selection (``select=True`` of :func:`transform`).
"""

from __future__ import annotations

import time

import torch
from torch import Tensor


def transform(
    vertices: Tensor,
    faces: Tensor,
    wavevectors: Tensor,
    chunk: int,
    dtype: torch.dtype = torch.float32,
    select: bool = False,
) -> Tensor:
    """u_hat, (K,) complex, at wavevectors (K, 3), ``chunk`` of them at a time."""
    corners, xi, area, _ = _prepare(vertices, faces, wavevectors, dtype)
    parts = []
    for some in xi.split(chunk):
        g = (_values_selected if select else _values)(*_phases(corners, some))
        parts.append((2 * area).to(g.dtype) @ g)
    return torch.cat(parts)


def gradient(
    vertices: Tensor,
    faces: Tensor,
    wavevectors: Tensor,
    grad: Tensor,
    chunk: int,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Gradient (V, 3) of ``sum Re(conj(grad) u_hat)`` by the paper's explicit formulas."""
    corners, xi, area, outward = _prepare(vertices, faces, wavevectors, dtype)
    grad = grad.to(torch.complex64 if dtype == torch.float32 else torch.complex128)
    corner = torch.zeros(len(faces), 3, 3, dtype=dtype)
    for some, incoming in zip(xi.split(chunk), grad.conj().split(chunk), strict=True):
        phases, exponentials = _phases(corners, some)
        g = _values(phases, exponentials)
        slopes = _slopes(phases, exponentials, g)
        corner -= (g @ incoming).real[:, None, None] * outward
        for p in range(3):
            corner[:, p] += 2 * area[:, None] * ((slopes[p] * incoming).real @ some)
    out = torch.zeros(len(vertices), 3, dtype=dtype)
    return out.index_add_(0, faces.reshape(-1), corner.reshape(-1, 3))


def best_chunk(
    vertices: Tensor,
    faces: Tensor,
    wavevectors: Tensor,
    seconds: float = 2.0,
    dtype: torch.dtype = torch.float32,
    select: bool = False,
) -> int:
    """The fastest ``chunk`` of :func:`transform`, found in about so many seconds.

    Speed peaks where the temporaries (faces x chunk) fit in cache.
    """
    candidates = [2**i for i in range(9) if 2**i <= len(wavevectors)]
    rates = {}
    for chunk in candidates:
        start, done, best = time.perf_counter(), 0, float("inf")
        while done < 3 or time.perf_counter() - start < seconds / len(candidates):
            at = done * chunk % (len(wavevectors) - chunk + 1)
            begun = time.perf_counter()
            transform(vertices, faces, wavevectors[at : at + chunk], chunk, dtype, select)
            best = min(best, time.perf_counter() - begun)
            done += 1
        rates[chunk] = chunk / best
    return max(rates, key=lambda c: rates[c])


# ------------------------------------------------------------------------------- the equations


def _prepare(
    vertices: Tensor, faces: Tensor, wavevectors: Tensor, dtype: torch.dtype
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Corners (F, 3, 3), wavevectors, areas (F,), normals on edges w_p = e_p x N (F, 3, 3)."""
    corners = vertices.to(dtype)[faces]
    edges = torch.stack([corners[:, (p - 1) % 3] - corners[:, (p + 1) % 3] for p in range(3)], 1)
    normal = torch.linalg.cross(edges[:, 2], edges[:, 0])
    area = torch.linalg.vector_norm(normal, dim=1) / 2
    unit = normal / (2 * area[:, None])
    outward = torch.linalg.cross(edges, unit[:, None].expand_as(edges))
    return corners, wavevectors.to(dtype), area, outward


def _phases(corners: Tensor, xi: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    """Phases s, t, u of the vertices, each (F, k), and e^{-is}, e^{-it}, e^{-iu}."""
    phases = [corners[:, p] @ xi.T for p in range(3)]
    return phases, [torch.complex(torch.cos(a), -torch.sin(a)) for a in phases]


def _close(phases: list[Tensor]) -> list[Tensor]:
    """For each vertex, whether the phases of the two others are closer than sqrt(eps)."""
    limit = torch.finfo(phases[0].dtype).eps ** 0.5
    return [(phases[(p + 1) % 3] - phases[(p + 2) % 3]).abs() < limit for p in range(3)]


def _all_close(close: list[Tensor]) -> Tensor:
    """Two pairs that are close make three phases that are."""
    return (close[0] & close[1]) | (close[1] & close[2]) | (close[2] & close[0])


def _general(phases: list[Tensor], exponentials: list[Tensor]) -> Tensor:
    """g(s, t, u): the sum of three exponentials."""
    s, t, u = phases
    es, et, eu = exponentials
    st, tu, us = s - t, t - u, u - s
    return es / (st * us) + et / (tu * st) + eu / (us * tu)


def _pair(t: Tensor, u: Tensor, et: Tensor, eu: Tensor) -> Tensor:
    """g(t, t, u)."""
    d = t - u
    return 1j * et / d + (et - eu) / d**2


def _values(phases: list[Tensor], exponentials: list[Tensor]) -> Tensor:
    g = _general(phases, exponentials)
    close = _close(phases)
    for p in range(3):
        at = close[p].nonzero(as_tuple=True)
        if len(at[0]):
            t, u, et, eu = (a[q][at] for a in (phases, exponentials) for q in ((p + 1) % 3, p))
            g[at] = _pair(t, u, et, eu)
    at = _all_close(close).nonzero(as_tuple=True)
    if len(at[0]):
        g[at] = exponentials[2][at] / 2
    return g


def _values_selected(phases: list[Tensor], exponentials: list[Tensor]) -> Tensor:
    g = _general(phases, exponentials)
    close = _close(phases)
    for p in range(3):
        two = (p + 1) % 3
        pair = _pair(phases[two], phases[p], exponentials[two], exponentials[p])
        g = torch.where(close[p], pair, g)
    return torch.where(_all_close(close), exponentials[2] / 2, g)


def _slopes(phases: list[Tensor], exponentials: list[Tensor], g: Tensor) -> list[Tensor]:
    """dg/dphase_p: the bracket of the paper's formula for df/dv_p."""
    close = _close(phases)
    slopes = []
    for p in range(3):
        a, b, c = (phases[(p + k) % 3] for k in range(3))
        ea, eb, ec = (exponentials[(p + k) % 3] for k in range(3))
        ba, ac, cb = b - a, a - c, c - b  # e_{p-}.xi, e_{p+}.xi, e_p.xi
        slopes.append(
            eb / (ba * ba * cb)
            - ec / (cb * ac * ac)
            - 1j * ea / (ba * ac)
            + ea / (ba * ba * ac)
            - ea / (ba * ac * ac)
        )
    for p in range(3):  # derivatives of g(t, t, u), u being the phase of vertex p
        at = close[p].nonzero(as_tuple=True)
        if len(at[0]):
            d = phases[(p + 1) % 3][at] - phases[p][at]
            slope = (exponentials[(p + 1) % 3][at] / 2 - g[at]) / d
            slopes[(p + 1) % 3][at] = slope
            slopes[(p + 2) % 3][at] = slope
            slopes[p][at] = -1j * g[at] - 2 * slope
    at = _all_close(close).nonzero(as_tuple=True)
    if len(at[0]):
        for p in range(3):
            slopes[p][at] = -1j * exponentials[p][at] / 6
    return slopes
