"""What must change nothing changes nothing: for value and gradient, in the transform and the image.

The mesh is a sphere with a needle, a face of no area, a vertex held twice and densities of its own.
Three corners that lie on a line only to rounding are left out: there the area has a kink, and its
gradient, though no longer than half the edge, points where rounding says.
"""

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import Mesh, sphere

DTYPES = {torch.float32: 2e-5, torch.float64: 1e-11}
UNITS = [1e3, 1e-6, 1e-9, 1e6]  # um told in nm, in m, and beyond
RENDERINGS = {  # method, accuracy, how much of the image may change
    "closed form": ("closed form", 0, 1e-11),
    "closed form, f32": ("closed form", 5e-5, 5e-5),
    "particle-mesh": ("particle-mesh", 1e-8, 1e-8),
    "particle-mesh, f32": ("particle-mesh", 5e-5, 5e-5),
}


def awkward_mesh():
    """Vertices (V, 3), faces (F, 3), densities (F,): float64 tensors, the faces int64."""
    ball = sphere((0.1, -0.05, 0.02), (0.6, 0.7, 0.65), subdivisions=1)
    v, f = ball.vertices_numpy(), ball.faces
    a, b, c = f[0]
    needle = v[c] + 0.01 * (v[a] - v[c])
    n = len(v)
    v = np.vstack([v, needle, v[b]])
    f = np.vstack([f, [c, n, b], [a, n + 1, c], [a, a, b]])
    rho = np.random.default_rng(1).uniform(0.5, 2, len(f))
    return torch.from_numpy(v), torch.from_numpy(f), torch.from_numpy(rho)


# What is done to a mesh: new vertices as a differentiable function of the old, faces, densities.


def divided(v, f, rho):
    """Every face cut in three at an inner point, and these once more."""
    for _ in range(2):
        weights = torch.tensor([0.2, 0.3, 0.5], dtype=v.dtype)
        inside = torch.einsum("p,fpi->fi", weights, v[f])
        middle = len(v) + torch.arange(len(f))
        f = torch.cat([torch.stack([f[:, p], f[:, (p + 1) % 3], middle], 1) for p in range(3)])
        v, rho = torch.cat([v, inside]), rho.repeat(3)
    return v, f, rho


def turned_over(v, f, rho):
    """Every other face wound the other way, and all told from another corner."""
    odd = torch.arange(len(f)) % 2 == 1
    return v, torch.where(odd[:, None], f.flip(1), f.roll(1, 1)), rho


def other_face_order(v, f, rho):
    order = torch.from_numpy(np.random.default_rng(2).permutation(len(f)))
    return v, f[order], rho[order]


def other_vertex_order(v, f, rho):
    order = torch.from_numpy(np.random.default_rng(3).permutation(len(v)))
    return v[order], torch.argsort(order)[f], rho


def with_unused_vertices(v, f, rho):
    return torch.cat([v, v[:3] * 0.5]), f, rho


SAME = [divided, turned_over, other_face_order, other_vertex_order, with_unused_vertices]


def assert_same(found, expected, tolerance):
    """Tensors whose L2 distance is small against the L2 norm of the second."""
    found, expected = (t.detach().to(torch.complex128) for t in (found, expected))
    assert expected.norm() > 0
    assert (found - expected).norm() < tolerance * expected.norm()


# ---------------------------------------------------------------------------------- the transform


def directions(count=25):
    rng = np.random.default_rng(4)
    return torch.from_numpy(rng.normal(size=(count, 3)) * 10 ** rng.uniform(-1, 1.2, (count, 1)))


def complex_weights(count=25):
    return torch.from_numpy(np.random.default_rng(5).normal(size=(count, 2)).view(complex)[:, 0])


def transformed(change=lambda v, f, rho: (v, f, rho), xi=None, weights=None, dtype=torch.float64):
    """u_hat, and the gradient of its product with weights in the vertices before the change."""
    v, f, rho = awkward_mesh()
    v = v.requires_grad_()
    xi = directions() if xi is None else xi
    weights = complex_weights() if weights is None else weights
    changed = change(v, f, rho)
    u = nd.fourier.mesh_ft(changed[0].to(dtype), changed[1], xi, changed[2])
    (gradient,) = torch.autograd.grad((u * weights.to(u.dtype)).real.sum(), v)
    return u, gradient


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("change", SAME)
def test_transform_of_the_same_surface(change, dtype):
    for found, expected in zip(
        transformed(change, dtype=dtype), transformed(dtype=dtype), strict=True
    ):
        assert_same(found, expected, DTYPES[dtype])


@pytest.mark.parametrize("dtype", DTYPES)
def test_transform_of_a_moved_mesh(dtype):
    """A phase for each wavevector, which the weights undo."""
    shift = torch.tensor([1.0, -2.0, 4.0], dtype=torch.float64)
    phase = torch.exp(-1j * (directions() @ shift))
    u, gradient = transformed(dtype=dtype)
    moved, by_moved = transformed(
        lambda v, f, rho: (v + shift, f, rho), weights=complex_weights() / phase, dtype=dtype
    )
    # Coordinates of a float32 mesh at 4 um hold 2e-7 um, wavevectors go up to 20 rad/um.
    tolerance = DTYPES[dtype] * (5 if dtype == torch.float32 else 1)
    assert_same(moved, u * phase, tolerance)
    assert_same(by_moved, gradient, tolerance)


@pytest.mark.parametrize("dtype", DTYPES)
def test_transform_of_a_turned_mesh(dtype):
    q = torch.linalg.qr(torch.from_numpy(np.random.default_rng(6).normal(size=(3, 3))))[0]
    u, gradient = transformed(dtype=dtype)
    turned, by_turned = transformed(
        lambda v, f, rho: (v @ q, f, rho), xi=directions() @ q, dtype=dtype
    )
    assert_same(turned, u, DTYPES[dtype])
    # The gradient is in the vertices before the turn.
    assert_same(by_turned, gradient, DTYPES[dtype])


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_transform_in_other_units(unit, dtype):
    u, gradient = transformed(dtype=dtype)
    scaled, by_scaled = transformed(
        lambda v, f, rho: (v * unit, f, rho), xi=directions() / unit, dtype=dtype
    )
    assert_same(scaled / unit**2, u, DTYPES[dtype])
    assert_same(by_scaled / unit**2, gradient, DTYPES[dtype])


# -------------------------------------------------------------------------------------- the image

GRID = nd.Grid((23, 24, 25), (0.1, 0.1, 0.1), origin=(-1.1, -1.25, -1.15))
SIGMA = (0.22, 0.2, 0.21)


def target(shape):
    return torch.from_numpy(np.random.default_rng(7).normal(size=shape))


def rendered(kind, change=lambda v, f, rho: (v, f, rho), grid=GRID, sigma=SIGMA, look=None):
    """The image, and the gradient of its product with another in the vertices before the change."""
    method, accuracy, _ = RENDERINGS[kind]
    v, f, rho = awkward_mesh()
    v = v.requires_grad_()
    changed, faces, density = change(v, f, rho)
    mesh = Mesh(changed.detach().numpy(), faces.numpy()).with_vertices(changed)
    optics = nd.GaussianPSF(sigma)
    image = nd.render(mesh, grid, optics, accuracy, density=density, method=method)
    look = target(grid.shape) if look is None else look
    (gradient,) = torch.autograd.grad((image * look).sum(), v)
    return image, gradient


def assert_rendered_same(kind, found, expected, at_least=0.0):
    for a, b in zip(found, expected, strict=True):
        # A gradient weighs the far end of the band more than the image does.
        assert_same(a, b, max(5 * RENDERINGS[kind][2], at_least))


@pytest.mark.parametrize("kind", RENDERINGS)
@pytest.mark.parametrize("change", SAME)
def test_image_of_the_same_surface(change, kind):
    assert_rendered_same(kind, rendered(kind, change), rendered(kind))


@pytest.mark.parametrize("kind", RENDERINGS)
def test_image_of_a_mesh_and_grid_moved_alike(kind):
    shift = np.array([512.0, -64.0, 1024.0])
    grid = nd.Grid(GRID.shape, GRID.voxel_size, tuple(np.add(GRID.origin, shift)))
    moved = rendered(kind, lambda v, f, rho: (v + torch.from_numpy(shift), f, rho), grid)
    assert_rendered_same(kind, moved, rendered(kind))


@pytest.mark.parametrize("kind", RENDERINGS)
def test_image_of_a_mesh_moved_by_whole_voxels(kind):
    """What is seen moves along; the target too, so that the gradient stays."""
    n = (2, -3, 1)
    shift = torch.tensor([k * d for k, d in zip(n, GRID.voxel_size, strict=True)]).double()
    grid = nd.Grid((35, 36, 37), GRID.voxel_size, origin=(-1.7, -1.85, -1.75))
    inner = (slice(4, -4),) * 3  # without the border, where what is rolled in differs
    look = torch.zeros(grid.shape, dtype=torch.float64)
    look[inner] = target(look[inner].shape)
    image, gradient = rendered(kind, grid=grid, look=look)
    moved, by_moved = rendered(
        kind, lambda v, f, rho: (v + shift, f, rho), grid, look=look.roll(n, (0, 1, 2))
    )
    back = moved.roll([-k for k in n], (0, 1, 2))
    # Padded to another period, the grid cuts the OTF off elsewhere, where 3e-9 of it is left.
    assert_rendered_same(kind, (back[inner], by_moved), (image[inner], gradient), 1e-7)


@pytest.mark.parametrize("kind", RENDERINGS)
@pytest.mark.parametrize("axes", [(1, 2, 0), (2, 1, 0)])
def test_image_with_axes_exchanged(kind, axes):
    order = list(axes)
    grid = nd.Grid(*(tuple(np.array(a)[order]) for a in (GRID.shape, GRID.voxel_size, GRID.origin)))
    sigma = tuple(np.array(SIGMA)[order])
    look = target(GRID.shape).permute(axes)
    image, gradient = rendered(kind, lambda v, f, rho: (v[:, order], f, rho), grid, sigma, look)
    back = torch.argsort(torch.tensor(axes)).tolist()
    assert_rendered_same(kind, (image.permute(back), gradient), rendered(kind))


@pytest.mark.parametrize("kind", RENDERINGS)
def test_power_of_the_image_of_a_turned_mesh(kind):
    """Under a round PSF, sum of squares and its gradient do not depend on how a mesh lies."""
    q = torch.linalg.qr(torch.from_numpy(np.random.default_rng(8).normal(size=(3, 3))))[0]
    grid = nd.Grid((40, 40, 40), (0.1, 0.1, 0.1), origin=(-1.95, -1.95, -1.95))
    method, accuracy, tolerance = RENDERINGS[kind]
    found = []
    for turn in (torch.eye(3, dtype=torch.float64), q):
        v, f, rho = awkward_mesh()
        v = v.requires_grad_()
        mesh = Mesh(v.detach().numpy(), f.numpy()).with_vertices(v @ turn)
        image = nd.render(mesh, grid, nd.GaussianPSF(0.22), accuracy, density=rho, method=method)
        power = image.to(torch.float64).square().sum()
        found.append((power, torch.autograd.grad(power, v)[0]))
    # Of what the border cuts off, 7.4 sigma from the middle of a membrane, 1e-9 is left.
    for a, b in zip(*found, strict=True):
        assert_same(a, b, max(5 * tolerance, 1e-8))


@pytest.mark.parametrize("kind", RENDERINGS)
@pytest.mark.parametrize("unit", [1e3, 1e-6])
def test_image_in_other_units(kind, unit):
    grid = nd.Grid(
        GRID.shape, *(tuple(unit * x for x in a) for a in (GRID.voxel_size, GRID.origin))
    )
    sigma = tuple(unit * s for s in SIGMA)
    image, gradient = rendered(kind, lambda v, f, rho: (v * unit, f, rho), grid, sigma)
    assert_rendered_same(kind, (image / unit**2, gradient / unit**2), rendered(kind))
