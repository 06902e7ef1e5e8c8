"""Spreading and gathering: against direct sums and FINUFFT, by threads, devices and precision."""

from functools import cache, partial

import finufft
import numpy as np
import pytest
import torch
from torch.autograd import gradcheck
from torch.utils._python_dispatch import TorchDispatchMode
from ways import use_gpu_kernels, use_torch

from napari_deltamic.fourier.particle_mesh import elements_ft, field_of
from napari_deltamic.fourier.points import Points
from napari_deltamic.fourier.quadrature import Rule, rule
from napari_deltamic.fourier.spreading import choose_spreading, flat
from napari_deltamic.fourier.torch_mesh import measure
from napari_deltamic.geometry import sphere

SPACING = (0.31, 0.27, 0.4)
HALVES = [(3, 2, 4), (2, 3, 5), (0, 2, 3), (2, 0, 3), (2, 3, 0), (0, 0, 0)]
ONE = Rule(0, 1, np.ones((1, 1)), np.ones(1))
LINE = Rule(1, 1, np.array([[0.8, 0.2], [0.3, 0.7]]), np.array([0.4, 0.6]))


def elements(corners, count=9, seed=6):
    """Some elements of so many corners, with their points; partly outside the period."""
    rng = np.random.default_rng(seed)
    vertices = torch.from_numpy(rng.uniform(-3, 40, (3 * count + 3, 3))).requires_grad_()
    joined = torch.from_numpy(rng.permutation(3 * count)[: corners * count].reshape(-1, corners))
    density = torch.from_numpy(rng.normal(size=count)).requires_grad_()
    if corners == 1:
        rules = [(ONE, np.arange(count))]
    elif corners == 2:
        rules = [(LINE, np.arange(count))]
    else:
        some = rng.random(count) < 0.5
        rules = [(rule(4), np.flatnonzero(some)), (rule(2, 2), np.flatnonzero(~some))]
    return vertices, joined, density, Points(rules, count)


def direct_sum(vertices, joined, density, points, half, spacing=SPACING):
    """The sum over all points, by autograd."""
    axes = [torch.arange(-half[0], half[0] + 1), torch.arange(-half[1], half[1] + 1)]
    axes.append(torch.arange(half[2] + 1))
    k = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).double()
    k = k * torch.tensor(spacing, dtype=torch.float64)
    corners = vertices[joined]
    if joined.shape[1] == 3:
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        density = density * torch.linalg.cross(a, b).norm(dim=1) / 2
    elif joined.shape[1] == 2:
        density = density * (corners[:, 1] - corners[:, 0]).norm(dim=1)
    total = torch.zeros(k.shape[:-1], dtype=torch.complex128)
    for r, of in points.rules:
        at = torch.from_numpy(r.barycentric) @ corners[of]
        weights = density[of][:, None] * torch.from_numpy(r.weights)
        total = total + (torch.exp(-1j * (k @ at.reshape(-1, 3).T)) * weights.reshape(-1)).sum(-1)
    return total


def some_box(half, seed=2):
    shape = 2 * half[0] + 1, 2 * half[1] + 1, half[2] + 1, 2
    return torch.from_numpy(np.random.default_rng(seed).normal(size=shape).view(complex)[..., 0])


def with_gradients(transform, given):
    vertices, joined, density, points = given
    u = transform(vertices, joined, density, points)
    half = u.shape[0] // 2, u.shape[1] // 2, u.shape[2] - 1
    loss = (u * some_box(half).to(u).conj()).real.sum()
    return (u.detach(), *torch.autograd.grad(loss, (vertices, density)))


def spread_for(half, error=1e-12, points=100, single=False):
    return choose_spreading(half, SPACING, flat, error, points, single)


def close(found, expected, bar):
    for a, b in zip(found, expected, strict=True):
        assert a.shape == b.shape
        if a.numel():
            assert float((a - b).abs().max()) <= bar * max(float(b.abs().max()), 1e-3)


# ------------------------------------------------------------------------------------- correctness


@pytest.mark.parametrize("corners", [1, 2, 3])
@pytest.mark.parametrize("half", HALVES)
def test_it_is_the_sum_over_the_points_and_its_gradient(way, half, corners):
    given = elements(corners)
    ours = partial(elements_ft, spreading=spread_for(half), single=False)
    expected = with_gradients(partial(direct_sum, half=half), given)
    close(with_gradients(ours, given), expected, 1e-10)


@pytest.mark.parametrize("count", [0, 1])
def test_few_elements_or_none(way, count):
    given = elements(3, count)
    ours = partial(elements_ft, spreading=spread_for((3, 2, 4)), single=False)
    close(
        with_gradients(ours, given),
        with_gradients(partial(direct_sum, half=(3, 2, 4)), given),
        1e-10,
    )


@cache
def many_and_their_sum(half):
    """Some elements, and the sum over all of their points; the sum takes long."""
    given = elements(3, 300)
    return given, direct_sum(*given, half).detach()


@pytest.mark.parametrize("error", [1e-1, 1e-2, 1e-4, 6e-6])
def test_single_precision_keeps_to_its_error(way, error):
    half = (8, 9, 7)
    given, exact = many_and_their_sum(half)
    u = elements_ft(*given, spread_for(half, error, 5000, True), True)
    assert u.dtype == torch.complex64
    assert float((u - exact).detach().norm() / exact.norm()) < error


@pytest.mark.parametrize(
    "error", [*(pytest.param(e, marks=pytest.mark.slow) for e in (1e-1, 1e-3)), 1e-12]
)
@pytest.mark.parametrize("corners", [1, 2, 3])
def test_the_gradient_is_that_of_what_is_computed(way, corners, error):
    """Whatever the kernel: it is differentiated as it is."""
    vertices, joined, density, points = elements(corners, 4)
    s = spread_for((2, 3, 2), error)

    def real_and_imaginary(v, rho):
        return torch.view_as_real(elements_ft(v, joined, rho, points, s, False))

    assert gradcheck(real_and_imaginary, (vertices, density), atol=1e-7)


def test_a_face_without_area_has_no_gradient_of_its_area(way):
    v = torch.tensor([[0.3, 0.7, 5.0], [1.1, -2.0, 4.0]], dtype=torch.float64)[[0, 1, 1]]
    v.requires_grad_()
    points = Points([(rule(2), np.arange(1))], 1)
    given = v, torch.tensor([[0, 1, 2]]), torch.ones(1, dtype=torch.float64)
    u = elements_ft(*given, points, spread_for((1, 1, 1)), False)
    (gradient,) = torch.autograd.grad(u.real.sum(), v)
    assert not u.abs().any()
    assert not gradient.any()


def test_against_finufft():
    """Another implementation, on as many points as a scene has."""
    mesh = sphere((9.0, 11.0, 8.0), 5.0, subdivisions=3)
    v, f = torch.tensor(mesh.vertices_numpy()), torch.as_tensor(mesh.faces)
    points, half = Points([(rule(4), np.arange(len(f)))], len(f)), (14, 12, 13)
    r, _ = points.rules[0]
    at = (torch.from_numpy(r.barycentric) @ v[f]).reshape(-1, 3).numpy() * np.array(SPACING)
    weights = (mesh.areas()[:, None] * r.weights).reshape(-1).astype(complex)
    whole = finufft.nufft3d1(*at.T.copy(), weights, (29, 25, 27), eps=1e-13, isign=-1)
    ones = torch.ones(len(f), dtype=torch.float64)
    for error, single in ((1e-3, True), (1e-5, True), (1e-11, False)):
        u = elements_ft(v, f, ones, points, spread_for(half, error, points.count, single), single)
        wrong = np.linalg.norm(u.numpy() - whole[..., 13:]) / np.linalg.norm(whole[..., 13:])
        assert wrong < error


@pytest.mark.parametrize("half", HALVES)
def test_the_way_back_to_the_grid_is_the_adjoint(way, half):
    s = spread_for(half)
    grid = torch.from_numpy(np.random.default_rng(1).normal(size=s.shape))
    box = some_box(half)
    forth = (s.fft.to_box(grid) * box.conj()).real.sum()
    back = (field_of(box, s, False)[..., : s.shape[2]] * grid).sum()
    assert float(forth) == pytest.approx(float(back), rel=1e-12)


# -------------------------------------------------------------------------- lines of the grid


def test_nothing_jumps_where_a_point_crosses_a_line_of_the_grid(way):
    """Neither value nor gradient: what a line search sees is smooth."""
    s = choose_spreading((9, 9, 9), SPACING, flat, 3e-2, 10, False)
    joined, points = torch.tensor([[0]]), Points([(ONE, np.arange(1))], 1)
    ones, box = torch.ones(1, dtype=torch.float64), some_box((9, 9, 9))
    for axis in range(3):
        line = 5 / s.scale[axis] + (s.kernels[axis].width % 2) / 2 / s.scale[axis]
        sides = []
        for side in (-1e-9, 1e-9):
            v = torch.full((1, 3), 3.3, dtype=torch.float64)
            v[0, axis] = line + side
            v.requires_grad_()
            loss = (elements_ft(v, joined, ones, points, s, False) * box.conj()).real.sum()
            sides.append((loss.detach(), torch.autograd.grad(loss, v)[0]))
        for below, above in zip(*sides, strict=True):
            assert float((below - above).abs().max()) < 1e-6 * float(below.abs().max())


# ------------------------------------------------------------------- threads, devices, precision


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("faces", [80, 5120])
def test_bits_are_the_same_for_any_number_of_threads(single, faces):
    mesh = sphere((9.0, 11.0, 8.0), 5.0, subdivisions=1 if faces == 80 else 4)
    f = torch.as_tensor(mesh.faces)
    points = Points([(rule(4), np.arange(len(f)))], len(f))
    half = (20, 24, 17)
    s = choose_spreading(half, SPACING, flat, 1e-4, points.count, single)
    found = []
    used = torch.get_num_threads()
    try:
        for threads in (1, 2, 3, 1):
            torch.set_num_threads(threads)
            v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
            rho = torch.ones(len(f), dtype=torch.float64, requires_grad=True)
            found.append(
                with_gradients(
                    partial(elements_ft, spreading=s, single=single), (v, f, rho, points)
                )
            )
    finally:
        torch.set_num_threads(used)
    for other in found[1:]:
        assert all(map(torch.equal, found[0], other))


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("kernels", [False, True])
def test_other_devices_agree_with_the_compiled_loops(single, kernels, monkeypatch):
    mesh = sphere((9.0, 11.0, 8.0), 5.0, subdivisions=3)
    f = torch.as_tensor(mesh.faces)
    some = np.arange(len(f)) % 3 == 0
    points = Points([(rule(4), np.flatnonzero(some)), (rule(1), np.flatnonzero(~some))], len(f))
    s = choose_spreading((14, 12, 13), SPACING, flat, 1e-3, points.count, single)
    found = []
    for ours in (True, False):
        use_torch(monkeypatch, not ours)
        if kernels:
            use_gpu_kernels(monkeypatch)
        v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
        rho = torch.linspace(1, 2, len(f), dtype=torch.float64, requires_grad=True)
        transform = partial(elements_ft, spreading=s, single=single)
        found.append(with_gradients(transform, (v, f, rho, points)))
    close(found[1], found[0], 2e-5 if single else 1e-12)


class NoDouble(TorchDispatchMode):
    """A device that knows no double precision."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        out = func(*args, **(kwargs or {}))
        for t in (*args, *(out if isinstance(out, (tuple, list)) else (out,))):
            if isinstance(t, torch.Tensor):
                assert t.dtype not in (torch.float64, torch.complex128), func
        return out


def test_torch_operations_do_without_double_precision(monkeypatch):
    given = elements(3, 50)
    s = spread_for((8, 9, 7), 1e-4, 1000, True)
    expected = with_gradients(partial(elements_ft, spreading=s, single=False), given)
    use_torch(monkeypatch)
    vertices, joined, density, points = given
    v, rho = (t.detach().float().requires_grad_() for t in (vertices, density))
    box = some_box((8, 9, 7)).to(torch.complex64)
    with NoDouble():
        u = elements_ft(v, joined, rho, points, s, True)
        found = u.detach(), *torch.autograd.grad((u * box.conj()).real.sum(), (v, rho))
    close(found, expected, 1e-4)


@pytest.mark.parametrize("corners", [1, 2, 3])
def test_measures_and_their_gradients(corners):
    given = torch.from_numpy(np.random.default_rng(3).normal(size=(5, corners, 3)))
    given.requires_grad_()
    size, gradient = measure(given)
    expected = torch.zeros_like(given)
    if corners > 1:
        (expected,) = torch.autograd.grad(size.sum(), given)
    torch.testing.assert_close(gradient, expected)


# ------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e300])
def test_vertices_that_are_no_places_are_refused(bad):
    vertices, joined, density, points = elements(3)
    v = vertices.detach().clone()
    v[4, 1] = bad
    with pytest.raises(ValueError, match="vertices must be finite"):
        elements_ft(v, joined, density, points, spread_for((3, 2, 4)), False)


@pytest.mark.parametrize("bad", [-1, 30, 2**40])
def test_elements_that_name_no_vertex_are_refused(bad):
    vertices, joined, density, points = elements(3)
    joined[2, 1] = bad
    with pytest.raises(ValueError, match="names a vertex that is not there"):
        elements_ft(vertices, joined, density, points, spread_for((3, 2, 4)), False)


def test_what_does_not_fit_together_is_refused():
    vertices, joined, density, points = elements(3)
    s = spread_for((3, 2, 4))
    with pytest.raises(ValueError, match="one strength and one rule per element"):
        elements_ft(vertices, joined, density[:-1], points, s, False)
    with pytest.raises(ValueError, match="vertices"):
        elements_ft(vertices[:, :2], joined, density, points, s, False)
