"""What is known of a PSF beside the image."""

import numpy as np
import pytest

from napari_deltamic import ConfocalPSF, GaussianPSF, ScalarPSF
from napari_deltamic.fitting.model.imaging import Imaging
from napari_deltamic.scene.effects import Effects


def nats(start, **ratios):
    """Of the prior on a PSF, where some of its numbers are so many times those at the start."""
    imaging = Imaging(start, Effects(), start, True, False)
    at, _ = imaging.numbers()
    names = [one.name for one in start.described() if one.fitted]
    moved = at + np.log([ratios.get(name, 1.0) for name in names])
    value, pull, _ = imaging.prior(moved, np.zeros(0))
    np.testing.assert_allclose(pull, imaging.prior_curvature() @ (moved - at))
    return value


def confocal(*fitted):
    return ConfocalPSF(ScalarPSF(1.2, 0.6, 1.33), 0.55, fitted=fitted)


def test_wavelengths_of_dyes_go_together():
    free = confocal("na", "wavelength", "excitation")
    together = nats(free, wavelength=1.3, excitation=1.3)
    assert together < 1
    assert nats(free, wavelength=1.3) > together + 3
    assert nats(free, excitation=1 / 1.3) > 3
    # 0.006 in the logarithm of their ratio are three standard deviations.
    apart = nats(free, excitation=np.exp(0.006)) - nats(
        confocal("excitation"), excitation=np.exp(0.006)
    )
    assert apart == pytest.approx(4.5)


def test_where_one_is_held_nothing_ties_it():
    assert nats(confocal("na", "wavelength"), wavelength=1.3) < 1


def test_objectives_are_round():
    gaussian = GaussianPSF((0.3, 0.1, 0.1))
    assert nats(gaussian, sigma_y=1.1, sigma_x=1.1) < 1
    assert nats(gaussian, sigma_y=1.1) > 100
