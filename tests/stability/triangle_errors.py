"""Errors of the closed form on single triangles, against 50-digit arithmetic.

Errors are relative to what the quantity can be at most, F being at most 1/2 and its slopes 1/6:
value and density gradient (2A F) to the area A; the vertex gradient to
``longest edge / 2 + A |xi| / 3``. Coordinates in double precision define u no better than to
``EPS (longest edge^2 / A + |phase of the centroid|)``; where that exceeds the bar (float64 slivers
and triangles far from the origin), it takes the bar's place.
"""

import os
from contextlib import contextmanager
from functools import cache
from unittest import mock

import numpy as np
import torch
from triangle_families import families

import napari_deltamic as nd
from napari_deltamic.fourier.closed_form import band_ft
from reference import exact_triangle

BAR = {"float32": 1e-5, "float64": 1e-12}
EPS = 2.0**-52
LEVELS = nd.fourier.native().simd_levels() if nd.fourier.native() else []
PATHS = [(loop, level) for loop in ("list", "band") for level in [*LEVELS, "torch"]]
QUANTITIES = ("value", "gradient", "density")
ONE_FACE = torch.tensor([[0, 1, 2]])


@contextmanager
def engine(level):
    """Run in the compiled loops of one instruction set, or in torch."""
    if level == "torch":
        with mock.patch("napari_deltamic.fourier.closed_form.native", return_value=None):
            yield
    else:
        with mock.patch.dict(os.environ, DELTAMIC_SIMD=level):
            yield


def transform(loop, vertices, faces, density, xi, single):
    """u_hat at one wavevector, of kx >= 0 in a band, by either loop; a scalar tensor."""
    if loop == "list":
        if single:
            vertices = vertices.to(torch.float32)
        return nd.fourier.mesh_ft(vertices, faces, np.array([xi], float), density)[0]
    along = np.flatnonzero(xi)
    if len(along) == 3:  # powers of two, so that index times spacing is the wavevector
        k = [int(s) for s in np.array([4, 2, 16]) * np.sign(xi)]
        spacing = [x / i for x, i in zip(xi, k, strict=True)]
        rows = [[k[0], k[1] - 1, 3], [k[0], k[1], 19], [k[0] + 1, k[1], 1]]
        at = 16
    else:
        # Sixteenths of the wavevector, so that it lies inside a row (or at the start of one); rows
        # around it, of lengths that do not fill the vector lanes.
        axis = int(along[0])
        spacing = [xi[axis] * s for s in (0.3, 0.2, 0.1)]
        spacing[axis] = xi[axis] / 16
        rows = {
            0: [[-16, 0, 3], [16, 0, 5], [16, 1, 1]],
            1: [[-1, 16, 3], [0, 16, 5], [0, 17, 1]],
            2: [[0, -1, 3], [0, 0, 19], [1, 0, 1]],
        }[axis]
        at = 16 if axis == 2 else 0
    rows = torch.tensor(rows, dtype=torch.int32)
    return band_ft(vertices, faces, density, rows, spacing, single)[3 + at]


def exact(vertices, xi):
    """Values (N,) and gradients (N, 3, 3) of triangles (N, 3, 3), rounded from 50 digits."""
    found = [exact_triangle(v, xi) for v in vertices]
    return np.array([u for u, _ in found]), np.array([g for _, g in found])


def computed(loop, vertices, xi, single):
    """Values (N,), vertex gradients (N, 3, 3) and density gradients (N,) by the engine."""
    n = len(vertices)
    forward = np.array(
        [
            transform(loop, torch.from_numpy(v), ONE_FACE, torch.ones(1), xi, single).item()
            for v in vertices
        ]
    )
    # One mesh of them all: the gradients still tell its triangles apart.
    v = torch.from_numpy(vertices.reshape(-1, 3)).requires_grad_()
    rho = torch.ones(n, dtype=torch.float64, requires_grad=True)
    u = transform(loop, v, torch.arange(3 * n).reshape(n, 3), rho, xi, single)
    (re_v, re_rho), (im_v, im_rho) = (
        torch.autograd.grad(part, (v, rho), retain_graph=True) for part in (u.real, u.imag)
    )
    return forward, (re_v + 1j * im_v).numpy().reshape(n, 3, 3), (re_rho + 1j * im_rho).numpy()


def rounded(vertices, single):
    """The triangles as float32 coordinates hold them, where those are given."""
    return vertices.astype(np.float32).astype(np.float64) if single else vertices


def scales(vertices, xi):
    """What value and vertex gradient can be at most: (N,) each."""
    edges = vertices - np.roll(vertices, 1, axis=1)
    longest = np.linalg.norm(edges, axis=2).max(1)
    area = np.linalg.norm(np.cross(edges[:, 1], edges[:, 2]), axis=1) / 2
    return area, longest / 2 + area * np.linalg.norm(xi) / 3


def uncertainty(vertices, xi):
    """(N,) relative error that rounding of the coordinates in double precision alone may cause."""
    edges = vertices - np.roll(vertices, 1, axis=1)
    longest = np.linalg.norm(edges, axis=2).max(1)
    return EPS * (longest**2 / scales(vertices, xi)[0] + np.abs(vertices.mean(1) @ xi))


def errors_of_each(loop, vertices, xi, single):
    """Quantity -> (N,) relative errors of triangles (N, 3, 3)."""
    vertices = rounded(vertices, single and loop == "list")
    value, gradient = exact(vertices, xi)
    area, per_gradient = scales(vertices, xi)
    forward, backward, density = computed(loop, vertices, xi, single)
    return {
        "value": np.abs(forward - value) / area,
        "gradient": np.abs(backward - gradient).max((1, 2)) / per_gradient,
        "density": np.abs(density - value) / area,
    }


def measured_errors(loop, vertices, xi, single):
    """Quantity -> worst error over triangles, those that coordinates leave open allowed for."""
    bar = BAR["float32" if single else "float64"]
    kept = rounded(vertices, single and loop == "list")
    allowance = np.maximum(1, uncertainty(kept, xi) / bar)
    found = errors_of_each(loop, vertices, xi, single)
    return {name: float(np.max(each / allowance)) for name, each in found.items()}


@cache
def errors(loop, level, single):
    """Family -> quantity -> worst error."""
    # The fallback for a band goes through the one for a list, and slowly.
    step = 12 if (loop, level) == ("band", "torch") else 1
    with engine(level):
        return {
            name: measured_errors(loop, v[::step], xi, single)
            for name, (v, xi) in families().items()
        }


def worst_errors():
    """``"loop, level, type"`` -> quantity -> worst error over all families: for a table."""
    table = {}
    for loop, level in PATHS:
        for name in BAR:
            found = errors(loop, level, name == "float32").values()
            table[f"{loop}, {level}, {name}"] = {
                q: float(np.max([e[q] for e in found])) for q in QUANTITIES
            }
    return table
