"""Slow references for the mesh Fourier transform that share no formula with the package.

``quadrature_ft`` integrates numerically, with autograd; ``exact_simplex`` gives the transform of
the unit simplex, and its gradient, to 50 digits at any phases, coincident ones too.
"""

from functools import cache

import mpmath
import numpy as np
import torch

DIGITS = 50
BITS = 240  # of the fixed-point arithmetic: 72 digits


def quadrature_ft(vertices, faces, wavevectors, density=None, order=24):
    """Gauss-Legendre quadrature on the square, folded to the triangle (Duffy); complex128 (K,).

    With 24 points each way the error is below 1e-13 for edge phases up to about 15 rad.
    """
    node, weight = np.polynomial.legendre.leggauss(order)
    node, weight = torch.from_numpy((node + 1) / 2), torch.from_numpy(weight / 2)
    u, v = torch.meshgrid(node, node, indexing="ij")
    barycentric = torch.stack([1 - u, u * (1 - v), u * v], -1).reshape(-1, 3)
    jacobian = (weight[:, None] * weight[None, :] * u).reshape(-1)
    corners = vertices[faces]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    mass = torch.linalg.vector_norm(normal, dim=1)
    if density is not None:
        mass = mass * density
    phase = torch.einsum("qp,fpi,ki->kfq", barycentric, corners, wavevectors)
    weights = (mass[:, None] * jacobian).to(torch.complex128)
    return torch.einsum("kfq,fq->k", torch.exp(-1j * phase), weights)


@cache
def exact_simplex(a, b, c):
    """F = integral over the unit simplex of exp(-i lambda.phases), and dF/dphase_p: (mpc, 3 mpc).

    F is minus the divided difference g[a, b, c] of g(t) = exp(-it), dF/da is -g[a, b, c, a].
    Divided differences are the entries of g(M), M having the phases on its diagonal and ones above
    it (Opitz); the exponential of M by its Taylor series after halving M, then by squaring, all in
    fixed point. Nothing is divided by a gap, so coincident phases need no care.
    """
    phases = [_fixed(p) for p in (a, b, c, a, b, c)]
    halvings = (max(map(abs, phases)) >> BITS).bit_length() + 1
    # Upper triangle as {(row, column): entry}, no more than three places from the diagonal.
    cells = [(i, j) for i in range(6) for j in range(i, min(i + 4, 6))]
    term = {(i, j): (i == j) << BITS for i, j in cells}  # (M / 2^halvings)^n / n!, real
    parts = [dict.fromkeys(cells, 0) for _ in range(4)]
    n = 0
    while any(term.values()):
        for k in cells:
            parts[n % 4][k] += term[k]
        n += 1
        term = {
            (i, j): ((term[i, j] * phases[j] >> BITS) + (term[i, j - 1] if j > i else 0))
            // (n << halvings)
            for i, j in cells
        }
        term = {k: 0 if t == -1 else t for k, t in term.items()}  # // rounds down
    # exp(-iM): (-i)^n = 1, -i, -1, i, ...
    re = {k: parts[0][k] - parts[2][k] for k in cells}
    im = {k: parts[3][k] - parts[1][k] for k in cells}
    for _ in range(halvings):
        inner = {(i, j): [((i, k), (k, j)) for k in range(i, j + 1)] for i, j in cells}
        re, im = (
            {k: sum(re[p] * re[q] - im[p] * im[q] for p, q in inner[k]) >> BITS for k in cells},
            {k: sum(re[p] * im[q] + im[p] * re[q] for p, q in inner[k]) >> BITS for k in cells},
        )
    with mpmath.workdps(DIGITS + 10):
        one = mpmath.mpf(2) ** -BITS
        value = {k: mpmath.mpc(-re[k] * one, -im[k] * one) for k in cells}
    # Rows 0, 1, 2 hold g[a,b,c,a], g[b,c,a,b], g[c,a,b,c].
    return value[0, 2], tuple(value[p, p + 3] for p in range(3))


def _fixed(x):
    """A number as an integer multiple of 2^-BITS."""
    with mpmath.workprec(3 * BITS):
        return int(mpmath.nint(mpmath.mpf(x) * 2**BITS))


def exact_triangle(vertices, wavevector):
    """u_hat of one triangle (3, 3) at one wavevector, and du/dv (3, 3): rounded from 50 digits."""
    with mpmath.workdps(DIGITS):
        v = [[mpmath.mpf(float(x)) for x in row] for row in vertices]
        xi = [mpmath.mpf(float(x)) for x in wavevector]
        value, slopes = exact_simplex(*(mpmath.fdot(p, xi) for p in v))
        doubled = _cross(_minus(v[1], v[0]), _minus(v[2], v[0]))
        size = mpmath.sqrt(mpmath.fdot(doubled, doubled))
        unit = [n / size if size else mpmath.mpf(0) for n in doubled]
        gradient = np.empty((3, 3), complex)
        for p in range(3):
            # d|N|/dv_p = (v_{p+1} - v_{p+2}) x N/|N|
            growth = _cross(_minus(v[(p + 1) % 3], v[(p + 2) % 3]), unit)
            for k in range(3):
                gradient[p, k] = complex(growth[k] * value + size * slopes[p] * xi[k])
        return complex(size * value), gradient


def _minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def _cross(a, b):
    return [a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)]
