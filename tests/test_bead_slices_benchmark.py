"""What differs from slice to slice in the stack of a bead is found, and spoils nothing."""

import numpy as np
import pytest
from benchmarks.effects.bead_fit import fit_bead

import napari_deltamic as nd
from napari_deltamic import InputError

SHAPE, VOXEL = (13, 19, 21), (0.25, 0.12, 0.12)
SIGMA = (0.5, 0.2, 0.22)
PLACE = (1.52, 1.1, 1.23)
N = SHAPE[0]
RANDOM = np.random.default_rng(5)
DRIFT = np.stack([np.linspace(0.06, -0.06, N), np.linspace(-0.04, 0.04, N)], 1)
FOCUS = 0.05 * RANDOM.standard_normal(N)
BRIGHTNESS = 1 + 0.05 * RANDOM.standard_normal(N)
BACKGROUND = 100 + 8 * RANDOM.standard_normal(N)
MOTION = np.zeros((N, 3))
MOTION[6] = 0.02, 0.001, 0.0


def stack(drift=0.0, focus=0.0, brightness=1.0, background=100.0, motion=0.0, axial_blur=0.0):
    """Counts of a point seen through a Gaussian, in closed form; and their mean."""
    drift = np.broadcast_to(drift, (N, 2))
    motion = np.broadcast_to(motion, (N, 3))
    z, y, x = (np.arange(n) * d for n, d in zip(SHAPE, VOXEL, strict=True))
    z = z + focus - PLACE[0]
    y = y - PLACE[1] - drift[:, :1]
    x = x - PLACE[2] - drift[:, 1:]
    zz = SIGMA[0] ** 2 + axial_blur**2
    yy, xx = SIGMA[1] ** 2 + motion[:, 0], SIGMA[2] ** 2 + motion[:, 1]
    peak = 2e4 * brightness * SIGMA[1] * SIGMA[2] / np.sqrt(yy * xx) * np.exp(-(z**2) / (2 * zz))
    rows, columns = np.exp(-(y**2) / (2 * yy[:, None])), np.exp(-(x**2) / (2 * xx[:, None]))
    clean = peak[:, None, None] * rows[:, :, None] * columns[:, None]
    clean = clean + np.broadcast_to(background, N)[:, None, None]
    return np.random.default_rng(0).poisson(clean).astype(float), clean


def held_psf():
    psf = nd.GaussianPSF(SIGMA)
    psf.limits = lambda: (psf.parameters(), psf.parameters())
    return psf


def fitted(image, variance, *disturbances):
    return fit_bead(
        image,
        VOXEL,
        held_psf(),
        variance=variance,
        pixel_integration=False,
        disturbances=disturbances,
        iterations=15,
    )


@pytest.mark.parametrize(
    ("name", "true", "within"),
    [
        ("brightness", BRIGHTNESS / BRIGHTNESS.mean(), 0.02),
        ("background", BACKGROUND, 3.0),
        ("drift", DRIFT, 0.01),
        ("focus", FOCUS, 0.02),
        ("motion", MOTION, 0.004),
        ("axial blur", 0.2, 0.01),
    ],
)
def test_a_disturbance_is_found_where_the_slices_hold_light(name, true, within):
    given = {name.replace(" ", "_"): BRIGHTNESS if name == "brightness" else true}
    image, variance = stack(**given)
    assert fitted(image, variance).chi2 > 1.1
    found = fitted(image, variance, name)
    assert found.chi2 == pytest.approx(1, abs=0.06)
    off = np.asarray(found.slices[name] - true)
    if name in ("drift", "focus", "brightness"):
        # All slices shifted alike is the place of the bead; what they share is not told apart.
        off = (off - off[3:10].mean(0))[3:10]
    if name == "brightness":
        # Of a PSF that is a Gaussian along Z, brighter slices to one side are a place along Z.
        slices = np.arange(len(off))
        off = off - np.polyval(np.polyfit(slices, off, 1), slices)
    if name == "motion":
        off = off[6]
    assert np.abs(off).max() < within


def test_a_still_bead_shows_none():
    image, variance = stack()
    every = ("brightness", "background", "drift", "focus", "motion", "axial blur")
    found = fitted(image, variance, *every)
    assert found.chi2 == pytest.approx(1, abs=0.06)
    assert np.abs(found.slices["drift"][4:9]).max() < 0.01
    assert np.abs(found.slices["focus"][4:9]).max() < 0.03
    assert found.slices["axial blur"] < 0.1
    assert found.centre == pytest.approx(PLACE, abs=0.02)


def test_without_disturbances_nothing_is_said_of_them():
    assert fitted(*stack()).slices == {}


def test_derivatives_agree_with_differences():
    import torch
    from benchmarks.effects.bead_slices import Slices

    from napari_deltamic.fourier import Band

    band = Band.full((16, 24, 24), VOXEL)
    slices = Slices(("drift", "focus", "motion", "axial blur"), band, (7, 9, 11))
    at = (0.8, 0.5, 0.6)
    spectrum = held_psf().otf(band.axes()).to(torch.complex128)
    for k, place in zip(band.axes(), at, strict=True):
        spectrum = spectrum * torch.exp(-1j * k * place)
    values = 0.01 * torch.rand(slices.count, generator=torch.Generator().manual_seed(1)).double()
    terms = slices.terms(spectrum, values)
    columns = [share[:, i, None, None] * t for t, share in terms for i in range(share.shape[1])]
    for i in range(slices.count):
        change = torch.zeros_like(values)
        change[i] = 1e-4
        wide = slices.image(spectrum, values + change) - slices.image(spectrum, values - change)
        assert torch.allclose(columns[i], wide / 2e-4, atol=1e-5 * columns[i].abs().max())


def test_an_unknown_disturbance_is_refused():
    image, variance = stack()
    with pytest.raises(InputError, match="unknown disturbance 'wobble': choose from brightness"):
        fitted(image, variance, "wobble")
