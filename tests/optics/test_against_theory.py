"""Values of the models where theory knows them: paraxial limits, cutoffs, products."""

import numpy as np
import pytest
import scipy.special
import torch
from numpy.testing import assert_allclose

from napari_deltamic import optics
from napari_deltamic.optics.microscope import gaussian_widths

from .models import focal_shift, pupil, scalar

R = torch.linspace(0.0, 2.0, 41, dtype=torch.float64)
FOCUS = torch.zeros(1, dtype=torch.float64)
PARAXIAL = {"na": 0.1, "wavelength": 0.5, "index": 1.0}


def airy(r):
    v = np.asarray(2 * np.pi * 0.1 / 0.5 * r)
    return np.where(v > 0, 2 * scipy.special.j1(v) / np.where(v > 0, v, 1), 1.0) ** 2


@pytest.mark.parametrize("kind", [optics.ScalarPSF, optics.GibsonLanniPSF, optics.VectorialPSF])
def test_paraxial_limit_is_the_airy_pattern(kind):
    r = torch.linspace(0.0, 8.0, 81, dtype=torch.float64)
    found = kind(**PARAXIAL, extent=(100.0, 12.0)).intensity_at(FOCUS, r)[0]
    assert_allclose(found / found[0], airy(r.numpy()), atol=2e-3)


def test_paraxial_axis_is_a_squared_sinc():
    z = torch.linspace(-60, 60, 61, dtype=torch.float64)
    found = scalar(**PARAXIAL, apodisation=0.0, extent=(80.0, 12.0)).intensity_at(
        z, torch.zeros(1, dtype=torch.float64)
    )[:, 0]
    k, spread = 2 * np.pi / 0.5, 1 - np.sqrt(1 - 0.01)
    assert_allclose(found / found.max(), np.sinc(k * spread * z / (2 * np.pi)) ** 2, atol=2e-3)


def test_transfer_in_focus_ends_at_twice_the_na():
    model = scalar(apodisation=0.0, na=0.3, index=1.0, extent=(30.0, 40.0))
    cut = 2 * 2 * np.pi * 0.3 / 0.52
    k = torch.linspace(0, 1.2 * cut, 49, dtype=torch.float64)
    planes = model.intensity_at(FOCUS, model._r)
    plane = torch.zeros(1, dtype=torch.float64), k
    found = model._on_plane(model._lateral(planes, *plane), *plane)[0, 0]
    share = (k / cut).clamp(max=1).numpy()
    expected = 2 / np.pi * (np.arccos(share) - share * np.sqrt(1 - share**2))
    assert_allclose(found / found[0], expected, atol=8e-3)


@pytest.mark.parametrize("extent", [(1.5, 1.5), (30.0, 40.0)])
def test_a_plane_of_wavevectors_is_summed_over_the_radius(extent):
    model = scalar(extent=extent)
    ky, kx = (torch.linspace(low, 40, 23, dtype=torch.float64) for low in (-30, 0))
    planes = model.intensity_at(FOCUS, model._r)
    found = model._on_plane(model._lateral(planes, ky, kx), ky, kx)
    length = torch.hypot(ky[:, None], kx)
    weighted = (planes[0] * model._r_weight).numpy()
    summed = scipy.special.j0(length.numpy()[..., None] * model._r.numpy()) @ weighted
    resolved = length.numpy() <= model._resolved[1]
    assert 0 < resolved.sum() < resolved.size
    assert_allclose(found[0], np.where(resolved, summed, 0.0), atol=1e-11 * summed.max())


def test_two_ways_to_the_same_pupil():
    extent = (1.5, 1.5)
    radial = scalar(extent=extent)
    general = optics.PupilPSF(1.2, 0.52, 1.515, apodisation=0.3, extent=extent)
    k = torch.linspace(-20, 20, 9, dtype=torch.float64)
    axes = (k[:, None, None] / 4, k[None, :, None], k[None, None, 4:])
    assert_allclose(radial.otf(axes).numpy(), general.otf(axes).numpy(), atol=1e-6)


def test_matched_layers_make_no_aberration():
    model = optics.GibsonLanniPSF(1.2, 0.52, 1.515, depth=20.0, extent=(1.5, 1.5))
    assert focal_shift(model) == pytest.approx(0, abs=1e-9)
    plain = optics.GibsonLanniPSF(1.2, 0.52, 1.515, extent=(1.5, 1.5))
    z = torch.linspace(-1, 1, 5, dtype=torch.float64)
    assert_allclose(model.intensity_at(z, R), plain.intensity_at(z, R), rtol=1e-6, atol=1e-9)


def test_oil_into_water_needs_a_deeper_focus_and_stays_centred():
    model = optics.GibsonLanniPSF(1.1, 0.52, 1.515, 1.333, 5.0)
    # Paraxially by the ratio of the indices, at the rim by more.
    assert 5 * (1.515 / 1.333 - 1) < focal_shift(model) < 5.0
    z = torch.linspace(-1.5, 1.5, 61, dtype=torch.float64)
    axis = model.intensity_at(z, torch.zeros(1, dtype=torch.float64))[:, 0]
    assert abs(float(z[int(axis.argmax())])) < 0.5


def test_small_pinhole_gives_the_product_of_two_psfs():
    model = optics.ConfocalPSF(scalar(), 0.488, 0.02, extent=(1.0, 0.8))
    z = torch.linspace(-0.6, 0.6, 5, dtype=torch.float64)
    r = model._r
    found = model.intensity_at(z, r)
    product = scalar().intensity_at(z, r) * scalar(wavelength=0.488).intensity_at(z, r)
    near = r < 0.6
    assert_allclose((found / found.max())[:, near], (product / product.max())[:, near], atol=1e-3)


def test_wide_pinhole_gives_the_excitation_psf_across():
    model = optics.ConfocalPSF(scalar(), 0.488, 12.0, extent=(1.0, 0.8))
    found = model.intensity_at(FOCUS, model._r)[0]
    lit = scalar(wavelength=0.488).intensity_at(FOCUS, model._r)[0]
    assert_allclose(found / found[0], lit / lit[0], atol=2e-2)


def test_pinhole_gathers_the_disc_around_its_centre():
    model = optics.ConfocalPSF(scalar(), 0.488, 1.0, extent=(1.0, 0.8))
    radius = float(model._pinhole_radius())
    z = torch.tensor([0.0, 0.4], dtype=torch.float64)
    found = model._through_pinhole(model._detection, z)
    t, w = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(24))
    t, w = (t + 1) / 2, w / 2
    angle = 2 * np.pi * (torch.arange(48, dtype=torch.float64) + 0.5) / 48
    for j in (0, len(model._r) // 4, len(model._r) // 2):
        r = model._r[j]
        far = torch.sqrt(
            r**2 + (radius * t[:, None]) ** 2 - 2 * r * radius * t[:, None] * torch.cos(angle)
        )
        seen = scalar().intensity_at(z, far.reshape(-1)).reshape(2, 24, 48).mean(-1)
        expected = (seen * (2 * w * t)).sum(1)
        assert_allclose(found[:, j], expected, rtol=2e-3, atol=1e-4 * float(found.max()))


def test_light_sheet_multiplies_planes():
    thick, thin = (optics.LightSheetPSF(pupil(), s).sigma_um[0] for s in (20.0, 0.6))
    assert thick == pytest.approx(pupil().sigma_um[0], rel=0.05)
    sheet = 0.6 / 2.3548
    assert thin == pytest.approx((sheet**-2 + pupil().sigma_um[0] ** -2) ** -0.5, rel=0.1)


@pytest.mark.parametrize(("na", "index"), [(0.5, 1.0), (1.2, 1.333)])
def test_gaussian_approximation_is_that_of_the_airy_core(na, index):
    z, y, x = gaussian_widths("widefield", na, 0.52, index)
    assert y == x == pytest.approx(0.225 * 0.52 / na, rel=0.12)  # Zhang's paraxial 0.225
    exact = optics.ScalarPSF(na, 0.52, index).sigma_um
    assert_allclose((z, y), exact[:2], rtol=0.2)


def test_gaussian_mixture_of_one_width_is_a_gaussian():
    sigma = (0.3, 0.2, 0.15)
    mix = optics.GaussianMixturePSF([sigma, sigma], [0.7, 0.3])
    k = torch.linspace(-6, 6, 7, dtype=torch.float64)
    axes = (k[:, None, None], k[None, :, None], k[None, None, :])
    assert_allclose(mix.otf(axes), optics.GaussianPSF(sigma).otf(axes), atol=1e-14)
    assert_allclose(mix.sigma_um, sigma, rtol=1e-9)
