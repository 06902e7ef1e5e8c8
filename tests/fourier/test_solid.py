"""Solids: known transforms, 50 digits, and both ways against each other."""

from functools import cache

import mpmath
import numpy as np
import pytest
import torch
from any_wavevectors import solid_ft
from benchmarks.shapes import box, scaled
from numpy.testing import assert_allclose

import napari_deltamic as nd
from napari_deltamic.fourier.solid import contrasts, solid_transform
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.scene import Renderer, Scene, Solid
from reference import DIGITS, exact_simplex

BAR = {torch.float32: 1e-5, torch.float64: 1e-12}
EPS = 2.0**-52
SCALES = (0.0, 1e-12, 1e-6, 1e-3, 0.1, 0.9, 1.1, 3.0, 30.0)  # of |xi| times the size


def exact_solid(vertices, faces, xi):
    """u_hat at one wavevector and its gradient (V, 3), rounded from 50 digits."""
    with mpmath.workdps(DIGITS):
        v = [[mpmath.mpf(float(x)) for x in row] for row in vertices]
        x = [mpmath.mpf(float(k)) for k in xi]
        squared = mpmath.fdot(x, x)
        total = mpmath.mpc(0)
        gradient = [[mpmath.mpc(0)] * 3 for _ in v]
        for face in faces:
            p, q, r = (v[k] for k in face)
            value, slopes = exact_simplex(*(mpmath.fdot(w, x) for w in (p, q, r)))
            a, b = ([s - t for s, t in zip(w, p, strict=True)] for w in (q, r))
            normal = [a[k - 1] * b[k - 2] - a[k - 2] * b[k - 1] for k in range(3)]
            if squared:
                total += 1j * mpmath.fdot(normal, x) / squared * value
            else:
                total += mpmath.fdot(p, normal) / 6
            for k, slope in zip(face, slopes, strict=True):
                for axis in range(3):
                    gradient[k][axis] += normal[axis] * 1j * slope
        return complex(total), np.array([[complex(g) for g in row] for row in gradient])


def tetrahedron(thickness=1.0):
    """Four vertices, the last one this far from the others' plane; wound outward."""
    v = np.array([[0.1, 0.2, 0.1], [1.1, 0.3, 0.0], [0.2, 1.2, 0.3], [0.4, 0.5, 0.0]])
    normal = np.cross(v[1] - v[0], v[2] - v[0])
    v[3] += thickness * normal / np.linalg.norm(normal)
    mesh = Mesh(v, [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])
    return mesh if mesh.region_volume(1) > 0 else Mesh(v, mesh.faces[:, ::-1])


def with_an_empty_face():
    """A tetrahedron, an edge of which is bridged by a face of no area."""
    mesh = tetrahedron()
    v = np.round(mesh.vertices * 8) / 8
    v = np.vstack([v, v[:2].mean(0)])  # exact, as is the zero area
    parts = {
        (0, 3, 1): [[0, 3, 4], [4, 3, 1], [0, 4, 1]],
        (1, 3, 0): [[4, 3, 0], [1, 3, 4], [1, 4, 0]],
    }
    faces = []
    for face in mesh.faces.tolist():
        turned = [tuple(np.roll(face, k).tolist()) for k in range(3)]
        found = [parts[t] for t in turned if t in parts]
        faces += found[0] if found else [face]
    return Mesh(v, faces)


SHAPES = {
    "tetrahedron": tetrahedron(),
    "tiny": scaled(tetrahedron(), 1e-6),
    "huge": scaled(tetrahedron(), 1e6),
    "flat": tetrahedron(1e-4),
    "box along the axes": box((0.3, 0.2, -0.1), (1.0, 2.0, 0.5)),
    "needle": box((0.0, 0.0, 0.0), (1e-3, 1e-3, 2.0)),
    # In eighths, which float32 still holds so far away.
    "far from the origin": Mesh(
        np.round(tetrahedron().vertices * 8) / 8 + [1e5, -1e5, 1e5], tetrahedron().faces
    ),
    "a face of no area": with_an_empty_face(),
}
DIRECTIONS = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.3, -0.8, 0.5))


def size_of(mesh):
    low, high = mesh.bounds()
    return float(np.linalg.norm(high - low) / 2)


@cache
def exact_of(name, single):
    mesh = SHAPES[name]
    v = mesh.vertices.astype(np.float32).astype(float) if single else mesh.vertices
    found = []
    for direction in DIRECTIONS:
        for scale in SCALES:
            xi = scale / size_of(mesh) * np.array(direction)
            found.append((xi, *exact_solid(v, mesh.faces, xi)))
    return v, found


@pytest.mark.parametrize("dtype", BAR)
@pytest.mark.parametrize("name", SHAPES)
def test_value_and_gradient_keep_to_the_bars(name, dtype):
    """Relative to the largest value (the volume) and slope; what coordinates leave open allowed."""
    mesh = SHAPES[name]
    rounded, exact = exact_of(name, dtype == torch.float32)
    v = torch.tensor(rounded, dtype=dtype, requires_grad=True)
    shape = Mesh(rounded, mesh.faces)
    volume, area = shape.region_volume(1), shape.areas().sum()
    reach = np.abs(rounded - rounded.mean(0)).max()
    open_ = EPS * (area * reach / volume + np.array([abs(rounded.mean(0) @ x) for x, *_ in exact]))
    allowed = BAR[dtype] * np.maximum(1, 4 * open_ / BAR[dtype])
    u = solid_ft(v, mesh.faces, np.array([x for x, *_ in exact]))
    assert u.dtype == (torch.complex64 if dtype == torch.float32 else torch.complex128)
    errors = np.abs(u.detach().numpy() - [value for _, value, _ in exact]) / volume
    assert (errors < allowed).all(), errors.max()
    for k in range(0, len(exact), 2):
        re, im = (
            torch.autograd.grad(part, v, retain_graph=True)[0].double().numpy()
            for part in (u[k].real, u[k].imag)
        )
        error = np.abs(re + 1j * im - exact[k][2]).max() / area
        assert error < allowed[k]


def test_shapes_are_closed():
    assert all(mesh.is_closed() for mesh in SHAPES.values())
    assert (SHAPES["a face of no area"].areas() == 0).sum() == 1


def test_zero_wavevector_gives_the_volume():
    ball = sphere((3.0, 1.0, -2.0), 0.7, subdivisions=2)
    assert solid_ft(ball.vertices, ball.faces, np.zeros((1, 3))).item() == pytest.approx(
        ball.region_volume(1), rel=1e-14
    )


def test_box_has_a_product_of_sincs():
    size, centre = np.array([1.0, 2.0, 0.5]), np.array([0.2, 0.1, -3.0])
    xi = np.random.default_rng(0).normal(size=(30, 3)) * np.geomspace(1e-9, 50, 30)[:, None]
    exact = np.prod(size * np.sinc(xi * size / 2 / np.pi), 1) * np.exp(-1j * xi @ centre)
    mesh = box(centre, size)
    assert_allclose(solid_ft(mesh.vertices, mesh.faces, xi), exact, atol=1e-14)


def test_gradient_at_zero_is_that_of_the_volume():
    mesh = tetrahedron()
    v = torch.tensor(mesh.vertices, requires_grad=True)
    (gradient,) = torch.autograd.grad(solid_ft(v, mesh.faces, np.zeros((1, 3))).real.sum(), v)
    step = 1e-6
    for k, axis in ((0, 0), (3, 2), (1, 1)):
        moved = mesh.vertices.copy()
        moved[k, axis] += step
        other = mesh.with_vertices(moved).region_volume(1)
        assert gradient[k, axis] == pytest.approx((other - mesh.region_volume(1)) / step, rel=1e-5)


def test_bad_shapes():
    mesh = tetrahedron()
    with pytest.raises(nd.InputError, match="one number per region"):
        contrasts(mesh.regions, mesh.region_ids(), torch.ones(2))


# --------------------------------------------------------------------------------- several regions


def two_cells():
    """Two boxes that share a wall, as regions 3 and 7."""
    left, right = box((0.5, 0.5, 0.5), 1.0), box((0.5, 0.5, 1.5), 1.0)
    v = np.concatenate([left.vertices, right.vertices])
    v, index = np.unique(np.round(v, 9), axis=0, return_inverse=True)
    faces = index.reshape(-1)[np.concatenate([left.faces, right.faces + len(left.vertices)])]
    regions = np.repeat([[3, 0], [7, 0]], 12, axis=0)
    wall = (v[faces][:, :, 2] == 1.0).all(1)
    first = np.flatnonzero(wall & (regions[:, 0] == 3))
    regions[first] = [3, 7]
    keep = ~wall
    keep[first] = True
    return Mesh(v, faces[keep], regions[keep]), left, right


def test_a_wall_counts_for_both_sides():
    mesh, left, right = two_cells()
    assert mesh.is_closed()
    xi = np.random.default_rng(1).normal(size=(8, 3)) * np.linspace(0, 9, 8)[:, None]
    weights = torch.tensor([2.0, -0.5], dtype=torch.float64, requires_grad=True)
    u = solid_ft(mesh.vertices, mesh.faces, xi, contrasts(mesh.regions, mesh.region_ids(), weights))
    parts = [solid_ft(part.vertices, part.faces, xi) for part in (left, right)]
    assert_allclose(u.detach(), 2 * parts[0] - 0.5 * parts[1], atol=1e-14)
    (by_weight,) = torch.autograd.grad(u.real.sum(), weights)
    assert_allclose(by_weight, [p.real.sum() for p in parts], atol=1e-13)


# ------------------------------------------------------------------------------------- on a band

GRID = nd.Grid((24, 26, 25), (0.1, 0.1, 0.1))
OPTICS = nd.GaussianPSF((0.22, 0.2, 0.21))
CENTRE = (1.15, 1.25, 1.2)


def spread_out(mesh, renderer, contrast):
    """Transform of a solid on the plan of its surface, and its gradients against a fixed box."""
    v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    jump = contrast.clone().requires_grad_()
    u = solid_transform(renderer.plan, v, torch.as_tensor(mesh.faces), jump)
    image = renderer.image(u, renderer.otf(OPTICS)).to(torch.float64)
    wave = torch.linspace(0, 3, image.numel(), dtype=torch.float64).reshape(image.shape).cos()
    return image.detach(), *torch.autograd.grad((image * wave).sum(), (v, jump))


@pytest.mark.parametrize("shape", ["ball", "speck", "slab", "cells"])
def test_both_methods_agree_in_value_and_gradients(shape):
    methods_agree(shape)


def test_so_they_do_whichever_way_points_are_transformed(way):
    methods_agree("cells")


def methods_agree(shape):
    mesh = {
        "ball": sphere(CENTRE, (0.6, 0.7, 0.65), subdivisions=1),
        "speck": sphere(CENTRE, 1e-3, subdivisions=0),
        "slab": box(CENTRE, (1e-3, 1.0, 1.2), edge_length=0.5),
        "cells": two_cells()[0].translated((0.6, 0.7, 0.2)),
    }[shape]
    weights = torch.ones(len(mesh.region_ids()), dtype=torch.float64)
    contrast = contrasts(mesh.regions, mesh.region_ids(), weights)
    exact, plain = (
        spread_out(mesh, Renderer(Scene.of(mesh, OPTICS), GRID, 1e-7, method=m), contrast)
        for m in ("closed form", "particle-mesh")
    )
    for name, one, other in zip(("image", "vertices"), exact, plain, strict=False):
        assert float((one - other).norm() / one.norm()) < 2e-7, name
    # What belongs to a face is a matter of taste; only that of a whole region is not.
    total = [float((parts[2] * contrast).sum()) for parts in (exact, plain)]
    assert total[0] == pytest.approx(total[1], rel=1e-6)


def test_walls_between_cells_that_shine_alike_show_nothing():
    mesh = two_cells()[0].translated((0.6, 0.7, 0.2))
    renderer = Renderer(Scene.of(mesh, OPTICS), GRID, 1e-7, method="particle-mesh")
    alike = torch.tensor([1.0, 1.0], dtype=torch.float64)
    contrast = contrasts(mesh.regions, mesh.region_ids(), alike)
    found = []
    for jump in (contrast, contrast.clone().requires_grad_()):
        v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
        u = solid_transform(renderer.plan, v, torch.as_tensor(mesh.faces), jump)
        image = renderer.image(u, renderer.otf(OPTICS))
        (gradient,) = torch.autograd.grad((image**2).sum(), v)
        found.append((image.detach(), gradient))
    for without, with_walls in zip(*found, strict=True):
        assert float((without - with_walls).norm() / with_walls.norm()) < 1e-6
    assert float((contrast == 0).double().mean()) > 0.05


def test_gradient_follows_from_finite_differences():
    """Of the particle-mesh, whose gradient is not that of its own rounding errors."""
    mesh = sphere(CENTRE, 0.6, subdivisions=0)
    renderer = Renderer(Scene.of(mesh, OPTICS), GRID, 1e-9, method="particle-mesh")
    ones = torch.ones(len(mesh.faces), dtype=torch.float64)
    otf = renderer.otf(OPTICS)

    def loss(v):
        u = solid_transform(renderer.plan, v, torch.as_tensor(mesh.faces), ones)
        return (renderer.image(u, otf) ** 2).sum()

    v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    (gradient,) = torch.autograd.grad(loss(v), v)
    step = 1e-4 * torch.randn(v.shape, dtype=v.dtype, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        change = float(loss(v + step) - loss(v - step)) / 2
    assert float((gradient * step).sum()) == pytest.approx(change, rel=1e-6)


@pytest.mark.parametrize(
    ("radius", "grown", "moved"), [(3.0, 0.6, 1.0), (3.0, 2.5, 1.0), (1.2, 1.0, 4.8)]
)
def test_a_plan_holds_for_what_a_fit_makes_of_the_mesh(radius, grown, moved, way):
    """Whether it is thick, and where shells are taken, is found once."""
    grid, optics = nd.Grid((30, 30, 30), (1.0,) * 3), nd.GaussianPSF(1.2)
    mesh = sphere((12.5,) * 3, radius, subdivisions=1)
    renderer = Renderer(
        Scene((Solid(mesh),), optics), grid, 1e-3, margin=4.8, method="particle-mesh"
    )
    other = mesh.with_vertices((mesh.vertices_numpy() - 12.5) * grown + 12.5 + moved)
    image = renderer.image(
        renderer.transform(torch.tensor(other.vertices_numpy())), renderer.otf(optics)
    )
    exact = Renderer(Scene((Solid(other),), optics), grid, 0.0).rendered()
    assert (image - exact).norm() < 1e-3 * exact.norm()


def test_numbers_that_are_not_one_for_each_region_are_refused():
    scene = Scene((Solid(sphere(CENTRE, 0.6, subdivisions=0)),), OPTICS)
    with pytest.raises(nd.InputError, match=r"one number per region is needed: shape \(1,\), not"):
        Renderer(scene, GRID).transform(cells=torch.ones(3, dtype=torch.float64))
