"""What each effect does to an image, against what can be said without it."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch.autograd import gradcheck

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene, expected_image
from napari_deltamic.scene.effects import (
    KINDS,
    REFUSED,
    Attenuation,
    Background,
    Bleaching,
    Camera,
    DepthPSF,
    Effects,
    Halo,
    Illumination,
    Missing,
    SecondView,
)

SIGMA = (0.3, 0.22, 0.25)
OPTICS = nd.GaussianPSF(SIGMA)
GRID = nd.Grid((20, 27, 24), (0.2, 0.11, 0.13), origin=(-2.1, 3.0, 10.0))
CENTRE = np.array([-0.2, 4.4, 11.5])
BALL = sphere(CENTRE, (0.6, 0.5, 0.7), subdivisions=2)
FITTED = [name for name, kind in KINDS.items() if kind.bounds]
PRESENT = {
    "attenuation": Attenuation(per_um=0.2),
    "bleaching": Bleaching(per_slice=0.05),
    "illumination": Illumination(coefficients=(0.1, -0.2, 0.1, 0.05, -0.1)),
    "background": Background(coefficients=(1.0, 2.0, -1.0)),
    "halo": Halo(fraction=0.2, width=0.6),
    "depth_psf": DepthPSF(variance_z=0.1, variance_yx=-0.02),
}


def image(*effects, mesh=BALL, optics=OPTICS, **options):
    found = nd.render(mesh, GRID, optics, 1e-5, effects=Effects.of(*effects), **options)
    return found.numpy()


def positions(axis):
    return GRID.origin[axis] + GRID.voxel_size[axis] * np.arange(GRID.shape[axis])


PLAIN = image()
CLOSE = {"rtol": 0, "atol": 1e-4 * float(PLAIN.max())}


# ----------------------------------------------------------------------------------- the numbers


@pytest.mark.parametrize("name", FITTED)
def test_parameters_give_the_effect_back(name):
    effect = PRESENT[name]
    p = effect.parameters()
    assert p.dtype == torch.float64
    assert p.shape == (len(effect.values()),)
    again = effect.with_parameters(p).values()
    assert [v.value for v in again] == pytest.approx([v.value for v in effect.values()])
    assert all(v.name and v.unit for v in again)


@pytest.mark.parametrize("name", [n for n in FITTED if n != "background"])
@pytest.mark.parametrize("far", [-1e9, 1e9])
def test_any_parameters_are_allowed_and_end_at_the_bounds(name, far):
    effect = PRESENT[name].with_parameters(torch.full((9,), far)[: len(PRESENT[name].values())])
    low, high = effect.at_bounds()
    assert bool((high if far > 0 else low).all())
    type(effect).model_validate(effect.model_dump())  # the bounds are what the fields allow


@pytest.mark.parametrize("name", FITTED)
def test_neutral_changes_nothing(name):
    neutral = KINDS[name].neutral()
    found = expected_image(BALL, GRID, OPTICS, 1e-5, 1.0, 0.0, effects=Effects.of(neutral))
    assert_allclose(found, PLAIN, **CLOSE)


@pytest.mark.parametrize("name", FITTED)
def test_present_changes_the_image(name):
    found = expected_image(BALL, GRID, OPTICS, 1e-5, 1.0, 0.0, effects=Effects.of(PRESENT[name]))
    assert np.abs(found - PLAIN).max() > 1e-2 * PLAIN.max()


def test_polynomials_name_their_terms():
    assert [v.name for v in Illumination().values()] == ["y", "x", "yy", "yx", "xx"]
    assert [v.name for v in Background().values()] == ["z", "y", "x"]
    with pytest.raises(InputError, match="has 3 coefficients, not 2"):
        Effects.of("background").replace(background={"coefficients": (1.0, 2.0)})


# -------------------------------------------------------------------------------- what they do


def test_attenuation_is_a_density_that_falls_with_depth():
    z = BALL.vertices_numpy()[BALL.faces].mean(1)[:, 0]
    middle = positions(0)[[0, -1]].mean()
    dimmed = image(density=np.exp(-0.2 * (z - middle)))
    assert_allclose(image(PRESENT["attenuation"]), dimmed, **CLOSE)


def test_bleaching_dims_slice_after_slice():
    slices = np.arange(GRID.shape[0]) - (GRID.shape[0] - 1) / 2
    expected = PLAIN * np.exp(-0.05 * slices)[:, None, None]
    assert_allclose(image(PRESENT["bleaching"]), expected, **CLOSE)


def test_illumination_is_a_smooth_factor():
    t = [np.linspace(-1, 1, n) for n in GRID.shape]
    y, x = t[1][:, None], t[2]
    p2 = [(3 * u**2 - 1) / 2 for u in (y, x)]
    factor = np.exp(0.1 * y - 0.2 * x + 0.1 * p2[0] + 0.05 * y * x - 0.1 * p2[1])
    assert_allclose(image(PRESENT["illumination"]), PLAIN * factor, **CLOSE)


def test_background_is_added_to_the_measured_image():
    z, y, x = np.ix_(*(np.linspace(-1, 1, n) for n in GRID.shape))
    effects = Effects.of(PRESENT["background"])
    found = expected_image(BALL, GRID, OPTICS, 1e-5, 3.0, 5.0, effects=effects)
    assert_allclose(found, 3 * PLAIN + 5 + z + 2 * y - x, rtol=1e-4, atol=1e-4)
    assert_allclose(image(PRESENT["background"]), PLAIN, **CLOSE)  # not to fluorophores


def test_halo_is_a_share_of_a_wider_psf():
    wide = nd.GaussianPSF(np.hypot(SIGMA, 0.6))
    expected = 0.8 * PLAIN + 0.2 * image(optics=wide)
    assert_allclose(image(PRESENT["halo"]), expected, **CLOSE)


def test_depth_psf_is_that_of_either_end_at_the_ends():
    low, high = (positions(0)[k] for k in (0, -1))
    effect = DepthPSF(variance_z=0.1, variance_yx=-0.02)
    for z, added in ((low, (0, 0.02, 0.02)), (high, (0.1, 0, 0))):
        speck = sphere((z, *CENTRE[1:]), 0.02, subdivisions=1)
        there = nd.GaussianPSF(np.sqrt(np.square(SIGMA) + added))
        found, expected = image(effect, mesh=speck), image(mesh=speck, optics=there)
        # It reaches a little beyond the end, and to where it is half the other PSF.
        assert np.abs(found - expected).max() < 5e-3 * expected.max()


def test_gains_of_a_coarse_grid_are_those_of_the_image():
    coarse = GRID.strided((3, 2, 4))
    for name in ("bleaching", "illumination"):
        fine = PRESENT[name].gain(GRID, GRID).expand(GRID.shape)
        found = PRESENT[name].gain(coarse, GRID).expand(coarse.shape)
        assert_allclose(found, fine[::3, ::2, ::4], rtol=1e-12)


@pytest.mark.parametrize("names", [("attenuation",), ("attenuation", "depth_psf"), ("halo",)])
def test_gradient_in_the_vertices(names):
    mesh = sphere(CENTRE, 0.4, subdivisions=0)
    grid = nd.Grid((6, 6, 7), (0.3, 0.3, 0.3), origin=tuple(CENTRE - 0.8))
    effects = Effects.of(*(PRESENT[n] for n in names))
    renderer = Renderer(Scene.of(mesh, OPTICS, effects, insides=True), grid, 0)
    otf = renderer.otf(OPTICS)
    v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    assert gradcheck(lambda v: renderer.image(renderer.transform(v), otf), (v,), fast_mode=True)


# -------------------------------------------------------------------------------- the likelihood


def test_camera_tells_variance():
    camera = Camera(gain=2.0, offset=100.0, read_noise=3.0, saturation=4095.0)
    assert_allclose(camera.variance(np.array([90.0, 100.0, 150.0])), [9, 9, 109])


def test_missing_is_a_value_or_a_slice():
    stack = np.array([0.0, 1, 2, 3, 4, 0]).reshape(3, 1, 2)
    assert Missing(value=0).missing(stack).ravel().tolist() == [True] + [False] * 4 + [True]
    assert Missing(slices=(1, 9)).missing(stack).any((1, 2)).tolist() == [False, True, False]


# ---------------------------------------------------------------------------------- the set of them


def test_absent_effects_are_none():
    effects = Effects.of("halo", Attenuation(per_um=0.2))
    assert effects.names == ("attenuation", "halo")
    assert effects.camera is None
    assert effects.without("halo").names == ("attenuation",)
    assert effects.replace(halo=Halo(fraction=0.1)).halo.fraction == 0.1
    assert Effects().present() == ()


@pytest.mark.parametrize("name", [*FITTED, "second_view"])
def test_effects_come_back_from_plain_values_and_text(name):
    effect = {**PRESENT, "second_view": SecondView(sigma=(0.1, 0.2, 0.3), image="a b.tif")}[name]
    effects = Effects.of(effect, Camera(gain=2.0, saturation=255))
    assert Effects(**effects.to_dict()) == effects
    assert Effects.from_text(effects.to_text()) == effects


def test_text_gives_names_or_first_numbers():
    effects = Effects.from_text("attenuation=0.01, halo:fraction=0.05:fit=false,pixel-integration")
    assert effects.attenuation.per_um == 0.01
    assert (effects.halo.fraction, effects.halo.fit) == (0.05, False)
    assert effects.names == ("pixel_integration", "attenuation", "halo")
    assert Effects.from_text("none") == Effects()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("magic", "unknown effect 'magic': choose from pixel_integration"),
        ("halo,:", "unknown effect ':': choose from"),
        ("attenuation,bleaching", "no image tells attenuation from bleaching: choose one"),
        *((name, reason) for name, reason in REFUSED.items()),
        ("halo=2", "less than or equal to 0.8"),
        ("halo=dark", "halo.fraction: .* number"),
        ("second_view", "second_view.sigma: it must be given"),
        ("attenuation=nan", "attenuation.per_um"),
    ],
)
def test_refuses_what_cannot_be_fitted(text, says):
    with pytest.raises(InputError, match=says):
        Effects.from_text(text)


def test_aliases_are_allowed_where_one_is_held():
    both = Effects.of(Attenuation(per_um=0.01, fit=False), "bleaching")
    assert [e.name for e in both.fitted()] == ["bleaching"]


def test_every_effect_says_what_it_is():
    for name, kind in KINDS.items():
        assert kind.name == name
        assert len(kind.help) > 40
        assert kind.where in ("object", "fourier", "image", "likelihood")
        for other in kind.contradicts:
            assert name in KINDS[other].contradicts
