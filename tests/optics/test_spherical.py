"""Spherical aberration of a scalar PSF."""

import numpy as np
import pytest
import torch

from napari_deltamic import InputError, optics

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
    assert abs(float(z[int(along.argmax())])) < 0.15 * width
    assert np.abs(one - one[::-1]).max() > 0.02 * one.max()


def test_the_same_as_zernike_phases_but_for_the_focus():
    """At a low aperture, Noll's polynomial 11 has no defocus of its own."""
    grid = torch.linspace(-8, 8, 33, dtype=torch.float64)
    axes = grid[:, None, None] / 20, grid[None, :, None] / 8, grid[None, None, :] / 8
    extent = (20.0, 6.0)
    mine = optics.ScalarPSF(0.3, 0.5, 1.33, spherical=0.5, extent=extent).otf(axes)
    theirs = optics.PupilPSF(0.3, 0.5, 1.33, {11: 0.5}, extent=extent).otf(axes)
    assert float((mine - theirs).abs().max()) < 0.02 * float(theirs.abs().max())


def test_microscopes_take_it_for_the_scalar_model_alone():
    given = {"na": 1.2, "wavelength": 0.5, "immersion": "water", "spherical": 0.3}
    found = optics.microscope("confocal", model="scalar", **given)
    assert float(found.values["spherical"]) == 0.3
    with pytest.raises(InputError, match="spherical aberration belongs to the model 'scalar'"):
        optics.microscope("confocal", model="vectorial", **given)
