"""From the numbers on the objective to a PSF, and the numbers that cannot be."""

import pytest

import napari_deltamic as nd
from napari_deltamic import InputError, microscope

WATER = {"na": 1.1, "wavelength": 0.52, "immersion": "water"}


@pytest.mark.parametrize(
    ("modality", "kind"),
    [
        ("widefield", nd.VectorialPSF),
        ("confocal", nd.ConfocalPSF),
        ("spinning disk", nd.ConfocalPSF),
        ("light sheet", nd.LightSheetPSF),
    ],
)
def test_one_call_makes_the_psf_of_a_microscope(modality, kind):
    psf = microscope(modality, **WATER, sheet=1.0)
    assert isinstance(psf, kind)
    z, y, x = psf.sigma_um
    assert y == x
    assert 0.05 < x < z < 0.6


def test_optical_sections_are_thinner():
    wide, confocal, sheet = (
        microscope(m, **WATER, sheet=0.8).sigma_um[0]
        for m in ("widefield", "confocal", "light sheet")
    )
    assert confocal < wide
    assert sheet < wide


@pytest.mark.parametrize("modality", ["widefield", "confocal", "spinning disk", "light sheet"])
def test_gaussian_of_the_same_microscope_is_about_as_wide(modality):
    numbers = {**WATER, "na": 0.8, "sheet": 1.5}
    exact = microscope(modality, **numbers, model="scalar").sigma_um
    found = microscope(modality, **numbers, model="gaussian")
    assert isinstance(found, nd.GaussianPSF)
    for a, b in zip(found.sigma_um, exact, strict=True):
        assert a == pytest.approx(b, rel=0.35)


def test_zernike_phases_belong_to_the_pupil():
    psf = microscope(**WATER, model="pupil", zernike={5: 0.2})
    assert [p.name for p in psf.described() if p.fitted] == ["z5"]
    with pytest.raises(InputError, match="model 'pupil'"):
        microscope(**WATER, zernike={5: 0.2})


BAD = [
    ({"wavelength": 520}, "wavelength 520 um: did you mean 0.52"),
    ({"wavelength": 0.00052}, "did you mean 0.52"),
    ({"wavelength": 50.0}, "wavelength 50 um: did you mean 0.05"),
    ({"wavelength": 1e6}, "wavelength must lie between"),
    ({"na": 1.4}, "NA 1.4 must be below the refractive index of the immersion, 1.333"),
    ({"na": 140}, "na must lie between"),
    ({"na": 0}, "na must lie between"),
    ({"immersion": "beer"}, "unknown immersion 'beer'"),
    ({"immersion": 3.0}, "index must lie between"),
    ({"modality": "confocal", "pinhole": 0}, "pinhole must be larger than 0"),
    ({"modality": "confocal", "excitation": 488}, "excitation 488 um: did you mean 0.488"),
    ({"modality": "light sheet"}, "needs the thickness of its sheet"),
    ({"modality": "light sheet", "sheet": 2000}, "sheet 2000 um: did you mean 2"),
    ({"modality": "sted"}, "unknown modality 'sted'"),
    ({"depth": -1.0}, "depth must lie between"),
    ({"depth": 5000.0}, "depth 5000 um: did you mean 5"),
    ({"model": "scalar", "sample_index": 1.4, "depth": 5.0}, "has no layers"),
    ({"na": "high"}, "takes one number"),
]


@pytest.mark.parametrize(("numbers", "reason"), BAD)
def test_bad_numbers_are_refused(numbers, reason):
    with pytest.raises(InputError, match=reason):
        microscope(**{**WATER, **numbers})
