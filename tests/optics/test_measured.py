"""A measured PSF: centred, tapered, of unit mass; and the stacks that are refused."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

import napari_deltamic as nd
from napari_deltamic import InputError, MeasuredPSF
from napari_deltamic.optics.measured import bead_transform

VOXEL = (0.2, 0.1, 0.1)
SIGMA = (0.4, 0.17, 0.15)
SHAPE = (33, 35, 37)


def stack(centre=(16.3, 16.8, 18.4), sigma=SIGMA, noise=0.0, shape=SHAPE, background=100.0):
    grids = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    power = sum(
        ((g - c) * d / s) ** 2 for g, c, d, s in zip(grids, centre, VOXEL, sigma, strict=True)
    )
    image = background + 1000 * np.exp(-power / 2)
    return image + np.random.default_rng(0).normal(0, noise, shape) if noise else image


def axes(largest=(6.0, 14.0, 14.0)):
    z, y, x = (torch.linspace(-k, k, 9, dtype=torch.float64) for k in largest)
    return z[:, None, None], y[None, :, None], x[None, None, :]


def test_the_otf_of_a_gaussian_spot_is_gaussian_wherever_it_lies():
    for centre in ((16.0, 17.0, 18.0), (16.3, 16.8, 18.4)):
        found = MeasuredPSF(stack(centre), VOXEL).otf(axes())
        expected = nd.GaussianPSF(SIGMA).otf(axes())
        assert_allclose(found.real, expected, atol=4e-3)
        assert_allclose(found.imag, 0, atol=6e-3)


def test_noise_leaves_the_core_of_the_otf():
    found = MeasuredPSF(stack(noise=10.0), VOXEL).otf(axes((3.0, 7.0, 7.0)))
    expected = nd.GaussianPSF(SIGMA).otf(axes((3.0, 7.0, 7.0)))
    assert_allclose(found.abs(), expected, atol=6e-2)


def test_widths_and_reach():
    psf = MeasuredPSF(stack(), VOXEL)
    assert_allclose(psf.sigma_um, SIGMA, rtol=0.03)
    assert psf.parameters().shape == (0,)
    assert all(r < e + 1e-9 for r, e in zip(psf.reach(1e-3), psf.extent, strict=True))


def test_nothing_beyond_what_its_voxels_show():
    k = torch.linspace(np.pi / 0.1 + 1, 100, 20, dtype=torch.float64)
    zero = torch.zeros(1, 1, 1, dtype=torch.float64)
    assert not bool(MeasuredPSF(stack(), VOXEL).otf((zero, zero, k[None, None, :])).any())


@pytest.mark.parametrize("bead", ["solid", "shell"])
def test_the_bead_is_divided_out(bead):
    diameter = 0.5
    k = axes((3.0, 5.0, 5.0))
    length = torch.sqrt(k[0] ** 2 + k[1] ** 2 + k[2] ** 2)
    assert float(bead_transform(length * diameter / 2, bead).min()) < 0.8
    # A spot wider by the bead: its image by the transform on a periodic grid.
    sizes = [2 * np.pi * np.fft.fftfreq(n, d) for n, d in zip(SHAPE, VOXEL, strict=True)]
    z, y, x = np.meshgrid(*sizes, indexing="ij")
    q = torch.from_numpy(np.sqrt(z**2 + y**2 + x**2) * diameter / 2)
    spot = np.fft.fftn(stack((16, 17, 18), background=0.0)) * bead_transform(q, bead).numpy()
    image = 100 + np.fft.ifftn(spot).real
    found = MeasuredPSF(image, VOXEL, diameter, bead).otf(k)
    assert_allclose(found.abs(), nd.GaussianPSF(SIGMA).otf(k), atol=1e-2)


def test_it_renders_as_the_psf_that_it_shows():
    grid = nd.Grid((24, 36, 36), VOXEL)
    from napari_deltamic.geometry import sphere

    mesh = sphere((2.3, 1.7, 1.7), 0.9, subdivisions=2)
    found = nd.render(mesh, grid, MeasuredPSF(stack(), VOXEL), 1e-3)
    expected = nd.render(mesh, grid, nd.GaussianPSF(SIGMA), 1e-3)
    assert float((found - expected).norm() / expected.norm()) < 1e-2


def _nan():
    image = stack()
    image[3, 4, 5] = np.nan
    return image


REFUSED = {
    "NaN": (_nan(), "1 voxels that are NaN"),
    "flat": (np.full(SHAPE, 7.0), "flat"),
    "saturated": (np.minimum(stack(), 700), "saturated"),
    "off-centre": (stack((3, 17, 18)), "off-centre along Z"),
    "too small": (stack((4, 4, 4), (0.8, 0.6, 0.6), shape=(9, 9, 9)), "smaller than its PSF"),
    "2D": (np.ones((5, 5)), "3D stack"),
    "tiny": (np.ones((3, 9, 9)), "too small"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_bad_stacks_are_refused(kind):
    image, reason = REFUSED[kind]
    with pytest.raises(InputError, match=reason):
        MeasuredPSF(image, VOXEL)


@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        (((200, 100, 100),), "voxel size along Z 200 um: did you mean 0.2"),
        (((0.2, 100, 100),), "voxel size along Y 100 um: did you mean 0.1"),
        ((VOXEL, 170.0), "diameter of the bead 170 um: did you mean 0.17"),
    ],
)
def test_sizes_in_nanometres_are_told(sizes, told):
    with pytest.raises(InputError, match=told):
        MeasuredPSF(stack(), *sizes)


def test_a_core_without_stain_is_taken_out_of_the_ball():
    q = torch.linspace(0.01, 9, 50, dtype=torch.float64)
    # The ball is its core and what is around it, by volume.
    whole, core = bead_transform(q, "solid"), bead_transform(0.6 * q, "solid")
    assert_allclose(whole, (1 - 0.6**3) * bead_transform(q, "solid", 0.6) + 0.6**3 * core)
    assert_allclose(bead_transform(q, "solid", 0.999), bead_transform(q, "shell"), atol=2e-3)
