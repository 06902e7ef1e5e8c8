"""What shines is found with the shape."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.common.doing import heard
from napari_deltamic.errors import InputError
from napari_deltamic.fitting import model_choice
from napari_deltamic.fitting.model.amplitudes import mixture
from napari_deltamic.fitting.objective import structure_choice
from napari_deltamic.fitting.objective.fit_objective import Objective
from napari_deltamic.fitting.rivals import rival_structures
from napari_deltamic.fitting.surface.surface_upkeep import SurfaceUpkeep
from napari_deltamic.fitting.uncertainty.errors_of_measures import posed_at
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.light import INSIDES, MEMBRANES, Light, structure_of

GRID = nd.Grid((24, 24, 24), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF((0.3, 0.24, 0.24))
MIDDLE = np.full(3, 2.3)


def cell(radius: float = 1.35) -> nd.Mesh:
    """An ellipsoid."""
    ball = sphere((0, 0, 0), radius, edge_length=0.25)
    return ball.with_vertices(ball.vertices_numpy() * [0.9, 1.0, 1.1] + MIDDLE)


def image_of(light: Light, photons: float = 60.0) -> np.ndarray:
    """Noisy; 8 photons of background, and enough that no inside is darker than 0."""
    given = cell(), GRID, OPTICS, 1e-4
    shown = nd.scene.expected_image(*given, 1.0, 0.0, light=light)
    shown = photons * (shown - min(shown.min(), 0)) / np.ptp(shown) + 8.0
    return np.random.default_rng(4).poisson(shown).astype(np.float32)


def fitted(image: np.ndarray, **settings: object) -> nd.fitting.FitState:
    start = sphere(MIDDLE + np.array([0.1, -0.1, 0.15]), 1.2, edge_length=0.3)
    *_, last = nd.fit(image, GRID, start, OPTICS, settings=FitSettings(**settings))
    return last


@cache
def fitted_to(light: Light) -> nd.fitting.FitState:
    """Of settings as they are by default; several tests go on from it."""
    return fitted(image_of(light))


@pytest.mark.parametrize(
    ("light", "name"),
    [
        (MEMBRANES, "membrane"),
        pytest.param(INSIDES, "interior", marks=pytest.mark.slow),
        pytest.param(Light(1.0, 1.5), "both", marks=pytest.mark.slow),
        (Light(1.0, -0.8), "both"),
    ],
)
def test_what_shines_is_found_with_the_shape(light: Light, name: str) -> None:
    last = fitted_to(light)
    assert structure_of(last.light) == name
    assert abs(last.mesh.region_volume(1) / cell().region_volume(1) - 1) < 0.02
    if name == "both":
        assert last.light.interior == pytest.approx(light.interior, rel=0.2)
    error = last.rendered() - image_of(light)
    assert error.std() < 1.1 * np.sqrt(image_of(light).mean())


@pytest.mark.parametrize(("light", "asked"), [(MEMBRANES, "membrane"), (Light(1.0, 1.5), "both")])
def test_of_many_voxels_some_are_asked(light: Light, asked: str, monkeypatch) -> None:
    image = image_of(light)
    last = replace(fitted_to(light), light=Light(1.0, 1.0))
    posed = posed_at(image, GRID, last, FitSettings())
    given = posed.posterior, posed.at, posed.posterior(posed.at), last.mesh
    voxels = posed.posterior.views[0].voxels.index.numpy()
    rows, block = structure_choice._blocks(posed.posterior, 4.0)
    np.testing.assert_array_equal(rows, np.arange(len(voxels)))
    every = structure_choice.told(*given)[1]
    monkeypatch.setattr(
        structure_choice, "RULES", replace(structure_choice.RULES, most=-(-len(voxels) // 3))
    )
    some, blocks = structure_choice._blocks(posed.posterior, 4.0)
    assert 0.2 < len(some) / len(voxels) < 0.5
    # Whole blocks: no block has voxels that are asked and others that are not.
    assert not np.isin(block[np.setdiff1d(rows, some)], block[some]).any()
    assert len(np.unique(blocks)) == len(np.unique(block[some])) == blocks.max() + 1
    assert structure_choice.chosen(*given, lambda: False).structure == asked
    found = structure_choice.told(*given)[1]
    if asked == "both":
        assert 0.3 * every.errors < found.errors < every.errors


@pytest.mark.parametrize(("light", "name"), [(MEMBRANES, "both"), (INSIDES, "interior")])
def test_an_inside_that_is_dimmer_than_the_membrane_does_not_outshine_it(light, name, monkeypatch):
    """However many standard errors it differs from 0 by, and an uneven membrane does not."""
    image = image_of(light)
    last = replace(fitted_to(light), light=Light(1.0, 1.0))
    posed = posed_at(image, GRID, last, FitSettings())
    given = posed.posterior, posed.at, posed.posterior(posed.at), last.mesh
    found = structure_choice.Told(0.7, 1.0), structure_choice.Told(-9.0, 1.0)
    monkeypatch.setattr(structure_choice, "told", lambda *_: found)
    assert structure_choice.chosen(*given, lambda: False).structure == name


def test_a_membrane_alone_does_not_explain_an_inside() -> None:
    """What the test above would not see if it could not fail."""
    last = fitted(image_of(INSIDES), structure="membrane")
    assert abs(last.mesh.region_volume(1) / cell().region_volume(1) - 1) > 0.2


def test_open_surfaces_have_no_interior() -> None:
    ball = cell()
    opened = nd.Mesh(ball.vertices, ball.faces[3:], ball.regions[3:])
    with pytest.raises(InputError, match="not closed"):
        next(
            nd.fit(
                image_of(MEMBRANES), GRID, opened, OPTICS, settings=FitSettings(structure="both")
            )
        )


def test_mixtures_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    columns = torch.from_numpy(rng.normal(size=(2, 200)))
    weights = torch.from_numpy(rng.uniform(0.5, 2, 200))
    measured = 2 * columns[0] - 3 * columns[1] + 7
    found = mixture(*columns, measured, weights)
    assert found.membrane == 1
    assert found.interior == pytest.approx(-1.5)
    # Membranes are not negative.
    assert mixture(*columns, measured - 4 * columns[0], weights) == Light(0.0, -1.0)


@pytest.mark.slow
def test_insides_that_left_at_the_start_come_back(monkeypatch):
    """Walls that labels drew wrongly hide them at first; a fit of one level asks once more."""
    answers = iter([structure_choice.Chosen("membrane", False)])
    asked = Objective.structure
    monkeypatch.setattr(Objective, "structure", lambda o: next(answers, None) or asked(o))
    given = {"structure": "auto", "levels": (1.0,)}
    both = fitted(image_of(Light(1.0, 0.3)), **given)
    assert structure_of(both.light) == "both"
    assert next(answers, None) is None
    answers = iter([structure_choice.Chosen("membrane", False)])
    assert structure_of(fitted(image_of(MEMBRANES), **given).light) == "membrane"


@pytest.mark.parametrize(
    ("light", "name"),
    [
        (INSIDES, "interior"),
        pytest.param(Light(1.0, 4.0), "both", marks=pytest.mark.slow),
        pytest.param(MEMBRANES, "both", marks=pytest.mark.slow),
    ],
)
def test_faint_membranes_leave_at_rest_where_insides_explain_as_much(light, name, monkeypatch):
    """Whatever linear estimates say on the way."""
    given = {"structure": "auto", "fit_psf": True}
    monkeypatch.setattr(
        Objective, "structure", lambda o: structure_choice.Chosen("both", False, faint=True)
    )
    last = fitted(image_of(light), **given)
    assert structure_of(last.light) == name
    if name == "interior":
        assert abs(last.mesh.region_volume(1) / cell().region_volume(1) - 1) < 0.02


@pytest.mark.slow
def test_faint_membranes_stay_where_both_are_asked_for(monkeypatch):
    monkeypatch.setattr(
        Objective, "structure", lambda o: structure_choice.Chosen("both", False, faint=True)
    )
    assert structure_of(fitted(image_of(INSIDES), structure="both").light) == "both"


@pytest.mark.parametrize(
    ("light", "name"),
    [
        (Light(1.0, 1.0), "both"),
        pytest.param(Light(1.0, 3.0), "both", marks=pytest.mark.slow),
        pytest.param(INSIDES, "interior", marks=pytest.mark.slow),
    ],
)
def test_membranes_come_back_where_labels_reached_out_too_far(light, name):
    """One level, from where the light of the membranes ends."""
    start = cell().with_vertices(MIDDLE + (cell().vertices_numpy() - MIDDLE) * 1.35)
    settings = FitSettings(structure="auto", levels=(1.0,), fit_psf=True)
    *_, last = nd.fit(image_of(light), GRID, start, OPTICS, settings=settings)
    assert structure_of(last.light) == name
    assert abs(last.mesh.region_volume(1) / cell().region_volume(1) - 1) < 0.03


def test_who_listens_hears_of_a_comparison_and_may_end_the_fit():
    """Membranes and insides are compared where a fit of insides is at rest."""

    class Stopped(Exception):
        pass

    def stop(what):
        if what == "comparing models":
            raise Stopped

    start = cell().with_vertices(MIDDLE + (cell().vertices_numpy() - MIDDLE) * 1.1)
    settings = FitSettings(structure="auto", levels=(1.0,))
    states = nd.fit(image_of(INSIDES), GRID, start, OPTICS, settings=settings)
    states = heard(states, stop)
    first = next(states)
    assert first.iteration == 1  # an iteration is no comparison
    with pytest.raises(Stopped):
        list(states)


@pytest.mark.slow
def test_membranes_that_a_far_too_large_start_hid_come_back(monkeypatch):
    restarted = []
    monkeypatch.setattr(SurfaceUpkeep, "restart", lambda self: restarted.append(1))
    places = (cell().vertices_numpy() - MIDDLE) * 1.35
    rough = places + np.random.default_rng(1).normal(0, 0.08, places.shape)  # it is remeshed
    rough *= np.linalg.norm(places, axis=1, keepdims=True) / np.linalg.norm(
        rough, axis=1, keepdims=True
    )
    start = cell().with_vertices(MIDDLE + rough)
    settings = FitSettings(structure="auto", levels=(1.0,), fit_psf=True)
    states = list(nd.fit(image_of(Light(1.0, 3.0)), GRID, start, OPTICS, settings=settings))
    last = states[-1]
    assert sum("surfaces further in" in state.message for state in states) == 1
    assert restarted == [1]
    assert structure_of(last.light) == "both"
    assert abs(last.mesh.region_volume(1) / cell().region_volume(1) - 1) < 0.03


@pytest.mark.slow
def test_a_change_on_trial_is_judged_before_what_shines_is_asked(monkeypatch):
    """By another light, it would be undone, and the old light with it."""
    order, asked, judged = [], model_choice.ModelChoice.asked_anew, SurfaceUpkeep.judged
    monkeypatch.setattr(
        model_choice.ModelChoice, "asked_anew", lambda *a: (order.append("asked"), asked(*a))[1]
    )
    monkeypatch.setattr(SurfaceUpkeep, "judged", lambda *a: (order.append("judged"), judged(*a))[1])
    fitted(image_of(INSIDES), structure="auto", levels=(1.0,))
    assert order[:2] == ["judged", "asked"]


@pytest.mark.parametrize(
    ("inside", "larger"),
    [
        pytest.param(0.8, 1.4, marks=pytest.mark.slow),
        (1.0, 1.4),
        pytest.param(2.0, 1.35, marks=pytest.mark.slow),
    ],
)
def test_membranes_come_back_where_both_are_asked_for(inside, larger):
    """Starts from which a fit of both ends with insides alone, half as large again as the cell."""
    start = cell().with_vertices(MIDDLE + (cell().vertices_numpy() - MIDDLE) * larger)
    settings = FitSettings(structure="both", levels=(1.0,), fit_psf=True)
    *_, last = nd.fit(image_of(Light(1.0, inside)), GRID, start, OPTICS, settings=settings)
    assert last.light.interior == pytest.approx(inside, rel=0.1)
    assert abs(last.mesh.region_volume(1) / cell().region_volume(1) - 1) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    ("light", "name"), [(Light(1.0, 2.0), "both"), (MEMBRANES, "membrane"), (INSIDES, "interior")]
)
def test_insides_come_back_where_cells_began_too_small_to_show_them(light, name):
    """A start inside the cell, in which membranes and insides look alike."""
    start = sphere(MIDDLE, 0.6, edge_length=0.15)
    *_, last = nd.fit(image_of(light), GRID, start, OPTICS, settings=FitSettings(fit_psf=True))
    assert structure_of(last.light) == name
    assert abs(last.mesh.region_volume(1) / cell().region_volume(1) - 1) < 0.03


def test_small_cells_in_a_haze_stay_what_they_began_as():
    """Blurred levels find them twice as large, and an inside would take the haze."""
    width = float(np.prod(OPTICS.sigma_um)) ** (1 / 3)
    small = sphere(MIDDLE, 2.4 * width, edge_length=0.15)
    clean = nd.scene.expected_image(small, GRID, OPTICS, 1e-4, 1.0, 0.0)
    places = np.moveaxis(np.indices(GRID.shape), 0, -1) * 0.2
    haze = np.exp(-0.5 * ((places - MIDDLE - [0, 0, 0.3]) ** 2).sum(-1) / 1.2**2)
    clean = 60 * (clean - min(clean.min(), 0)) / np.ptp(clean)
    image = np.random.default_rng(4).poisson(8.0 + clean + 25 * haze).astype(np.float32)
    start = sphere(MIDDLE, 2.45 * width, edge_length=0.15)
    *_, last = nd.fit(image, GRID, start, OPTICS, settings=FitSettings())
    assert structure_of(last.light) == "membrane"
    assert abs(last.mesh.region_volume(1) / small.region_volume(1) - 1) < 0.15


@pytest.mark.parametrize(
    ("over", "beneath", "believed"), [(9.0, 1.0, False), (3.0, 1.0, True), (1.0, 1.6, False)]
)
def test_a_membrane_that_is_drowned_or_follows_chromatin_is_not_believed(
    monkeypatch, over, beneath, believed
):
    """Nor where insides are even; over : brightness of the inside, of the membrane's peak.

    beneath : how uneven insides are once membranes are even. In flat cells, membranes of any
    brightness explain all of it, and their own objective is left with none.
    """
    begun = fitted(image_of(INSIDES), max_iterations=1)
    peak = 1 / (np.sqrt(2 * np.pi) * np.prod(OPTICS.sigma_um) ** (1 / 3))
    objective = SimpleNamespace(
        structure=lambda: structure_choice.Chosen("both", False, outshone=True),
        dark_insides_denied=lambda: False,
        unevenness=lambda: 1.0,
        insides_vary=lambda: (0.0, np.inf),
        fitted=begun,
        now=SimpleNamespace(light=Light(1.0, over * peak)),
    )
    even = SimpleNamespace(**{**vars(objective), "unevenness": lambda: beneath})
    alone = object()
    monkeypatch.setattr(model_choice, "with_even_membranes", lambda *_: (even, 5))
    monkeypatch.setattr(model_choice, "without_rim", lambda *_: (alone, 7))
    found, taken = model_choice.ModelChoice._at_rest(None, objective, begun, None)
    assert (found, taken) == ((begun, 5) if believed else (alone, 12))


def test_membranes_are_denied_where_insides_alone_explain_more_once_they_are_even(monkeypatch):
    """Else two errors of what is measured are enough where membranes are clear."""
    gain = np.full(40, 10.0)
    both = SimpleNamespace(
        now=SimpleNamespace(light=Light(1.0, 0.1)),
        fitted=SimpleNamespace(optics=OPTICS),
        leaves_over=lambda alone: 0.99,
        insides_vary=lambda: (0.0, np.inf),
        terms=SimpleNamespace(settings=FitSettings()),
    )
    assert rival_structures.both_beat_insides(both, both, [0 * gain, gain])
    assert not rival_structures.both_beat_insides(both, both, [-gain, gain])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("light", "name"),
    [(INSIDES, "interior"), (MEMBRANES, "membrane")],
)
def test_small_cells_that_began_too_small_are_what_they_are(light, name):
    """A membrane at 0.77 of the radius spreads its light as an inside does."""
    grid, radius = nd.Grid((24, 34, 34), (0.2, 0.2, 0.2)), 1.05
    centres = [(2.3, y, x) for y in (1.8, 4.8) for x in (1.8, 4.8)]
    truth, start = (
        nd.Mesh.merge([sphere(c, r, edge_length=0.25) for c in centres])
        for r in (radius, 0.74 * radius)
    )
    shown = nd.scene.expected_image(truth, grid, OPTICS, 1e-3, 1.0, 0.0, light=light)
    image = np.random.default_rng(4).poisson(60 * shown / shown.max() + 8.0).astype(np.float32)
    wide = nd.GaussianPSF((0.39, 0.31, 0.31))
    *_, last = nd.fit(
        image, grid, start, wide, settings=FitSettings(structure="auto", fit_psf=True)
    )
    assert structure_of(last.light) == name
    for region, volume in truth.volumes().items():
        assert last.mesh.region_volume(region) == pytest.approx(volume, rel=0.05)


@pytest.mark.parametrize("guessed", [True, False])
def test_small_nuclei_are_no_membranes_through_a_wider_psf(guessed):
    """From seeds at 0.75 of its radius a nucleus looks like a membrane through a wider PSF."""
    grid, radius = nd.Grid((14, 26, 26), (0.4, 0.2, 0.2)), 1.0
    middle = np.array([2.6, 2.5, 2.5])
    truth, start = (sphere(middle, r, edge_length=0.25) for r in (radius, 0.75 * radius))
    narrow, guess = nd.GaussianPSF((0.31, 0.18, 0.18)), nd.GaussianPSF((0.41, 0.26, 0.26))
    shown = nd.scene.expected_image(truth, grid, narrow, 1e-3, 1.0, 0.0, light=INSIDES)
    image = np.random.default_rng(4).poisson(200 * shown / shown.max() + 2.0).astype(np.float32)
    *_, last = nd.fit(image, grid, start, guess, settings=FitSettings(), psf_guessed=guessed)
    assert structure_of(last.light) == ("interior" if guessed else "membrane")
    assert last.unsure == guessed
    assert (abs(last.mesh.region_volume(1) / truth.region_volume(1) - 1) < 0.1) == guessed
