"""Sections of a PSF, as they are shown."""

import numpy as np
import pytest

from napari_deltamic.optics import GaussianPSF, microscope
from napari_deltamic.optics.sections import psf_sections


def gaussian(n, side, sigma):
    place = np.linspace(-0.5, 0.5, n) * side
    return np.exp(-0.5 * (place / sigma) ** 2)


def test_those_of_a_gaussian_are_gaussians_of_its_widths():
    z, y, x = 0.6, 0.3, 0.2
    found = psf_sections(GaussianPSF((z, y, x)))
    assert found.side == pytest.approx(7 * z)
    for image, rows in ((found.xz, z), (found.xy, y)):
        n, m = image.shape
        expected = np.outer(gaussian(n, found.side, rows), gaussian(m, found.side, x))
        # The outermost samples lie within a sample of the borders of the square.
        np.testing.assert_allclose(image, expected, atol=0.1)
        assert image.max() == 1
        assert np.unravel_index(image.argmax(), image.shape) == (n // 2, m // 2)


def test_that_of_an_objective_is_longer_along_z():
    found = psf_sections(microscope(na=1.2, wavelength=0.52, modality="confocal"))
    along = [(image[:, image.shape[1] // 2] > 0.5).mean() for image in (found.xz, found.xy)]
    assert along[0] > 1.5 * along[1]
    assert found.xz.min() > -0.05


def test_what_a_psf_keeps_for_a_fit_stays():
    optics = microscope(na=1.2, wavelength=0.52, modality="confocal")
    psf_sections(optics)
    assert optics._kept is None
