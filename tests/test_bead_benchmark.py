"""The PSF from the image of a bead."""

import numpy as np
import pytest
import torch
from benchmarks.effects.bead_fit import fit_bead

import napari_deltamic as nd
from napari_deltamic import InputError
from napari_deltamic.fourier import Band
from napari_deltamic.optics.measured import bead_transform

VOXEL = (0.25, 0.11, 0.11)
EXTENT = (1.2, 1.2)
PLACE = (1.93, 1.2, 1.31)


def image_of(psf, diameter, seed=0, core=0.0):
    band = Band.full((32, 48, 48), VOXEL)
    z, y, x = band.axes()
    spectrum = psf.otf((z, y, x)) * bead_transform(
        torch.sqrt(z * z + y * y + x * x) * diameter / 2, "solid", core
    )
    for k, c in zip((z, y, x), PLACE, strict=True):
        spectrum = spectrum * torch.exp(-1j * k * c)
    for k, d in ((y, VOXEL[1]), (x, VOXEL[2])):
        spectrum = spectrum * torch.sinc(k * d / (2 * np.pi))
    clean = band.to_image(spectrum, (16, 22, 23)).numpy()
    clean = 10 + 3000 * clean.clip(0) / clean.max()
    return np.random.default_rng(seed).poisson(clean).astype(float), clean


def test_zernikes_are_found_and_the_noise_is_left():
    true = nd.PupilPSF(0.8, 0.52, 1.333, {5: 0.3, 11: -0.2}, extent=EXTENT)
    start = nd.PupilPSF(0.8, 0.52, 1.333, {5: 0.0, 11: 0.0}, extent=EXTENT)
    image, variance = image_of(true, 0.0)
    found = fit_bead(image, VOXEL, start, variance=variance)
    for p in true.described():
        if p.fitted:
            error = found.optics.values[p.name].item() - p.value
            assert abs(error) < 4 * found.errors[p.name] < 0.1
    assert found.chi2 == pytest.approx(1, abs=0.1)
    assert found.centre == pytest.approx(PLACE, abs=0.01)


@pytest.mark.parametrize("diameter", [0.5, 1.0])
def test_diameter_of_a_bead(diameter):
    psf = nd.ScalarPSF(0.8, 0.52, 1.333, fitted=(), extent=EXTENT)
    found = fit_bead(image_of(psf, diameter)[0], VOXEL, psf, bead_diameter=None)
    assert found.bead_diameter == pytest.approx(diameter, rel=0.02)


def test_a_psf_without_parameters_has_nothing_to_find():
    psf = nd.ScalarPSF(0.8, 0.52, 1.333, fitted=(), extent=EXTENT)
    with pytest.raises(InputError, match="no parameter to fit"):
        fit_bead(image_of(psf, 0.0)[0], VOXEL, psf)


def test_a_stack_with_nan_is_refused():
    with pytest.raises(InputError, match="NaN"):
        fit_bead(np.full((9, 9, 9), np.nan), VOXEL, nd.GaussianPSF(0.2))


def test_the_unstained_middle_of_a_bead_is_found():
    psf = nd.ScalarPSF(0.8, 0.52, 1.333, fitted=(), extent=EXTENT)
    image, _ = image_of(psf, 1.6, core=0.6)
    found = fit_bead(image, VOXEL, psf, bead_diameter=None, bead="rim")
    assert found.bead_diameter == pytest.approx(1.6, rel=0.02)
    assert found.core_diameter == pytest.approx(0.96, rel=0.1)


def test_a_large_bead_is_not_taken_for_the_background():
    psf = nd.ScalarPSF(0.8, 0.52, 1.333, fitted=(), extent=EXTENT)
    image, _ = image_of(psf, 1.9)
    assert fit_bead(image, VOXEL, psf, bead_diameter=None).bead_diameter == pytest.approx(
        1.9, rel=0.02
    )


@pytest.mark.parametrize(
    ("voxel_size", "diameter", "told"),
    [
        ((250, 110, 110), 0.0, "voxel size along Z 250 um: did you mean 0.25?"),
        (VOXEL, 100.0, "diameter of the bead 100 um: did you mean 0.1?"),
    ],
)
def test_sizes_in_nanometres_are_told(voxel_size, diameter, told):
    image = np.random.default_rng(0).poisson(9.0, (9, 9, 9))
    image[4, 4, 4] = 90
    with pytest.raises(InputError, match=told[:-1]):
        fit_bead(image, voxel_size, nd.GaussianPSF(0.2), bead_diameter=diameter)
