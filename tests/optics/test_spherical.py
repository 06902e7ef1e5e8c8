"""Spherical aberration of a scalar PSF."""

import numpy as np
import pytest
import torch

from napari_deltamic import InputError, optics
from napari_deltamic.fitting.rivals.found_psf import psf_from, settings_of, values_of
from napari_deltamic.fitting.rivals.light_cone import confocal_of, widefield_of

Z = torch.linspace(-3, 3, 241, dtype=torch.float64)
AXIS = torch.zeros(1, dtype=torch.float64)


def on_axis(spherical, na=0.5, z=Z):
    model = optics.ScalarPSF(na, 0.5, 1.33, spherical=spherical)
    return model.intensity_at(z, AXIS)[:, 0].numpy()


@pytest.mark.parametrize("aberration", [0.2, -0.3])
def test_the_focus_darkens_as_marechal_says(aberration):
    """A. Marechal, Rev. Opt. 26, 1947: by exp(-variance of the phase)."""
    focus = torch.zeros(1, dtype=torch.float64)
    found = on_axis(aberration, z=focus) / on_axis(0.0, z=focus)
    assert found == pytest.approx(np.exp(-(aberration**2)), rel=0.01)


@pytest.mark.parametrize("na", [0.5, 1.2])
def test_the_focus_stays_and_rings_lie_on_one_side(na):
    z = Z * (0.5 / na) ** 2 * 2
    radii = torch.linspace(0, 1.2, 25, dtype=torch.float64) / na
    one, other = (
        optics.ScalarPSF(na, 0.5, 1.33, spherical=a).intensity_at(z, radii).numpy()
        for a in (0.6, -0.6)
    )
    np.testing.assert_allclose(one, other[::-1], rtol=1e-9)
    along = one[:, 0]
    width = float(np.ptp(np.asarray(z)[along > along.max() / 2]))
    assert abs(float(z[int(along.argmax())])) < 0.06 * width
    assert np.abs(one - one[::-1]).max() > 0.02 * one.max()


def test_the_same_as_zernike_phases_but_for_the_focus():
    """At a low aperture, Noll's polynomial 11 has no defocus of its own."""
    grid = torch.linspace(-8, 8, 33, dtype=torch.float64)
    axes = grid[:, None, None] / 20, grid[None, :, None] / 8, grid[None, None, :] / 8
    extent = (20.0, 6.0)
    mine = optics.ScalarPSF(0.3, 0.5, 1.33, spherical=0.5, extent=extent).otf(axes)
    theirs = optics.PupilPSF(0.3, 0.5, 1.33, {11: 0.5}, extent=extent).otf(axes)
    assert float((mine - theirs).abs().max()) < 0.02 * float(theirs.abs().max())


AXES = tuple(
    (2 * np.pi * torch.fft.fftfreq(n, d, dtype=torch.float64)).reshape(shape)
    for n, d, shape in ((32, 0.25, (-1, 1, 1)), (40, 0.1, (1, -1, 1)), (40, 0.1, (1, 1, -1)))
)


@pytest.mark.parametrize("confocal", [False, True])
def test_a_fit_has_room_and_nodes_for_more(confocal):
    """Whether the objective alone is asked, or a PSF that is made of it."""

    def psf(spherical, fitted, extent=None):
        names = ("spherical",) if fitted else ()
        given = {"na": 1.2, "wavelength": 0.6, "index": 1.33, "spherical": spherical}
        if not confocal:
            return optics.ScalarPSF(**given, fitted=names, extent=extent)
        objective = optics.ScalarPSF(**given, fitted=())
        return optics.ConfocalPSF(objective, 0.56, fitted=names, extent=extent)

    free = psf(0.0, fitted=True)
    assert free.extent[0] > 1.2 * psf(0.0, fitted=False).extent[0]
    extent = free.extent[0] / 2, free.extent[1] / 2  # it falls to zero over as much again
    for aberration in (0.4, 2.0):
        moved = free.with_parameters(torch.tensor([aberration], dtype=torch.float64))
        expected = psf(aberration, fitted=False, extent=extent).otf(AXES)
        assert float((moved.otf(AXES) - expected).abs().max()) < 1e-6


def test_a_light_sheet_has_room_for_what_is_fitted():
    def psf(spherical, *fitted):
        objective = optics.ScalarPSF(1.1, 0.6, 1.33, spherical=spherical, fitted=())
        return optics.LightSheetPSF(objective, 6.0, fitted=fitted)

    free = psf(0.0, "na", "spherical")
    moved = free.with_parameters(free.parameters() + torch.tensor([0.0, 0.5]))
    assert float((moved.otf(AXES) - psf(0.5, "na", "spherical").otf(AXES)).abs().max()) < 0.01


def test_both_wavelengths_pass_the_same_glass():
    emitted = optics.ScalarPSF(1.2, 0.6, 1.33, spherical=0.6)
    exciting = emitted.with_wavelength(torch.tensor(0.5, dtype=torch.float64))
    assert float(exciting.values["spherical"]) == pytest.approx(0.72)


def test_a_widened_psf_is_as_much_wider_whatever_its_aberration():
    for spherical in (0.0, 0.8):
        psf = confocal_of((0.4, 0.15, 0.15), spherical)
        width = np.prod(psf.sigma_um) ** (1 / 3)
        expected = np.hypot(1, 0.2 / width) * np.array(psf.sigma_um)
        np.testing.assert_allclose(psf.widened(0.2).sigma_um, expected, rtol=0.02)


def test_a_band_is_planned_for_what_a_step_makes_of_it():
    fitted = {"fitted": ("spherical",)}
    for start, sharpest in ((0.6, 0.6 + np.log(0.9)), (-0.6, -0.6 - np.log(0.9)), (0.05, 0.0)):
        psf = optics.ScalarPSF(1.2, 0.6, 1.33, spherical=start, **fitted)
        assert float(psf.sharpened(0.9).values["spherical"]) == pytest.approx(sharpest)


def test_settings_tell_it():
    found = confocal_of((0.4, 0.15, 0.15), -0.5)
    again = settings_of(found).build()
    assert again.described() == found.described()
    assert torch.equal(again.otf(AXES), found.otf(AXES))
    kept = psf_from(values_of(found))
    assert torch.equal(kept.otf(AXES), found.otf(AXES))


@pytest.mark.parametrize(
    "sigma",
    [
        pytest.param((0.3, 0.11, 0.11), marks=pytest.mark.slow),
        (6.0, 0.2, 0.2),
        pytest.param((0.05, 0.05, 0.05), marks=pytest.mark.slow),
    ],
)
def test_whatever_a_fit_may_find_has_settings(sigma):
    """As far as it may go, and from there as far again."""
    for made in (confocal_of, widefield_of):
        for end in (0, 1):
            found = made(sigma, 0.0)
            for _ in range(2):
                found = found.with_parameters(found.limits()[end])
                again = settings_of(found).build()
                for one, other in zip(again.described(), found.described(), strict=True):
                    assert one.value == pytest.approx(other.value)
                found = again


def test_a_value_that_cannot_be_is_no_other_unit():
    with pytest.raises(InputError, match="spherical must lie between -10 and 10 rad, not 30"):
        optics.ScalarPSF(1.2, 0.6, 1.33, spherical=30.0)


def test_microscopes_take_it_for_the_scalar_model_alone():
    given = {"na": 1.2, "wavelength": 0.5, "immersion": "water", "spherical": 0.3}
    found = optics.microscope("confocal", model="scalar", **given)
    assert float(found.values["spherical"]) == 0.3
    with pytest.raises(InputError, match="spherical aberration belongs to the model 'scalar'"):
        optics.microscope("confocal", model="vectorial", **given)


def test_it_is_made_once_where_no_gradient_is_asked_for():
    """Views of a leaf ask for gradients even under no_grad, and what asks for them is not kept."""
    start = optics.ScalarPSF(1.2, 0.6, 1.33, spherical=0.1, fitted=("spherical",))
    numbers = start.parameters().detach().requires_grad_()
    with torch.no_grad():
        found = start.with_parameters(numbers)
    assert found.otf(AXES) is found.otf(AXES)
    start.with_parameters(numbers).otf(AXES).abs().sum().backward()
    assert numbers.grad is not None
