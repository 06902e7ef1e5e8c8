"""Which effects an image calls for."""

import importlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from evidence_scenes import GRID, OPTICS, SETTINGS, TRUTH, VOXEL, fitted, photons

from napari_deltamic.errors import InputError
from napari_deltamic.evidence import recommend, search
from napari_deltamic.evidence.candidates import beyond_bounds
from napari_deltamic.evidence.score import score
from napari_deltamic.fitting.model.state import FitState
from napari_deltamic.scene.effects import (
    Attenuation,
    Effects,
    Halo,
    Illumination,
    PixelIntegration,
)
from napari_deltamic.scene.light import Light


def ask(image, state, only=None, **options):
    return recommend(image, GRID, state.mesh, OPTICS, SETTINGS, only, fitted=state, **options)


def of(found, name):
    return next(e for e in found.evidence if e.name == name)


def test_an_image_without_effects_calls_for_none(plain):
    found = ask(*plain)
    assert found.recommended == ()
    assert found.effects == Effects()
    assert max(abs(e.score) for e in found.evidence) < found.threshold
    assert all("chance" in e.reason for e in found.evidence if e.score)


def test_a_halo_is_found_with_its_strength_bias_and_price(hazy):
    found = ask(*hazy)
    assert found.recommended == ("halo",)
    assert found.effects.halo.fraction == pytest.approx(0.3, rel=0.25)
    halo = of(found, "halo")
    assert halo.score > 10
    assert halo.bias_voxels > 0.05
    assert halo.bias_nm == pytest.approx(1e3 * halo.bias_voxels * min(VOXEL))
    assert halo.cost_ms > of(found, "attenuation").cost_ms
    assert "nm" in halo.reason


@pytest.mark.slow
def test_the_predicted_bias_is_that_of_a_fit(hazy):
    image, state = hazy
    found = ask(image, state, ["halo"])
    right = fitted(image, effects=Effects.of(Halo(fraction=0.3, width=1.0)))
    size = [np.cbrt(m.volumes()[1] * 3 / (4 * np.pi)) for m in (state.mesh, right.mesh)]
    swelling = abs(size[0] - size[1])
    assert of(found, "halo").bias_nm == pytest.approx(1e3 * swelling, rel=0.8)


def test_the_search_begins_with_the_numbers_that_a_fit_has_found(monkeypatch):
    """Not with those that its settings started from; on the image without a local background."""
    asked, seen = [], []

    def noted(image, *given, effects, fitted, **more):
        asked.append(effects)
        seen.append((image, fitted))

    module = importlib.import_module("napari_deltamic.evidence.recommend")
    monkeypatch.setattr(module, "recommend", noted)
    begun, found = (Effects.of(Halo(fraction=share, width=1.0)) for share in (0.1, 0.3))
    settings = SimpleNamespace(fit=SETTINGS, scene=SimpleNamespace(effects=begun))
    image = np.full(GRID.shape, 5, np.float32)
    job = SimpleNamespace(
        image=image, grid=GRID, mesh=TRUTH, optics=OPTICS, settings=settings, counted=None
    )
    module.recommend_for(job)
    around = np.full(GRID.shape, 2, np.float32)
    end = (1, 1, 1, TRUTH, OPTICS, np.ones(len(TRUTH.faces)), 0.1, 1.0, 0.0, 1.0)
    module.recommend_for(job, FitState(*end, effects=found, local_background=around))
    assert asked == [begun, found]
    assert seen[0] == (image, None)
    assert (seen[1][0] == image - 2).all()
    assert seen[1][1].local_background is None


@pytest.mark.slow
def test_light_from_inside_is_no_effect_and_stays_free():
    """A fit without the halo takes it for light inside, twice as much as there is."""
    given = photons(light=Light(1.0, 0.15), seed=1), 0.15
    hazy = photons(Effects.of(Halo(fraction=0.3, width=1.0)), light=Light(1.0, 0.15), seed=1), 0.3
    for image, fitted_as in (given, hazy):
        state = fitted(image, structure="both")
        assert state.light.interior == pytest.approx(fitted_as, rel=0.25)
        found = ask(image, state)
        assert found.recommended == (("halo",) if fitted_as > 0.2 else ())
        assert found.scene.light.interior == pytest.approx(0.15, rel=0.4)


@pytest.mark.slow
def test_it_is_the_same_every_time(hazy, one_thread):
    one, other = (
        [replace(e, cost_ms=0.0) for e in ask(*hazy, ["halo", "bleaching"]).evidence]
        for _ in range(2)
    )
    assert one == other


@pytest.mark.slow
def test_an_effect_that_is_there_is_not_asked_for_again(hazy):
    image, _ = hazy
    held = Effects.of(Halo(fraction=0.3, width=1.0))
    state = fitted(image, effects=held)
    found = ask(image, state, effects=state.effects)
    assert found.recommended == ()
    assert found.effects.halo is not None
    assert "halo" not in [e.name for e in found.evidence]


def test_what_hardly_moves_the_surface_is_seen_but_not_recommended():
    image = photons(Effects.of(Attenuation(per_um=0.05)), seed=2)
    even = fitted(image, density="uniform")  # else the brightness of the surface follows depth
    settings = SETTINGS.model_copy(update={"density": "uniform"})
    given = image, GRID, even.mesh, OPTICS, settings, ["attenuation", "bleaching"]
    found = recommend(*given, fitted=even)
    first = max(found.evidence, key=lambda e: abs(e.score))
    assert abs(first.score) > found.threshold
    assert first.recommended == (first.bias_voxels >= 0.02)
    # One of the two that pass for each other at most.
    assert len(found.recommended) <= 1


def test_slices_without_an_image_are_to_be_left_out(plain):
    image = plain[0].copy()
    image[11:13] = 0
    found = ask(image, fitted(image), ["halo"])
    assert found.effects.missing.slices == (11, 12)
    assert of(found, "missing").bias_voxels > 0.02


def test_a_fit_is_made_where_none_is_given(plain):
    told = []
    found = recommend(
        plain[0],
        GRID,
        TRUTH,
        OPTICS,
        SETTINGS.model_copy(update={"max_iterations": 20}),
        ["background"],
        progress=told.append,
    )
    assert found.recommended == ()
    assert "fitting" in told[0]


def test_an_unknown_candidate_is_refused(plain):
    with pytest.raises(InputError, match="choose from"):
        ask(*plain, ["ghosts"])
    with pytest.raises(InputError, match="not an effect that an image can show"):
        ask(*plain, ["camera"])
    with pytest.raises(InputError, match="name its file"):
        ask(*plain, ["second_view"])


def test_what_ends_at_its_bound_passes_for_something_else():
    assert beyond_bounds(Illumination(coefficients=(0.1, 2.0, 0, 0, 0)))
    assert beyond_bounds(Halo(fraction=0.0))
    assert not beyond_bounds(Attenuation(per_um=0.1))
    assert not beyond_bounds(PixelIntegration())


def test_what_is_not_clear_beside_the_misfit_is_taken_out_again(hazy, monkeypatch):
    """As if the residual varied far more from one large block to the next than nearby."""

    def unsure(*given):
        found = score(*given)
        return replace(found, z=found.z / 50)

    monkeypatch.setattr(search, "score", unsure)
    found = ask(*hazy, ["halo"])
    assert found.recommended == ()
    assert found.effects.halo is None
