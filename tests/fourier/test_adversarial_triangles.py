"""Triangles on which formulas for the transform break, against 50-digit arithmetic.

Errors are relative to what the quantity can be at most, F being at most 1/2 and its slopes 1/6:
value and density gradient (2A F) to the area A; the vertex gradient to
``longest edge / 2 + A |xi| / 3``. Coordinates in double precision define u no better than to
``EPS (longest edge^2 / A + |phase of the centroid|)``; where that exceeds the bar (float64 slivers
and triangles far from the origin), it takes the bar's place.
"""

import os
from contextlib import contextmanager
from functools import cache
from itertools import permutations
from unittest import mock

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import napari_deltamic as nd
from napari_deltamic.fourier.closed_form import band_ft
from reference import exact_simplex, exact_triangle

BAR = {"float32": 1e-5, "float64": 1e-12}
REACHED = {"float32": 1e-6, "float64": 3e-13}  # with room for other processors
EPS = 2.0**-52
LEVELS = nd.fourier.native().simd_levels() if nd.fourier.native() else []
PATHS = [(loop, level) for loop in ("list", "band") for level in [*LEVELS, "torch"]]
QUANTITIES = ("value", "gradient", "density")
ONE_FACE = torch.tensor([[0, 1, 2]])


# ------------------------------------------------------------------------------------ families


def _phases():
    """(N, 3) phases, with the names of their families."""
    gaps, spreads = 10.0 ** np.arange(-12, 3), (0.5, 1.9, 2.1, 7.0, 60.0, 1000.0)
    turn = 2 * np.pi
    near = (-1e-3, -1e-6, -1e-7, -1e-15, 0.0, 1e-15, 1e-7, 1e-6, 1e-3)
    families = {
        "one near pair": [(0.0, g, s) for g in gaps for s in spreads],
        "two near pairs": [(0.0, g, g * r) for g in gaps for r in (1.01, 7.0, 1e3) if g * r < 1e3],
        "three near pairs": [(-g, 0.0, g * r) for g in gaps for r in (1.0, 1.5)],
        "coincident": [(0.0, 0.0, s) for s in (0.0, 1e-12, *spreads)]
        + [(s, s, s) for s in spreads],
        "zeros": [(0.0, turn * m, turn * n) for m in (1, 2, 7) for n in (-1, -3, 5, 150)],
        "near tau": [
            (0.0, 2 * (1 + e) * f, 2 * (1 + e)) for e in near for f in (0, 1e-8, 0.01, 0.3, 0.5, 1)
        ],
        # The large branch switches its sinc where a phase relative to the median one passes 2.
        "near 2 from the median": [
            (0.0, 2 * (1 + e), 2 * (1 + e) - d) for e in near for d in (2.5, 5.0, 800.0)
        ],
    }
    rng = np.random.default_rng(7)
    families["any"] = list(10 ** rng.uniform(-4, 3, (100, 3)) * rng.choice([-1, 1], (100, 3)))
    return families


def _standing(phases, rng):
    """Triangles whose phases at xi = (0, 0, 1) are these, in any order of the vertices; half of
    them shifted along x, where a small gap survives only as far as the type holds it."""
    p = rng.permuted(np.asarray(phases, float), axis=1)
    p = (
        p
        + np.where(rng.random(len(p)) < 0.5, 0.0, rng.choice([-300.0, -1.0, 30.0], len(p)))[:, None]
    )
    corners = np.zeros((len(p), 3, 3))
    corners[:, 1, 0], corners[:, 2, 1] = 1.0, 1.0
    corners[:, :, 2] = p
    return corners


def _rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q


@cache
def families():
    """Name -> (vertices (N, 3, 3), wavevector (3,)); the wavevector lies along an axis."""
    rng = np.random.default_rng(3)
    x = (0.0, 0.0, 1.0)
    out = {name: (_standing(p, rng), x) for name, p in _phases().items()}
    mixed = np.concatenate([v for v, _ in out.values()])
    for axis, name in ((0, "phases along z"), (1, "phases along y")):
        out[name] = (np.roll(mixed[axis::9], axis + 1, axis=2), tuple(np.eye(3)[axis]))
    for name, unit in (("huge units", 2.0**40), ("tiny units", 2.0**-40)):
        out[name] = (mixed[::9] * unit, (0.0, 0.0, 1 / unit))
    slivers = [
        length * np.array([[0, 0, 0], [0, 0, 1], [0, 1 / aspect, at]]) @ _rotation(rng)
        for length in (0.3, 3.0, 50.0)
        for aspect in (1e1, 1e2, 1e3, 1e4, 1e5, 1e6)
        for at in (0.0, 1e-5, 0.5, 1.0)
    ]
    out["slivers"] = (np.array(slivers), x)
    # In eighths, which float32 still holds at a million.
    steps = rng.integers(-64, 64, (60, 3, 3)) / 8
    out["far across"] = (steps + np.array([1e6, -1e6, 0.0]), x)
    out["far along"] = (steps + np.array([0.0, 0.0, 1e6]), x)
    return out


# -------------------------------------------------------------------------------------- errors


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
    """u_hat at one wavevector along an axis, by either loop; a scalar tensor."""
    if loop == "list":
        if single:
            vertices = vertices.to(torch.float32)
        return nd.fourier.mesh_ft(vertices, faces, torch.tensor([xi]), density)[0]
    # Sixteenths of the wavevector, so that it lies inside a row (or at the start of one); rows
    # around it, of lengths that do not fill the vector lanes.
    axis = int(np.flatnonzero(xi)[0])
    spacing = [xi[axis] * s for s in (0.3, 0.2, 0.1)]
    spacing[axis] = xi[axis] / 16
    rows = torch.tensor(
        {
            0: [[-16, 0, 3], [16, 0, 5], [16, 1, 1]],
            1: [[-1, 16, 3], [0, 16, 5], [0, 17, 1]],
            2: [[0, -1, 3], [0, 0, 19], [1, 0, 1]],
        }[axis],
        dtype=torch.int32,
    )
    return band_ft(vertices, faces, density, rows, spacing, single)[3 + (16 if axis == 2 else 0)]


def measured_errors(loop, vertices, xi, single):
    """Worst error of each quantity over triangles (N, 3, 3)."""
    if single and loop == "list":
        vertices = vertices.astype(np.float32).astype(np.float64)
    n = len(vertices)
    exact = [exact_triangle(v, xi) for v in vertices]
    value = np.array([u for u, _ in exact])
    gradient = np.array([g for _, g in exact])
    area, per_gradient = _scales(vertices, xi, BAR["float32" if single else "float64"])

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
    backward = (re_v + 1j * im_v).numpy().reshape(n, 3, 3)
    density = (re_rho + 1j * im_rho).numpy()
    return {
        "value": np.max(np.abs(forward - value) / area),
        "gradient": np.max(np.abs(backward - gradient).max((1, 2)) / per_gradient),
        "density": np.max(np.abs(density - value) / area),
    }


def _scales(vertices, xi, bar):
    edges = vertices - np.roll(vertices, 1, axis=1)
    longest = np.linalg.norm(edges, axis=2).max(1)
    area = np.linalg.norm(np.cross(edges[:, 1], edges[:, 2]), axis=1) / 2
    uncertainty = EPS * (longest**2 / area + np.abs(vertices.mean(1) @ xi))
    allowance = np.maximum(1, uncertainty / bar)
    return allowance * area, allowance * (longest / 2 + area * np.linalg.norm(xi) / 3)


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


# --------------------------------------------------------------------------------------- tests


@pytest.mark.parametrize("name", BAR)
@pytest.mark.parametrize(("loop", "level"), PATHS)
def test_every_family_keeps_to_the_bar(loop, level, name):
    found = errors(loop, level, name == "float32")
    above = {f: e for f, e in found.items() if not max(e.values()) < BAR[name]}
    # max() may pass over a NaN.
    broken = {f: e for f, e in found.items() if not np.isfinite(list(e.values())).all()}
    assert not above
    assert not broken


def test_table_of_worst_errors():
    table = worst_errors()
    assert len(table) == 2 * len(PATHS)
    assert all(set(row) == set(QUANTITIES) for row in table.values())
    for path, row in table.items():
        # Something was measured (no path is exact), and nothing was lost since.
        assert all(0 < e < REACHED[path.split(", ")[-1]] for e in row.values()), path


def test_families_hold_what_they_name():
    two_pi, tau = families()["zeros"][0], families()["near tau"][0]
    assert max(abs(exact_triangle(v, (0, 0, 1))[0]) for v in two_pi[:3]) < 1e-5
    largest = np.abs(tau[:, :, 2] - np.roll(tau[:, :, 2], 1, axis=1)).max(1)
    assert (largest < 2).sum() > 10
    assert (largest >= 2).sum() > 10
    assert np.ptp(families()["any"][0][:, :, 2], axis=1).max() > 1000


NO_AREA = {
    "on a line": [[0, 0, 0], [1, 2, 3], [2, 4, 6]],
    "one point": [[1, 2, 3]] * 3,
    "first is second": [[0.3, 0.7, 5.0], [0.3, 0.7, 5.0], [1.1, -2.0, 4.0]],
    "second is third": [[1.1, -2.0, 4.0], [0.3, 0.7, 5.0], [0.3, 0.7, 5.0]],
    "third is first": [[0.3, 0.7, 5.0], [1.1, -2.0, 4.0], [0.3, 0.7, 5.0]],
}


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("shape", NO_AREA)
@pytest.mark.parametrize(("loop", "level"), PATHS)
def test_no_area_gives_nothing_and_pulls_nothing(loop, level, shape, single):
    v = torch.tensor(NO_AREA[shape], dtype=torch.float64, requires_grad=True)
    rho = torch.ones(1, dtype=torch.float64, requires_grad=True)
    with engine(level):
        u = transform(loop, v, ONE_FACE, rho, (0.0, 0.0, 1.0), single)
        by_v, by_rho = torch.autograd.grad(u.real + u.imag, (v, rho))
    assert u == 0
    assert not by_v.any()
    assert not by_rho.any()


phase = st.floats(-1000, 1000, width=32)
gap = st.floats(-12, 2).map(lambda e: 10.0**e)


@st.composite
def awkward_phases(draw):
    """Three phases, of which any may be as close to the one before as 1e-12, or the same."""
    first = draw(phase)
    second = (
        first + draw(st.sampled_from([-1, 0, 1])) * draw(gap)
        if draw(st.booleans())
        else draw(phase)
    )
    third = (
        second + draw(st.sampled_from([-1, 0, 1])) * draw(gap)
        if draw(st.booleans())
        else draw(phase)
    )
    return draw(st.sampled_from(list(permutations((first, second, third)))))


@settings(max_examples=60, deadline=None)
@given(awkward_phases(), st.sampled_from(PATHS), st.booleans())
def test_any_phases(phases, path, single):
    loop, level = path
    corners = np.zeros((1, 3, 3))
    corners[0, 1, 0], corners[0, 2, 1] = 1.0, 1.0
    corners[0, :, 2] = phases
    with engine(level):
        found = measured_errors(loop, corners, (0.0, 0.0, 1.0), single)
    assert np.all(np.array(list(found.values())) < BAR["float32" if single else "float64"])


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("level", [*LEVELS, "torch"])
def test_a_row_is_exact_from_end_to_end(level, single):
    """Along a row a triangle goes from the small branch to the large one, at a different place for
    each triangle; every place in the vector lanes is met."""
    rng = np.random.default_rng(5)
    n = 40
    v = torch.from_numpy(
        rng.normal(size=(3 * n, 3)) * 10 ** rng.uniform(-2, 0.7, (n, 1)).repeat(3, 0)
    )
    v.requires_grad_()
    faces = torch.arange(3 * n).reshape(n, 3)
    rho = torch.from_numpy(rng.uniform(0.5, 2, n))
    rows = torch.tensor([[kz, ky, 41 - abs(kz)] for kz in (-3, 0, 2) for ky in (-1, 0, 4)])
    spacing = (0.21, 0.17, 0.13)
    xi = torch.tensor(
        [
            (kz * spacing[0], ky * spacing[1], x * spacing[2])
            for kz, ky, m in rows.tolist()
            for x in range(m)
        ],
        dtype=torch.float64,
    )
    weight = torch.from_numpy(rng.normal(size=(len(xi), 2)).view(complex)[:, 0])

    def loss(u):
        return (u * weight.to(u.dtype)).real.sum()

    with engine(level):
        band = band_ft(v, faces, rho, rows.to(torch.int32), spacing, single)
        (by_band,) = torch.autograd.grad(loss(band), v)
    # The list in double precision is checked above, on single triangles.
    listed = nd.fourier.mesh_ft(v, faces, xi, rho)
    (by_list,) = torch.autograd.grad(loss(listed), v)
    bar = BAR["float32" if single else "float64"]
    assert (band - listed).abs().max() < bar * listed.abs().max()
    assert (by_band - by_list).abs().max() < bar * by_list.abs().max()


def test_instruction_set_by_environment():
    with mock.patch.dict(os.environ, DELTAMIC_SIMD="generic"):
        assert nd.fourier.simd_level() == "generic"
    with (
        mock.patch.dict(os.environ, DELTAMIC_SIMD="mmx"),
        pytest.raises(nd.InputError, match=r"mmx.*generic"),
    ):
        nd.fourier.simd_level()


# ----------------------------------------------------------------------- the reference itself


def test_reference_agrees_with_numerical_integration():
    mpmath = pytest.importorskip("mpmath")
    a, b, c = 0.3, -7.1, 2.4
    value, slopes = exact_simplex(a, b, c)
    with mpmath.workdps(30):

        def integrate(moment):
            return mpmath.quad(
                lambda u: mpmath.quad(
                    lambda w: (
                        u
                        * moment(1 - u, u * (1 - w), u * w)
                        * mpmath.expj(-(a * (1 - u) + b * u * (1 - w) + c * u * w))
                    ),
                    [0, 1],
                ),
                [0, 1],
            )

        assert abs(integrate(lambda *w: 1) - value) < 1e-25
        for p in range(3):
            assert abs(integrate(lambda *w, p=p: -1j * w[p]) - slopes[p]) < 1e-25


def test_reference_at_coincident_phases():
    # F(t, t, t) = exp(-it) / 2, at a thousand radians too.
    value, slopes = exact_simplex(1000.0, 1000.0, 1000.0)
    assert abs(complex(value) - np.exp(-1000j) / 2) < 1e-16
    assert abs(complex(slopes[1]) + 1j * np.exp(-1000j) / 6) < 1e-16
