"""The GPU kernels, run on the host: against the loops for CPUs and against 50-digit arithmetic."""

import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest
import torch
from cuda_emulation import Emulated, engine

import napari_deltamic as nd
from napari_deltamic.fourier import Band
from napari_deltamic.fourier.closed_form import band_ft
from napari_deltamic.fourier.cuda import transform
from napari_deltamic.fourier.cuda.build import CLOSED_FORM
from napari_deltamic.geometry import sphere

sys.path.append(str(Path(__file__).parents[1] / "stability"))

import triangle_errors as errors
from triangle_families import NO_AREA, families

BAR = {True: 2e-6, False: 1e-13}  # of a whole mesh, relative to the largest entry
TYPES = pytest.mark.parametrize("single", [True, False])
# Fewer, equal and more than fit a segment, a tile, a block.
ROWS = {
    "one wavevector": [[0, 0, 1]],
    "segments that end early": [[-1, 2, 1], [0, -1, 7], [0, 0, 8], [0, 1, 9], [2, -3, 33]],
    "many rows": [[k, m, 5 + abs(k + m)] for k in range(-5, 6) for m in range(-4, 5)],
}


def soup(faces, spread=1.0, seed=1):
    """Triangles that share vertices, small and large ones among each other; densities."""
    rng = np.random.default_rng(seed)
    v = rng.normal(size=(faces + 2, 3)) * spread * 10 ** rng.uniform(-1.5, 0, (faces + 2, 1))
    f = np.array([rng.permutation(faces + 2)[:3] for _ in range(faces)])
    return torch.from_numpy(v), torch.from_numpy(f), torch.from_numpy(rng.uniform(0.5, 2, faces))


def band_and_gradients(mesh, rows, single, spacing=(0.9, 0.7, 0.5)):
    """u_hat on a band, and gradients of a weighted sum of its entries."""
    v, f, rho = (t.clone().requires_grad_(t.is_floating_point()) for t in mesh)
    u = band_ft(v, f, rho, torch.tensor(rows, dtype=torch.int32), spacing, single)
    weight = torch.linspace(-1, 1, len(u)).to(u.real.dtype)
    return [
        t.detach() for t in (u, *torch.autograd.grad(((u.real - u.imag) * weight).sum(), (v, rho)))
    ]


def list_and_gradients(mesh, count, single):
    v, f, rho = (t.clone().requires_grad_(t.is_floating_point()) for t in mesh)
    xi = 2 * torch.from_numpy(np.random.default_rng(2).normal(size=(count, 3)))
    given = v.to(torch.float32) if single else v
    u = nd.fourier.mesh_ft(given, f, xi, rho)
    weight = torch.linspace(-1, 1, len(u)).to(u.real.dtype)
    return [
        t.detach() for t in (u, *torch.autograd.grad(((u.real - u.imag) * weight).sum(), (v, rho)))
    ]


def assert_same(found, expected, bar):
    for ours, reference in zip(found, expected, strict=True):
        assert ours.dtype == reference.dtype
        assert torch.isfinite(torch.view_as_real(ours) if ours.is_complex() else ours).all()
        scale = reference.abs().max()
        assert (ours - reference).abs().max() <= bar * scale, (ours - reference).abs().max() / scale


# ----------------------------------------------------------------------------- grids and tails


@TYPES
@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("faces", [1, 16, 70])
def test_band_is_that_of_the_cpu(single, rows, faces):
    mesh = soup(faces)
    expected = band_and_gradients(mesh, ROWS[rows], single)
    for multiprocessors in (1, 40):
        with engine(multiprocessors):
            found = band_and_gradients(mesh, ROWS[rows], single)
        assert_same(found, expected, BAR[single])


@TYPES
@pytest.mark.parametrize(("faces", "count"), [(1, 1), (17, 65), (70, 3)])
def test_list_is_that_of_the_cpu(single, faces, count):
    mesh = soup(faces)
    expected = list_and_gradients(mesh, count, single)
    for multiprocessors in (1, 40):
        with engine(multiprocessors):
            found = list_and_gradients(mesh, count, single)
        assert_same(found, expected, BAR[single])


@TYPES
def test_nothing_to_compute(single):
    kernels = Emulated(single)
    v, f, rho = soup(2)
    none = torch.zeros(0, 3, dtype=torch.int64)
    rows = torch.tensor(ROWS["segments that end early"], dtype=torch.int32)
    spacing = (1.0, 1.0, 1.0)
    assert not transform.band_forward(kernels, v, none, rho[:0], rows, spacing).any()
    assert transform.band_forward(kernels, v, f, rho, rows[:0], spacing).shape == (0,)
    grad = torch.zeros(0, dtype=torch.complex128)
    assert not transform.band_backward(kernels, grad, v, f, rho, rows[:0], spacing)[0].any()
    assert transform.list_forward(kernels, v, f, rho, torch.zeros(0, 3)).shape == (0,)
    assert not transform.list_backward(kernels, grad, v, f, rho, torch.zeros(0, 3))[0].any()


@TYPES
def test_launch_shapes_cut_the_work_into_parts_that_cover_it(single):
    kernels = Emulated(single, multiprocessors=3)
    v, f, rho = soup(70)
    rows = torch.tensor(ROWS["many rows"], dtype=torch.int32)
    u = transform.band_forward(kernels, v, f, rho, rows, (0.9, 0.7, 0.5))
    transform.band_backward(kernels, u, v, f, rho, rows, (0.9, 0.7, 0.5))
    grids = dict(kernels.launched)
    width, tile = kernels.build.width, kernels.build.tile
    segments = sum(-(-int(n) // width) for n in rows[:, 2])
    assert grids["band_forward"] == (-(-segments // 64), -(-70 // tile))
    assert grids["band_backward"][0] == 2
    assert 1 < grids["band_backward"][1] <= -(-segments // tile)
    assert "add_parts" in grids


@pytest.mark.slow
def test_the_build_of_the_gpu_runs_too():
    """Blocks and tiles as they are on a device, on a mesh of a few blocks."""
    mesh = sphere((0.4, -0.2, 0.9), 1.5, subdivisions=2)
    v, f = torch.tensor(mesh.vertices), torch.as_tensor(mesh.faces)
    rho = torch.ones(len(f), dtype=torch.float64)
    band = Band.within((20, 24, 18), (0.3, 0.25, 0.3), (6.0, 8.0, 7.0))
    for single, build in CLOSED_FORM.items():
        kernels = Emulated(single, build)
        expected = band_ft(v, f, rho, band.rows, band.spacing, single)
        found = transform.band_forward(kernels, v, f, rho, band.rows, band.spacing)
        assert_same([found], [expected], BAR[single])
        by_cpu = torch.ops.deltamic.band_ft_backward(
            expected, v, f, rho, band.rows, band.spacing, single
        )
        gradients = transform.band_backward(kernels, expected, v, f, rho, band.rows, band.spacing)
        assert_same(gradients, by_cpu, BAR[single])


@TYPES
def test_any_layout_of_the_arrays(single):
    """Strides, other types, and values that torch has yet to conjugate or to negate."""
    kernels = Emulated(single)
    v, f, rho = soup(20)
    rows, spacing = (
        torch.tensor(ROWS["segments that end early"], dtype=torch.int32),
        (0.9, 0.7, 0.5),
    )
    u = transform.band_forward(kernels, v, f, rho, rows, spacing)
    grad = torch.randn(len(u), dtype=torch.complex128, generator=torch.Generator().manual_seed(0))
    gradients = transform.band_backward(kernels, grad, v, f, rho, rows, spacing)
    strided = torch.stack([v, v], -1)[..., 0]
    negative = torch.complex(rho, -rho).conj().imag  # a view whose sign is still to be turned
    assert negative.is_neg()
    assert not strided.is_contiguous()
    others = strided, f.to(torch.int32).T.contiguous().T, negative
    assert torch.equal(transform.band_forward(kernels, *others, rows, spacing), u)
    conjugated = torch.stack([grad.conj().resolve_conj()] * 2, -1)[:, 0].conj()
    assert conjugated.is_conj()
    found = transform.band_backward(kernels, conjugated, *others, rows, spacing)
    assert all(map(torch.equal, found, gradients))


@TYPES
def test_same_bits_again(single):
    kernels = Emulated(single, multiprocessors=8)
    v, f, rho = soup(70)
    rows = torch.tensor(ROWS["many rows"], dtype=torch.int32)
    runs = [transform.band_forward(kernels, v, f, rho, rows, (0.9, 0.7, 0.5)) for _ in range(2)]
    assert torch.equal(*runs)


# ----------------------------------------------------------------------------------- hard cases


@pytest.mark.parametrize("loop", ["list", "band"])
@TYPES
def test_adversarial_triangles(loop, single):
    """A part of each family of tests/stability; the slow test below takes them whole."""
    check_families(loop, single, step=9)


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["list", "band"])
@TYPES
def test_all_adversarial_triangles(loop, single):
    check_families(loop, single, step=1)


def check_families(loop, single, step):
    bar = errors.BAR["float32" if single else "float64"]
    worst = {}
    with engine():
        for name, (v, xi) in families().items():
            found = errors.measured_errors(loop, v[::step], xi, single)
            worst |= {(name, q): e for q, e in found.items()}
    assert max(worst.values()) <= bar, max(worst.items(), key=lambda item: item[1])


@TYPES
def test_faces_without_area_give_exactly_zero(single):
    corners = torch.tensor(np.array([v * 3 if len(v) == 1 else v for v in NO_AREA.values()], float))
    mesh = (
        corners.reshape(-1, 3),
        torch.arange(3 * len(corners)).reshape(-1, 3),
        torch.ones(len(corners)),
    )
    with engine():
        for t in band_and_gradients(mesh, ROWS["segments that end early"], single):
            assert not t.any()


def test_gradients_are_those_of_the_value():
    """Finite differences, in double precision."""
    mesh = soup(5)
    v, rho = mesh[0].requires_grad_(), mesh[2].requires_grad_()
    rows = torch.tensor([[-1, 0, 3], [0, 0, 9], [2, -1, 1]], dtype=torch.int32)
    with engine():
        assert torch.autograd.gradcheck(
            lambda v, rho: band_ft(v, mesh[1], rho, rows, (0.9, 0.7, 0.5), False), (v, rho)
        )


@TYPES
def test_phases_far_from_the_origin_are_reduced_exactly(single):
    """A million um away the value only turns: by a whole number of turns, not at all."""
    v, f, rho = soup(20)
    rows = ROWS["segments that end early"]
    spacing = (2 * np.pi / 8, 2 * np.pi / 4, 2 * np.pi / 16)
    v = torch.round(v * 64) / 64  # kept by the shift to the last bit
    near = band_and_gradients((v, f, rho), rows, single, spacing)
    with engine():
        far = band_and_gradients((v + 2.0**20, f, rho), rows, single, spacing)
    # spacing is a rounded number: its last bit alone turns the phase by 2^20 * 2^-53 * 33.
    assert_same(far[:1], near[:1], max(BAR[single], 1e-8))


def test_the_phase_of_a_far_centroid_is_exact():
    """At the last of 33 wavevectors it is 3e6 rad: known to 1e-9 in double, to 1e-12 in turns."""
    centre = np.array([2.0**20 + 3 / 8, -(2.0**19), 2.0**20 + 5 / 8])  # kept by the mean of three
    around = np.array([[-1, 0, 1], [0, 1, -1], [1, -1, 0]]) / 64
    v, f = torch.from_numpy(centre + around), torch.tensor([[0, 1, 2]])
    rho, rows = torch.ones(1, dtype=torch.float64), torch.tensor([[2, -1, 33]], dtype=torch.int32)
    spacing = (0.1, 0.3, 0.07)
    shifted, here = (
        transform.band_forward(Emulated(False), x, f, rho, rows, spacing).numpy()
        for x in (v, torch.from_numpy(around))
    )
    with mpmath.workdps(40):
        step = [mpmath.mpf(s) * c for s, c in zip(spacing, centre, strict=True)]
        phases = [mpmath.fdot(step, (2, -1, x)) for x in range(33)]
        turn = [complex(mpmath.expj(-phase)) for phase in phases]
    np.testing.assert_allclose(shifted, here * turn, rtol=0, atol=1e-12 * np.abs(here).max())


def test_a_triangle_that_grows_large_along_a_segment():
    """Small at the start of the only segment, large at its end: no lane may take the series."""
    corners = torch.tensor([[0.0, 0.0, 0.0], [0.0, 1.0, 1.4], [1.0, 0.0, 2.8]], dtype=torch.float64)
    mesh = corners, torch.tensor([[0, 1, 2]]), torch.ones(1, dtype=torch.float64)
    for single in (True, False):
        expected = band_and_gradients(mesh, [[0, 0, 8]], single)
        with engine():
            assert_same(band_and_gradients(mesh, [[0, 0, 8]], single), expected, BAR[single])
