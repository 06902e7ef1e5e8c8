"""Grids and kernels: chosen from the OTF, so that aliases keep to what is asked."""

from functools import cache
from statistics import median

import numpy as np
import pytest
import torch
from benchmarks.shapes import box
from numpy.testing import assert_allclose

from napari_deltamic.fourier import Band
from napari_deltamic.fourier.falloff import POINT_LIKE, Falloff
from napari_deltamic.fourier.kernel import AxisWeights, alias_error, fitted, window_transform
from napari_deltamic.fourier.particle_mesh import elements_ft
from napari_deltamic.fourier.points import Points
from napari_deltamic.fourier.quadrature import rule
from napari_deltamic.fourier.spreading import choose_spreading, gaussian, grid_size
from napari_deltamic.geometry import Mesh, sphere

# ------------------------------------------------------------------------------------- kernels


@pytest.mark.parametrize("width", [2, 3, 6, 11, 16])
@pytest.mark.parametrize("degree", [3, 5, 9])
def test_polynomials_meet_at_the_nodes_with_their_slopes(width, degree):
    c = fitted(width, 2.3 * width, degree).coefficients
    assert c.shape == (degree + 1, width)
    ends = {t: np.array([np.polyval(p, t) for p in c.T]) for t in (-1.0, 1.0)}
    slopes = {t: np.array([np.polyval(np.polyder(p), t) for p in c.T]) for t in (-1.0, 1.0)}
    for found in (ends, slopes):
        scale = max(np.abs(found[1.0]).max(), 1.0)
        assert_allclose(found[1.0][:-1], found[-1.0][1:], atol=1e-13 * scale)
        assert abs(found[-1.0][0]) < 1e-13 * scale
        assert abs(found[1.0][-1]) < 1e-13 * scale
    assert_allclose(c[:, ::-1] * (-1.0) ** np.arange(degree, -1, -1)[:, None], c, atol=1e-12)


@pytest.mark.parametrize("width", [4, 7, 12])
def test_the_transform_is_that_of_the_window(width):
    """Of the polynomials, integrated; of the window, by its formula."""
    beta = 2.2 * width
    cycles = np.linspace(0, 0.5, 9)
    ours = fitted(width, beta, 16).transform(cycles)
    formula = window_transform(cycles, width, beta)
    assert_allclose(ours / ours[0], formula / formula[0], atol=1e-9)


def test_the_formula_of_the_window_is_smooth_where_it_changes():
    k = np.linspace(0.2, 0.45, 4001)
    f = window_transform(k, 6, 6.0)
    assert np.abs(np.diff(f, 2)).max() < 1e-3 * np.abs(np.diff(f)).max()


def test_wider_kernels_and_finer_grids_leave_fewer_aliases():
    weights = AxisWeights(np.arange(21.0), np.full((1, 21), 1 / 21), np.zeros(1))

    def error(width, nodes):
        kernel = fitted(width, 0.95 * np.pi * width * (1 - 20 / nodes), 14)
        return float(alias_error(kernel.transform, nodes, weights))

    assert error(8, 50) < error(6, 50) / 5 < error(4, 50) / 25
    assert error(6, 60) < error(6, 50) < error(6, 44)


def test_grid_sizes_are_even_and_smooth():
    for n in range(2, 400, 7):
        found = grid_size(n)
        assert found >= n
        assert found % 2 == 0
        rest = found
        for p in (2, 3, 5):
            while rest % p == 0:
                rest //= p
        assert rest == 1


# ---------------------------------------------------------------------------- whatever the OTF

SHAPE, VOXEL = (24, 26, 28), (0.2, 0.1, 0.1)
CENTRE = (2.2, 1.3, 1.3)
BAND = Band.within(SHAPE, VOXEL, (11.0, 24.0, 26.0))
FULL = Band.full(SHAPE, VOXEL)
NYQUIST = tuple(np.pi / d for d in VOXEL)


def flat(axes):
    """1 to the edge of the band."""
    return torch.ones(torch.broadcast_shapes(*(a.shape for a in axes)), dtype=torch.float64)


def missing_cone(axes):
    """Of a widefield microscope: nothing along z but at zero, and rest sharply cut."""
    z, y, x = axes
    across = torch.sqrt(y**2 + x**2)
    inside = (z.abs() <= 0.35 * across) & (across < 25)
    return torch.where(inside, 1 - across / 25, (z**2 + across**2 == 0).to(torch.float64))


def measured(axes):
    """Of a bead: falls to a floor of noise, and stays there."""
    z, y, x = axes
    noise = 0.02 + 0.02 * torch.sin(37 * z + 11 * y) * torch.cos(23 * x)
    return gaussian((0.4, 0.18, 0.18))(axes) + noise.abs()


def one_sided(axes):
    """Not symmetric: complex, as a measured one may be."""
    z, _, x = axes
    return gaussian((0.35, 0.15, 0.15))(axes) * torch.exp(1j * (0.1 * z + 0.05 * x))


OTFS = {
    "Gaussian": (BAND, gaussian((0.35, 0.16, 0.15))),
    "flat": (BAND, flat),
    "PSF of 0.6 voxel": (FULL, gaussian((0.12, 0.06, 0.06))),
    "missing cone": (BAND, missing_cone),
    "measured": (BAND, measured),
    "complex": (BAND, one_sided),
    "wide along z": (BAND, gaussian((1.2, 0.16, 0.15))),
}
MESHES = {
    "sphere": sphere(CENTRE, 0.8, subdivisions=2),
    "box": box((CENTRE[0], CENTRE[1], CENTRE[2]), (1.5, 1.0, 1.2), edge_length=0.3),
    "speck": sphere(CENTRE, 0.02, subdivisions=0),
    "triangle": Mesh(np.array([[1.5, 0.7, 0.6], [2.9, 2.0, 1.1], [1.9, 0.9, 2.1]]), [[0, 1, 2]]),
}
ERRORS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


def spectrum(name, band, spreading, single):
    mesh = MESHES[name]
    points = Points(
        [(rule(4, 3 if name == "triangle" else 1), np.arange(len(mesh.faces)))], len(mesh.faces)
    )
    ones = torch.ones(len(mesh.faces), dtype=torch.float64)
    given = torch.tensor(mesh.vertices_numpy()), torch.as_tensor(mesh.faces), ones, points
    return elements_ft(*given, spreading, single)


@cache
def exact(name, which):
    band, _ = OTFS[which]
    finest = choose_spreading(band.half, band.spacing, flat, 1e-12, 1000, False)
    return spectrum(name, band, finest, False)


def error_of(name, which, error):
    """Relative L2 error of an image, from aliases alone."""
    band, otf = OTFS[which]
    single = error > 6e-6
    thin = name in ("speck",)
    falloff = POINT_LIKE if thin else Falloff(2, 0.5)
    width = (0.35, 0.16, 0.15)
    spreading = choose_spreading(band.half, band.spacing, otf, error, 1000, single, falloff, width)
    weight = otf(band.axes())
    seen, right = (
        band.to_image(u.to(torch.complex128) * weight, SHAPE)
        for u in (spectrum(name, band, spreading, single), exact(name, which))
    )
    return float((seen - right).norm() / right.norm())


@pytest.mark.parametrize("which", OTFS)
@pytest.mark.parametrize("error", ERRORS)
def test_aliases_keep_to_the_error_whatever_the_otf(which, error):
    found = {name: error_of(name, which, error) for name in MESHES}
    assert max(found.values()) <= error, found


@pytest.mark.parametrize("error", ERRORS)
def test_nor_are_kernels_much_wider_than_need_be(error):
    found = [error_of(name, which, error) for which in OTFS for name in MESHES]
    assert median(found) > error / 30


def test_what_is_chosen_follows_the_otf():
    """A flat OTF needs more than one that has fallen to nothing at the edge of the band."""

    def cost(otf):
        s = choose_spreading(BAND.half, BAND.spacing, otf, 1e-4, 10_000, True)
        return np.prod(s.shape) * np.prod([k.width for k in s.kernels])

    sharp, soft = cost(flat), cost(gaussian((0.5, 0.25, 0.25)))
    assert sharp > 1.5 * soft
    wide = choose_spreading(BAND.half, BAND.spacing, gaussian((1.2, 0.1, 0.1)), 1e-4, 10_000, True)
    assert wide.shape[0] / BAND.half[0] < wide.shape[2] / BAND.half[2] or (
        wide.kernels[0].width < wide.kernels[2].width
    )


@pytest.mark.parametrize(
    "otf", [lambda axes: flat(axes) * float("nan"), lambda axes: 0 * flat(axes)]
)
def test_an_otf_that_says_nothing_is_taken_to_be_flat(otf):
    found = choose_spreading(BAND.half, BAND.spacing, otf, 1e-3, 100, True)
    plain = choose_spreading(BAND.half, BAND.spacing, flat, 1e-3, 100, True)
    assert found.shape == plain.shape
