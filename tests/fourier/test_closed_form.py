"""The closed form on whole meshes: against analytic transforms, quadrature and itself."""

import sys
import warnings

import numpy as np
import pytest
import torch
from benchmarks.shapes import box
from numpy.testing import assert_allclose

import napari_deltamic as nd
from napari_deltamic.errors import SlowPathWarning
from napari_deltamic.fourier import Band, simd_level
from napari_deltamic.fourier.closed_form import band_ft
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene
from reference import quadrature_ft


def wavevectors(count=12, largest=4.0, seed=0):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return torch.from_numpy(direction * np.linspace(0, largest, count)[:, None])


def soup(faces=6, seed=1, dtype=torch.float64):
    """Triangles that share vertices, of edge phases below and above tau; densities."""
    rng = np.random.default_rng(seed)
    v = torch.tensor(rng.normal(size=(faces, 3)) * 1.5, dtype=dtype)
    f = torch.from_numpy(np.array([rng.permutation(faces)[:3] for _ in range(faces)]))
    return v, f, torch.tensor(rng.uniform(0.5, 2, faces), dtype=dtype)


def random_complex(n):
    return torch.from_numpy(np.random.default_rng(4).normal(size=(n, 2)).view(complex)[:, 0])


def transform_of(mesh, xi, **kwargs):
    return nd.fourier.mesh_ft(mesh.vertices, mesh.faces, xi, **kwargs)


# ------------------------------------------------------------------------------ known transforms


def test_sphere_converges_to_the_analytic_transform():
    centre, radius, xi = np.array([0.3, -0.7, 1.1]), 1.3, wavevectors()
    k = xi.norm(dim=1).numpy()
    exact = 4 * np.pi * radius**2 * np.sinc(k * radius / np.pi) * np.exp(-1j * xi.numpy() @ centre)
    errors = []
    for n in (1, 2, 3, 4):
        u = transform_of(sphere(centre, radius, subdivisions=n), xi).numpy()
        errors.append(np.abs(u - exact).max() / exact[0].real)
    ratios = np.array(errors[:-1]) / errors[1:]
    assert errors[-1] < 5e-3
    # Second order in the edge length.
    assert_allclose(ratios, 4, atol=0.35)


def test_flat_rectangle():
    """sinc x sinc, in a plane tilted against the axes and away from the origin."""
    rng = np.random.default_rng(2)
    (a, b, _), _ = np.linalg.qr(rng.normal(size=(3, 3)))
    width, height, middle = 3.0, 0.8, np.array([2.0, -1.0, 0.5])
    corners = [
        middle + s * width / 2 * a + t * height / 2 * b
        for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    xi = wavevectors(20, 9.0).numpy()
    exact = (
        width
        * np.sinc(xi @ a * width / (2 * np.pi))
        * height
        * np.sinc(xi @ b * height / (2 * np.pi))
    )
    u = nd.fourier.mesh_ft(np.array(corners), [[0, 1, 2], [0, 2, 3]], xi).numpy()
    assert_allclose(u, exact * np.exp(-1j * xi @ middle), atol=1e-13 * width * height)


def test_box():
    size, centre, xi = (
        np.array([1.0, 2.0, 0.5]),
        np.array([0.2, 0.1, -3.0]),
        wavevectors(20, 9.0).numpy(),
    )
    exact = 0
    for axis in range(3):
        side = [size[i] * np.sinc(xi[:, i] * size[i] / (2 * np.pi)) for i in range(3) if i != axis]
        exact = exact + side[0] * side[1] * 2 * np.cos(xi[:, axis] * size[axis] / 2)
    u = transform_of(box(centre, size), xi).numpy()
    assert_allclose(u, exact * np.exp(-1j * xi @ centre), atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_zero_wavevector_gives_the_total(dtype):
    v, f, rho = soup(dtype=dtype)
    corners = v[f].double()
    cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = (cross.norm(dim=1) / 2 * rho).sum()
    u = nd.fourier.mesh_ft(v, f, torch.zeros(1, 3), rho)
    assert u.dtype == (torch.complex64 if dtype == torch.float32 else torch.complex128)
    assert_allclose(u.item(), total.item(), rtol=1e-6 if dtype == torch.float32 else 1e-14)


def test_quadrature_agrees_value_and_gradients():
    v, f, rho = (t.requires_grad_(t.is_floating_point()) for t in soup())
    xi, weight = wavevectors(), random_complex(12)
    results = []
    for transform in (nd.fourier.mesh_ft, quadrature_ft):
        u = transform(v, f, xi, rho)
        results.append((u, *torch.autograd.grad((u * weight).real.sum(), (v, rho))))
    for ours, reference in zip(*results, strict=True):
        assert_allclose(ours.detach().numpy(), reference.detach().numpy(), atol=1e-12)


# ------------------------------------------------------------------------------------- operators

LOSSES = {
    "real": lambda u: u.real.sum(),
    "imaginary": lambda u: u.imag.sum(),
    "conjugate": lambda u: u.conj().imag.sum(),
    "power": lambda u: (u * u.conj()).real.sum(),
    "amplitude": lambda u: u.abs().sum(),
    "part": lambda u: (-u[1::2]).imag.sum(),
}


@pytest.mark.parametrize("loss", LOSSES)
def test_gradcheck_list(loss):
    v, f, rho = (t.requires_grad_(t.is_floating_point()) for t in soup())
    xi = wavevectors(7)

    def function(v, rho):
        return LOSSES[loss](nd.fourier.mesh_ft(v, f, xi, rho))

    assert torch.autograd.gradcheck(function, (v, rho))


ROWS = torch.tensor([[-1, 0, 3], [0, 0, 9], [2, -1, 1]], dtype=torch.int32)


@pytest.mark.parametrize("loss", LOSSES)
def test_gradcheck_band(loss):
    v, f, rho = (t.requires_grad_(t.is_floating_point()) for t in soup())

    def function(v, rho):
        return LOSSES[loss](band_ft(v, f, rho, ROWS, (0.9, 0.7, 0.5), False))

    assert torch.autograd.gradcheck(function, (v, rho))


@pytest.mark.slow
def test_operators_are_registered_correctly():
    v, f, rho = (t.requires_grad_(t.is_floating_point()) for t in soup())
    ops = torch.ops.deltamic
    for single in (False, True):
        torch.library.opcheck(ops.mesh_ft, (v, f, rho, wavevectors(5), single))
        torch.library.opcheck(ops.band_ft, (v, f, rho, ROWS, [0.9, 0.7, 0.5], single))
    grad = random_complex(13)
    plain = (v.detach(), f, rho.detach())
    torch.library.opcheck(ops.mesh_ft_backward, (grad[:5], *plain, wavevectors(5), False))
    torch.library.opcheck(ops.band_ft_backward, (grad, *plain, ROWS, [0.9, 0.7, 0.5], False))


def check_compiled(function, vertices):
    v = torch.tensor(vertices, requires_grad=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch talks about what it cannot trace
        compiled = torch.compile(function, backend="aot_eager")(v)
        (by_compiled,) = torch.autograd.grad(compiled, v)
    plain = function(v)
    (by_plain,) = torch.autograd.grad(plain, v)
    assert_allclose(compiled.item(), plain.item(), rtol=1e-6)
    assert_allclose(by_compiled, by_plain, rtol=1e-6, atol=1e-6 * by_plain.abs().max())


@pytest.mark.slow
def test_compiled_functions_agree():
    """Every operator at once: the list, the band, and the points of the particle-mesh."""
    mesh = sphere((1.0, 1.0, 1.0), 0.6, subdivisions=1)
    grid, optics, xi = nd.Grid((12, 12, 12), (0.2, 0.2, 0.2)), nd.GaussianPSF(0.3), wavevectors(5)
    renderers = [
        Renderer(Scene.of(mesh, optics), grid, 1e-3, method=m)
        for m in ("closed form", "particle-mesh")
    ]
    faces, rho = torch.as_tensor(mesh.faces), torch.ones(len(mesh.faces), dtype=torch.float64)
    otfs = [r.otf(optics) for r in renderers]

    def function(v):
        total = torch.ops.deltamic.mesh_ft(v, faces, rho, xi, False).abs().square().sum()
        for renderer, otf in zip(renderers, otfs, strict=True):
            total = total + 1e4 * renderer.image(renderer.transform(v), otf).square().sum()
        return total

    check_compiled(function, mesh.vertices)


@pytest.mark.slow
def test_compiled_render_agrees():
    """The public functions, planning included, which torch traces for half a minute."""
    mesh = sphere((1.0, 1.0, 1.0), 0.6, subdivisions=1)
    grid, xi = nd.Grid((12, 12, 12), (0.2, 0.2, 0.2)), wavevectors(5)
    faces = torch.as_tensor(mesh.faces)

    def function(v):
        power = nd.fourier.mesh_ft(v, faces, xi).abs().square().sum()
        image = nd.render(mesh.with_vertices(v), grid, nd.GaussianPSF(0.3))
        return power + 1e4 * image.square().sum()

    check_compiled(function, mesh.vertices)


# ------------------------------------------------------------------------------------ invariances


def test_translation_is_a_phase():
    v, f, rho = soup()
    xi, t = wavevectors(), torch.tensor([3.0, -20.0, 0.7], dtype=torch.float64)
    moved = nd.fourier.mesh_ft(v + t, f, xi, rho)
    assert_allclose(
        moved, nd.fourier.mesh_ft(v, f, xi, rho) * torch.exp(-1j * (xi @ t)), atol=1e-12
    )


def test_rotation_of_mesh_and_wavevectors():
    v, f, rho = soup()
    xi = wavevectors()
    q = torch.linalg.qr(wavevectors(4)[1:])[0]
    turned = nd.fourier.mesh_ft(v @ q, f, xi @ q, rho)
    assert_allclose(turned, nd.fourier.mesh_ft(v, f, xi, rho), atol=1e-12)


def test_subdivision_changes_nothing():
    v, f, rho = soup()
    xi = wavevectors(12, 8.0)
    middle = len(v) + torch.arange(len(f))
    inside = torch.einsum("p,fpi->fi", torch.tensor([0.2, 0.3, 0.5], dtype=torch.float64), v[f])
    parts = torch.cat([torch.stack([f[:, p], f[:, (p + 1) % 3], middle], 1) for p in range(3)])
    divided = nd.fourier.mesh_ft(torch.cat([v, inside]), parts, xi, rho.repeat(3))
    assert_allclose(divided, nd.fourier.mesh_ft(v, f, xi, rho), atol=1e-12)


def test_orientation_and_order_change_nothing():
    v, f, rho = soup()
    xi = wavevectors()
    u = nd.fourier.mesh_ft(v, f, xi, rho)
    order = torch.tensor([3, 0, 5, 1, 4, 2])
    assert_allclose(nd.fourier.mesh_ft(v, f.flip(1), xi, rho), u, atol=1e-13)
    assert_allclose(nd.fourier.mesh_ft(v, f[order].roll(1, 1), xi, rho[order]), u, atol=1e-13)


@pytest.mark.parametrize("unit", [1e-9, 1e6])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_units(unit, dtype):
    v, f, rho = soup(dtype=dtype)
    xi = wavevectors()
    u = nd.fourier.mesh_ft(v, f, xi, rho)
    scaled = nd.fourier.mesh_ft(v * unit, f, xi / unit, rho) / unit**2
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    assert_allclose(scaled, u, atol=tolerance * u.abs().max())


def test_opposite_wavevectors_are_conjugate_and_density_is_linear():
    v, f, rho = soup()
    xi = wavevectors()
    u = nd.fourier.mesh_ft(v, f, xi, rho)
    assert_allclose(nd.fourier.mesh_ft(v, f, -xi, rho), u.numpy().conj(), atol=1e-13)
    parts = sum(nd.fourier.mesh_ft(v, f[i : i + 1], xi) * rho[i] for i in range(len(f)))
    assert_allclose(parts, u, atol=1e-13)


# ----------------------------------------------------------------------------------- whole meshes


def cow_on_a_band(shared_data):
    mesh = nd.load_mesh(shared_data / "meshes" / "cow.obj")
    v = torch.tensor(mesh.vertices)
    v = (v - v.mean(0)) * (2.4 / (v.amax(0) - v.amin(0)).max())
    band = Band.within((40, 40, 40), (0.1, 0.1, 0.1), (20.0, 20.0, 20.0))
    return v, torch.as_tensor(mesh.faces), torch.ones(len(mesh.faces)), band


def test_gradient_of_a_whole_mesh_in_single_precision(shared_data):
    v, f, rho, band = cow_on_a_band(shared_data)
    weight = torch.from_numpy(
        np.random.default_rng(0).normal(size=(band.count, 2)).view(complex)[:, 0]
    )
    gradients = []
    for single in (True, False):
        v.requires_grad_()
        u = band_ft(v, f, rho, band.rows, band.spacing, single)
        gradients.append(torch.autograd.grad((u * weight.to(u.dtype)).real.sum(), v)[0])
    ours, exact = gradients
    cosine = torch.nn.functional.cosine_similarity(ours.reshape(1, -1), exact.reshape(1, -1)).item()
    assert (ours - exact).norm() < 1e-5 * exact.norm()
    assert cosine > 0.999999999
    # Each vertex, not only most of them.
    assert (ours - exact).norm(dim=1).max() < 1e-5 * exact.norm(dim=1).max()


def test_band_and_list_agree():
    mesh = sphere((0.4, -0.2, 0.9), 1.5, subdivisions=2)
    args = torch.tensor(mesh.vertices), torch.as_tensor(mesh.faces), torch.ones(len(mesh.faces))
    band = Band.within((20, 24, 18), (0.3, 0.25, 0.3), (6.0, 8.0, 7.0))
    z, y, x = (a.expand(band.box_shape) for a in band.axes())
    xi = torch.stack([z, y, x], -1).reshape(-1, 3)[band.row_index]
    listed = nd.fourier.mesh_ft(*args[:2], xi)
    for single, bar in ((True, 1e-6), (False, 1e-14)):
        rows = band_ft(*args, band.rows, band.spacing, single)
        assert_allclose(rows, listed, atol=bar * listed.abs().max())


@pytest.mark.parametrize("single", [True, False])
def test_same_bits_for_any_number_of_threads(single):
    mesh = sphere((0.4, -0.2, 0.9), 1.5, subdivisions=2)
    dtype = torch.float32 if single else torch.float64
    v = torch.tensor(mesh.vertices, dtype=dtype, requires_grad=True)
    f, rho = torch.as_tensor(mesh.faces), torch.ones(len(mesh.faces), requires_grad=True)
    band = Band.within((20, 24, 18), (0.3, 0.25, 0.3), (6.0, 8.0, 7.0))
    xi = wavevectors(200)
    before, runs = torch.get_num_threads(), []
    try:
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            out = []
            for u in (
                band_ft(v, f, rho, band.rows, band.spacing, single),
                nd.fourier.mesh_ft(v, f, xi, rho),
            ):
                weight = torch.linspace(-1, 1, len(u))
                out += [u, *torch.autograd.grad(((u.real + u.imag) * weight).sum(), (v, rho))]
            runs.append(out)
    finally:
        torch.set_num_threads(before)
    for other in runs[1:]:
        assert all(torch.equal(a, b) for a, b in zip(runs[0], other, strict=True))


# ----------------------------------------------------------------------- the way it can be missing


def test_missing_extension_warns_once_and_agrees(monkeypatch):
    v, f, rho = soup()
    xi = wavevectors()
    expected = nd.fourier.mesh_ft(v, f, xi, rho)
    package = sys.modules["napari_deltamic.fourier"]
    monkeypatch.delattr(package, "_mesh_ft", raising=False)
    monkeypatch.setitem(sys.modules, "napari_deltamic.fourier._mesh_ft", None)
    nd.fourier.native.cache_clear()
    try:
        with pytest.warns(SlowPathWarning, match="compiled extension"):
            slow = nd.fourier.mesh_ft(v, f, xi, rho)
        # Warnings are errors in these tests: a second one would end here.
        nd.fourier.mesh_ft(v, f, xi, rho)
        assert simd_level() == "none"
    finally:
        monkeypatch.undo()
        nd.fourier.native.cache_clear()
    assert_allclose(slow, expected, atol=1e-13)
    assert nd.fourier.native() is not None


# --------------------------------------------------------------------------------------- bad input

TRIANGLE = np.eye(3), np.array([[0, 1, 2]]), np.ones((2, 3))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({0: np.ones((3, 2))}, r"vertices \(V, 3\)"),
        ({0: np.ones(9)}, r"vertices \(V, 3\)"),
        ({1: np.array([[0, 1]])}, r"faces \(F, 3\)"),
        ({1: np.array([[0, 1, 3]])}, "vertex that is not there"),
        ({1: np.array([[0, 1, -1]])}, "vertex that is not there"),
        ({2: np.ones(3)}, r"wavevectors must have shape \(K, 3\)"),
        ({2: np.ones((3, 2))}, r"wavevectors must have shape \(K, 3\)"),
        ({3: np.ones(2)}, r"density must have shape \(1,\)"),
        ({3: np.ones((1, 1))}, r"density must have shape \(1,\)"),
    ],
)
def test_bad_input_is_told(change, message):
    arguments = dict(enumerate(TRIANGLE)) | change
    with pytest.raises(nd.InputError, match=message):
        nd.fourier.mesh_ft(*arguments.values())


def test_loops_check_what_they_are_given():
    """The compiled loops are reached by other ways too; they must not read past an array."""
    v, rho = torch.eye(3, dtype=torch.float64), torch.ones(1)
    for bad in ([[0, 1, 3]], [[0, 1, -1]]):
        with pytest.raises(ValueError, match="not there"):
            band_ft(v, torch.tensor(bad), rho, ROWS, (1.0, 1.0, 1.0), False)
    with pytest.raises(ValueError, match="density"):
        band_ft(v, torch.tensor([[0, 1, 2]]), torch.ones(2), ROWS, (1.0, 1.0, 1.0), False)


def test_nothing_to_do():
    empty = nd.fourier.mesh_ft(np.zeros((0, 3)), np.zeros((0, 3), int), np.ones((2, 3)))
    assert_allclose(empty, 0)
    assert len(nd.fourier.mesh_ft(*TRIANGLE[:2], np.zeros((0, 3)))) == 0
