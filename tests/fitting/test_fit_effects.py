"""Fits with effects: their numbers are found with the shape, told, kept and changed on the way."""

import numpy as np
import pytest

from napari_deltamic import Change, GaussianPSF, fit
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.model.level import Level
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import write_image
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.effects import (
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
from napari_deltamic.scene.light import MEMBRANES, Light
from synthetic import (
    CENTER,
    GRID,
    OPTICS,
    RADIUS,
    SHORT,
    TRUTH,
    VOXEL,
    apart,
    fitted,
    measured,
    start,
)

NEAR = FitSettings(levels=(1.5, 1.0))
CASES = [
    (Attenuation(per_um=0.15), 0.01),
    (Bleaching(per_slice=0.02), 2e-3),
    (Halo(fraction=0.1, width=0.5), 0.05),
    (Background(coefficients=(2.0, -1.0, 1.0)), 0.1),
    (Illumination(order=1, coefficients=(0.15, -0.1)), 0.02),
    (DepthPSF(variance_z=0.012, variance_yx=0.006), 2e-3),
]


def near(subdivisions=2):
    return sphere(np.add(CENTER, (0, 0.05, -0.05)), 0.9 * RADIUS, subdivisions=subdivisions)


def scene(*effects, peak=40.0, background=4.0, light=MEMBRANES):
    """Image without noise; its effects."""
    plain = expected_image(TRUTH, GRID, OPTICS, 1e-4, 1.0, 0.0)
    chosen = Effects.of(*effects)
    amplitude = peak / plain.max()
    given = TRUTH, GRID, OPTICS, 1e-4, amplitude, background
    return expected_image(*given, effects=chosen, light=light)


def numbers(effect):
    return np.array([v.value for v in effect.values()])


@pytest.mark.slow
def test_finds_the_light_inside_beside_an_effect():
    image = scene(Attenuation(per_um=0.15), light=Light(1.0, 0.3))
    # A smooth brightness would follow depth as well.
    settings = NEAR.model_copy(update={"structure": "both", "density": "uniform"})
    last = fitted(image, near(), settings=settings, effects=("attenuation",))
    assert last.light.interior == pytest.approx(0.3, abs=0.02)
    assert last.effects.attenuation.per_um == pytest.approx(0.15, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "within"), CASES, ids=lambda x: getattr(x, "name", ""))
def test_finds_the_numbers_and_the_shape(effect, within):
    image = scene(effect)
    first = type(effect)(**{"order": effect.order} if hasattr(effect, "order") else {})
    # A smooth brightness would follow depth as well.
    settings = NEAR.model_copy(update={"density": "uniform"})
    last = fitted(image, near(3), settings=settings, effects=Effects.of(first))
    (found,) = last.effects.present()
    np.testing.assert_allclose(numbers(found), numbers(effect), rtol=0, atol=within)
    left_out = fitted(image, near(3), settings=settings)
    assert apart(last.mesh) < 0.6 * apart(left_out.mesh) or apart(left_out.mesh) < 0.02
    # What is shown is what was fitted.
    assert np.abs(last.rendered() - image).max() < 0.1 * np.abs(left_out.rendered() - image).max()


def test_the_unit_of_the_image_does_not_change_how_a_background_is_found():
    image = scene(Background(coefficients=(8.0, -4.0, 4.0)))
    settings = SHORT.model_copy(update={"fit_psf": False, "structure": "membrane"})
    one, other = (
        fitted(times * image, near(), settings=settings, effects=("background",))
        for times in (1.0, 4096.0)  # a power of two: nothing is rounded
    )
    found = numbers(other.effects.background) / 4096
    np.testing.assert_allclose(found, numbers(one.effects.background), rtol=1e-3)
    assert apart(one.mesh, other.mesh) < 1e-3


@pytest.mark.slow
def test_finds_psf_and_effects_together():
    effects = (Attenuation(per_um=0.1), Illumination(order=1, coefficients=(0.15, -0.1)))
    settings = NEAR.model_copy(update={"fit_psf": True, "density": "uniform"})
    last = fitted(
        scene(*effects),
        near(),
        optics=GaussianPSF(0.16),
        settings=settings,
        effects=Effects.of("attenuation", Illumination(order=1)),
    )
    assert last.effects.attenuation.per_um == pytest.approx(0.1, abs=0.01)
    assert last.effects.illumination.coefficients == pytest.approx((0.15, -0.1), abs=0.02)
    np.testing.assert_allclose(last.optics.sigma_um, OPTICS.sigma_um, rtol=0.02)


@pytest.mark.slow
def test_numbers_that_are_held_stay():
    held = Attenuation(per_um=0.05, fit=False)
    last = fitted(scene(Attenuation(per_um=0.1)), near(), settings=NEAR, effects=Effects.of(held))
    assert last.effects.attenuation == held


def test_numbers_stay_within_their_bounds():
    """A PSF sharper than it is taken for looks as if there were less than no halo."""
    wide, halo = GaussianPSF(0.15), Halo(fraction=0.0, width=0.4)
    held = SHORT.model_copy(update={"fit_psf": False, "structure": "membrane"})
    last = fitted(scene(), near(), optics=wide, settings=held, effects=Effects.of(halo))
    assert last.effects.halo.fraction < 0.05
    assert last.effects.halo.width >= 0.05


@pytest.mark.slow
@pytest.mark.parametrize("density", [-0.3, -1.0])
def test_an_inside_darker_than_the_medium_around_is_found(density):
    image = scene(light=Light(1.0, density), background=40.0)
    last = fitted(image, near(), settings=NEAR.model_copy(update={"structure": "both"}))
    assert last.light.interior == pytest.approx(density, rel=0.05)
    alone = NEAR.model_copy(update={"structure": "membrane"})
    assert apart(last.mesh) < 0.5 * apart(fitted(image, near(), settings=alone).mesh)
    found = fitted(image, near(), settings=NEAR)  # without a word of an inside
    assert found.light.interior == pytest.approx(density, rel=0.05)
    assert apart(found.mesh) < 1.1 * apart(last.mesh)


def test_voxels_of_a_dark_inside_count(monkeypatch):
    """Though the membrane's light, less that of the medium, is below that of no membrane there."""
    counted, plain = [], Level.near

    def near_surface(level, *given):
        counted.append(plain(level, *given))
        return counted[-1]

    monkeypatch.setattr(Level, "near", near_surface)
    image = scene(light=Light(1.0, -1.0), background=40.0)
    fitted(image, near(), settings=SHORT.model_copy(update={"structure": "both"}))
    places = np.stack(np.indices(GRID.shape), -1).reshape(-1, 3) * VOXEL
    depth = 0.9 * RADIUS - np.linalg.norm(places - CENTER, axis=1)
    inside = (depth > 1.0 * OPTICS.sigma_um[0]) & (depth < 2.5 * OPTICS.sigma_um[0])
    found = np.zeros(len(places), bool)
    found[counted[0].numpy()] = True
    assert found[inside].all()


@pytest.mark.slow
def test_a_number_that_shows_nowhere_yet_is_no_obstacle():
    """The width of a halo without light."""
    effects = Effects.of(Halo(fraction=0.0))
    held = NEAR.model_copy(update={"fit_psf": False})  # a wider PSF passes for a halo
    last = fitted(scene(Halo(fraction=0.2, width=0.5)), near(), settings=held, effects=effects)
    assert last.effects.halo.fraction == pytest.approx(0.2, abs=0.05)


# ------------------------------------------------------------------------------- the likelihood


@pytest.mark.slow
def test_saturated_voxels_are_at_least_that_bright():
    """With or without a camera that says so; as they stand, they would be 1.5 times too dark."""
    image = measured(noise=3)
    cut = np.minimum(image, 25.0)
    held = NEAR.model_copy(update={"fit_psf": False})  # a wider PSF is less bright, too
    whole = fitted(image, near(), settings=held).amplitude
    for effects in (Effects(), Effects.of(Camera(saturation=25.0, offset=0.0))):
        found = fitted(cut, near(), settings=held, effects=effects).amplitude
        assert found == pytest.approx(whole, rel=0.1)


@pytest.mark.slow
def test_missing_slices_are_left_out():
    image = measured()
    image[9:12] = 0
    blind = fitted(image, near(), settings=NEAR)
    for missing in (Missing(slices=(9, 10, 11)), Missing(value=0.0)):
        last = fitted(image, near(), settings=NEAR, effects=Effects.of(missing))
        assert apart(last.mesh) < 0.5 * apart(blind.mesh)


@pytest.mark.slow
def test_a_second_view_sees_what_the_first_does_not(tmp_path, one_thread):
    first, second = (0.3, 0.1, 0.1), (0.1, 0.1, 0.3)
    images = [measured(optics=GaussianPSF(s), noise=k) for k, s in enumerate((first, second))]
    alone = fitted(images[0], near(), optics=GaussianPSF(first), settings=NEAR)
    path = tmp_path / "second.npy"
    write_image(path, images[1].astype(np.float32), GRID.voxel_size)
    view = SecondView(sigma=second, image=str(path))
    both = [
        fitted(images[0], near(), optics=GaussianPSF(first), settings=NEAR, **options)
        for options in (
            {"effects": Effects.of(view)},
            {"effects": Effects.of(SecondView(sigma=second)), "second": images[1]},
        )
    ]
    assert apart(both[0].mesh) < 0.85 * apart(alone.mesh)
    np.testing.assert_array_equal(both[0].mesh.vertices, both[1].mesh.vertices)


def test_a_second_view_of_which_much_is_missing_waits_until_it_can_be_told():
    second = measured(noise=1).astype(float)
    second[:, :, : GRID.shape[2] // 2] = np.nan
    settings = FitSettings(levels=(6.0, 1.0), max_iterations=6)
    given = {"effects": Effects.of(SecondView(sigma=(0.13,) * 3)), "settings": settings}
    last = fitted(measured(noise=0), near(), second=second, **given)
    assert last.level == 2
    few = np.where(np.arange(second.size).reshape(second.shape) < 50, measured(noise=1), np.nan)
    with pytest.raises(InputError, match="second view: only 50 voxels count"):
        fitted(measured(), second=few, **given)


def test_refuses_a_second_view_that_does_not_fit():
    effects = Effects.of(SecondView(sigma=(0.1, 0.1, 0.3)))
    with pytest.raises(InputError, match="second_view has no image: name its file"):
        fitted(measured(), effects=effects)
    with pytest.raises(InputError, match="second view: the image has shape"):
        fitted(measured(), effects=effects, second=np.zeros((3, 4, 5)))


# ---------------------------------------------------------------------------------- on the way


def test_effects_can_be_switched_on_while_a_fit_runs():
    image = scene(Attenuation(per_um=0.15))
    even = NEAR.model_copy(update={"density": "uniform"})
    states = fit(image, GRID, near(), OPTICS, settings=even)
    last = [next(states) for _ in range(10)][-1]
    assert last.effects == Effects()
    last = states.send(Change(effects=Effects.of("attenuation")))
    for last in states:  # noqa: B007
        pass
    assert last.effects.attenuation.per_um == pytest.approx(0.15, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["attenuation", "halo"])
def test_a_resumed_fit_ends_as_the_uninterrupted_one(tmp_path, effect):
    image, path = scene(light=Light(1.0, 0.3)), tmp_path / "checkpoint.npz"
    for state in fit(image, GRID, start(2), OPTICS, settings=NEAR, effects=(effect,)):
        if state.iteration == 45:
            state.save(path)
    resumed = fitted(image, start(2), settings=NEAR, effects=(effect,), resume=path)
    assert resumed.iteration == state.iteration
    found, expected = (numbers(*s.effects.present()) for s in (resumed, state))
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert np.any(found != numbers(*Effects.of(effect).present()))


def test_refuses_the_checkpoint_of_a_fit_with_other_effects(tmp_path):
    path = tmp_path / "checkpoint.npz"
    next(fit(scene(), GRID, start(1), OPTICS, effects=("halo",))).save(path)
    with pytest.raises(InputError, match="belongs to a fit with other settings"):
        fit(scene(), GRID, start(1), OPTICS, resume=path)
