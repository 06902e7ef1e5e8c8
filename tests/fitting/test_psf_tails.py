"""A fit whose image shows long tails of the PSF along Z goes on with two Gaussians."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting import model_choice
from napari_deltamic.fitting.job import FitInput, following, optics_of, scene_with
from napari_deltamic.fitting.model.imaging import Imaging
from napari_deltamic.fitting.objective.schedule import Schedule
from napari_deltamic.fitting.rivals import psf_tails
from napari_deltamic.fitting.rivals.found_psf import psf_from, values_of
from napari_deltamic.fitting.rivals.psf_tails import HAS_TAILS, RULES, core_and_tails, tails_instead
from napari_deltamic.fitting.successor import BACK, OWN_LIGHT, successor
from napari_deltamic.geometry import sphere
from napari_deltamic.measure.surface_distance import distance_to_surface
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects

SIZE, SHAPE = (0.2, 0.1, 0.1), (30, 32, 32)
TRUE = sphere((2.9, 1.55, 1.55), 0.95, edge_length=0.13)
START = sphere((2.9, 1.55, 1.55), 0.85, edge_length=0.28)
GRID = nd.Grid(SHAPE, SIZE)
TAILED = nd.GaussianMixturePSF([(0.2, 0.11, 0.11), (0.9, 0.11, 0.11)], (1.0, 1.5))
ABOUT = nd.GaussianPSF((0.35, 0.11, 0.11))


@cache
def image():
    clean = nd.render_scene(nd.Scene((nd.Solid(TRUE),), TAILED), GRID).numpy()
    drawn = np.random.default_rng(0).poisson(5 + 100 * clean / clean.max())
    return drawn.astype(np.float32)


def begun(optics=ABOUT, **further):
    settings = FitSettings(structure="interior")
    return nd.fit(image(), GRID, START, optics, settings=settings, **further)


@pytest.fixture(autouse=True)
def no_objective(monkeypatch):
    """As where no objective explains more: an aberrated one comes close to these tails."""
    monkeypatch.setattr(
        "napari_deltamic.fitting.successor.objective_instead", lambda *given: (None, 0)
    )


@cache
def states():
    return list(begun())


def off(state):
    """um, root mean square over the true surface."""
    away = distance_to_surface(TRUE.vertices_numpy(), state.mesh)
    return float(np.sqrt((np.asarray(away) ** 2).mean()))


def test_a_fit_goes_on_with_a_core_and_tails():
    told = [HAS_TAILS in state.message for state in states()].index(True)
    kinds = [type(state.optics) for state in states()]
    assert set(kinds[: told + 1]) == {nd.GaussianPSF}
    assert set(kinds[told + 1 :]) == {nd.GaussianMixturePSF}
    assert [state.iteration for state in states()] == list(range(1, len(kinds) + 1))
    assert [state.converged for state in states()] == [False] * (len(kinds) - 1) + [True]
    assert len(kinds) - told < Schedule().patience  # the patience of the level is over
    assert not states()[-1].cone
    assert off(states()[-1]) < 0.5 * off(states()[told])
    found, true = (
        {p.name: p.value for p in optics.described()} for optics in (states()[-1].optics, TAILED)
    )
    assert found == pytest.approx(true, rel=0.15)
    across = [found[name] for name in ("sigma1_y", "sigma1_x", "sigma2_y", "sigma2_x")]
    assert max(across) < 1.01 * min(across)


@pytest.mark.parametrize("own", [False, True])
def test_a_checkpoint_goes_on_with_a_core_and_tails(tmp_path, own):
    """Also with settings that hold the PSF as it was then, as a run that was ended writes them."""
    first = [type(state.optics) for state in states()].index(nd.GaussianMixturePSF)
    kept = states()[first + 5]
    kept.save(tmp_path / "state.npz")
    *_, resumed = begun(kept.optics if own else ABOUT, resume=tmp_path / "state.npz")
    assert isinstance(resumed.optics, nd.GaussianMixturePSF)
    assert resumed.iteration == states()[-1].iteration
    np.testing.assert_allclose(
        resumed.mesh.vertices_numpy(), states()[-1].mesh.vertices_numpy(), atol=1e-6
    )


@pytest.mark.slow
def test_a_fit_goes_back_where_tails_explain_less(monkeypatch):
    asked = []

    def tried(terms, fitted, image):
        asked.append(fitted.optics)
        z, y, x = fitted.optics.sigma_um
        far_off = nd.GaussianMixturePSF([(8 * z, 4 * y, 4 * x)] * 2, (1.0, 1.0), fitted=["mass2"])
        return fitted.seen_through(far_off), 1

    monkeypatch.setattr("napari_deltamic.fitting.successor.tails_instead", tried)
    there = "napari_deltamic.fitting.successor.local_background_instead"
    monkeypatch.setattr(there, lambda *given: (None, 0))  # of the tails that the image shows
    found = list(begun())
    messages = [state.message for state in found]
    assert any(BACK in message for message in messages)
    assert isinstance(found[-1].optics, nd.GaussianPSF)
    assert found[-1].converged
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("optics", "fit_psf", "second"),
    [
        (nd.GaussianPSF((0.35, 0.11, 0.11)), False, None),
        (nd.GaussianPSF((0.35, 0.11, 0.11)), True, object()),
        (nd.GaussianPSF((0.35, 0.05, 0.05)), True, None),  # narrower than voxels tell
        (TAILED, True, None),
        (nd.ScalarPSF(1.2, 0.6, 1.33), True, None),
    ],
)
def test_another_psf_is_not_asked_where_it_is_known(optics, fit_psf, second):
    fitted = SimpleNamespace(optics=optics, first_optics=optics)
    level = SimpleNamespace(grid=GRID)
    terms = SimpleNamespace(settings=FitSettings(fit_psf=fit_psf), second=second, level=level)
    assert tails_instead(terms, fitted, None) == (None, 0)


class Seen:
    """A fit through another PSF, and what it is after a few steps."""

    def __init__(self, optics):
        self.begun = optics

    @property
    def fitted(self):
        return self


@pytest.mark.parametrize(("left", "found"), [(0.99 * RULES.left, True), (1.01 * RULES.left, False)])
def test_tails_have_to_explain_much_more(monkeypatch, left, found):
    monkeypatch.setattr(psf_tails, "begun", lambda terms, fitted, factored: fitted)
    monkeypatch.setattr(psf_tails, "stepped", lambda rival, hopeless: (rival, 7))
    monkeypatch.setattr(psf_tails, "share_left", lambda rival, image: left)
    fitted = SimpleNamespace(optics=ABOUT, first_optics=ABOUT, seen_through=Seen)
    terms = SimpleNamespace(settings=FitSettings(), second=None, level=SimpleNamespace(grid=GRID))
    tailed, taken = tails_instead(terms, fitted, None)
    assert (tailed is not None, taken) == (found, 7)


@pytest.mark.parametrize(
    ("now", "across"),
    [
        ((1.0, 0.11, 0.11), 0.11),
        ((1.0, 0.05, 0.05), ABOUT.sigma_um[1]),  # as sharp as borders, in place of a haze
        ((0.05, 0.05, 0.05), None),  # along Z, too: nothing tells that there are tails
    ],
)
def test_tails_begin_as_wide_across_as_voxels_tell(monkeypatch, now, across):
    monkeypatch.setattr(psf_tails, "begun", lambda terms, fitted, factored: fitted)
    monkeypatch.setattr(psf_tails, "stepped", lambda rival, hopeless: (rival, 7))
    monkeypatch.setattr(psf_tails, "share_left", lambda rival, image: 0.5)
    fitted = SimpleNamespace(optics=nd.GaussianPSF(now), first_optics=ABOUT, seen_through=Seen)
    terms = SimpleNamespace(settings=FitSettings(), second=None, level=SimpleNamespace(grid=GRID))
    tailed, _ = tails_instead(terms, fitted, None)
    if across is None:
        assert tailed is None
        return
    values = tailed.begun.values
    widths = {name: float(value) for name, value in values.items() if name[-1] in "zyx"}
    assert [widths[f"sigma{n}_{a}"] for n in (1, 2) for a in "yx"] == pytest.approx([across] * 4)
    assert widths["sigma1_z"] == pytest.approx(RULES.core * now[0])


@pytest.mark.parametrize(
    ("shares", "stops"), [((1.2, 1.1), True), ((1.2, 1.0), False), ((0.95, 0.92), False)]
)
def test_steps_end_where_they_gain_too_little(monkeypatch, shares, stops):
    asked, left = [], iter(shares)

    def stepped(rival, hopeless):
        asked.extend([hopeless(rival), hopeless(rival)])
        return rival, 1

    monkeypatch.setattr(psf_tails, "begun", lambda terms, fitted, factored: fitted)
    monkeypatch.setattr(psf_tails, "stepped", stepped)
    monkeypatch.setattr(psf_tails, "share_left", lambda rival, image: next(left, 1.0))
    fitted = SimpleNamespace(optics=ABOUT, first_optics=ABOUT, seen_through=Seen)
    terms = SimpleNamespace(settings=FitSettings(), second=None, level=SimpleNamespace(grid=GRID))
    tails_instead(terms, fitted, None)
    assert asked == [False, stops]


def test_tails_are_asked_after_an_objective_and_each_once(monkeypatch):
    asked = []
    kinds = ["tilt_instead", "objective_instead", "tails_instead", "local_background_instead"]
    there = "napari_deltamic.fitting.successor"
    monkeypatch.setattr(f"{there}.widefield_anew", lambda terms, fitted: None)
    for name in kinds:
        nothing = (None, 1.0, 3) if name == "tilt_instead" else (None, 3)
        answer = lambda *given, name=name, nothing=nothing: asked.append(name) or nothing  # noqa: E731
        monkeypatch.setattr(f"{there}.{name}", answer)
    spent = []
    for tried, expected in [(0, 4), (1, 3), (2, 2), (3, 1), (4, 0)]:
        asked.clear()
        spent.clear()
        run = SimpleNamespace(
            let_former_go=lambda: None,
            stage=SimpleNamespace(edited=False, tried=tried),
            problem=SimpleNamespace(anew=None, foreign=None),
            begun=None,
            terms=None,
            fitted=SimpleNamespace(),
            objective=SimpleNamespace(now=SimpleNamespace(rendered=None)),
            spend=spent.append,
        )
        assert successor(run, True) == (None, False)
        assert asked == kinds[4 - expected :]
        assert spent == [3] * expected


def test_a_fit_with_tails_goes_on_where_the_steps_ended(monkeypatch):
    tailed = Seen(TAILED), 3
    nothing = {
        "tilt_instead": (None, 1.0, 3),
        "objective_instead": (None, 3),
        "widefield_anew": None,
    }
    answers = {**nothing, "tails_instead": tailed}
    for name, answer in answers.items():
        there = f"napari_deltamic.fitting.successor.{name}"
        monkeypatch.setattr(there, lambda *given, answer=answer: answer)
    monkeypatch.setattr(Seen, "first_optics", TAILED, raising=False)
    monkeypatch.setattr(Seen, "first_effects", Effects(), raising=False)
    went_on = []
    run = SimpleNamespace(
        let_former_go=lambda: None,
        stage=SimpleNamespace(edited=False, tried=0),
        begun=None,
        problem=SimpleNamespace(anew=None, foreign=None),
        terms=None,
        fitted=Seen(ABOUT),
        objective=SimpleNamespace(now=SimpleNamespace(rendered=None)),
        spend=lambda evaluations: None,
        say=went_on.append,
        checkpoint=lambda: SimpleNamespace(saved=dict, policy="what was tried"),
        again=lambda optics, former=None, effects=None: SimpleNamespace(
            go_on_from=lambda kept: None, go_on_at=lambda *given: went_on.append(given)
        ),
    )
    successor(run, True)
    assert went_on == [HAS_TAILS, (answers["tails_instead"][0], False, "what was tried")]


@pytest.mark.parametrize(("optics", "all_shines"), [(ABOUT, True), (TAILED, False)])
def test_which_voxels_count_is_asked_where_a_fit_with_tails_has_ended_too(
    monkeypatch, optics, all_shines
):
    there, went_on = "napari_deltamic.fitting.successor", []
    monkeypatch.setattr(f"{there}._back", lambda run, former: None)
    monkeypatch.setattr(f"{there}.ground_again", lambda problem, fitted: "more voxels")
    further = SimpleNamespace(go_on_at=lambda fitted, **how: went_on.append(how["all_shines"]))
    fitted = SimpleNamespace(optics=optics, first_optics=optics)
    fitted.seen_through = lambda optics: fitted
    run = SimpleNamespace(
        let_former_go=lambda: None if all_shines else "a Gaussian",
        stage=SimpleNamespace(edited=False, tried=0),
        begun=None,
        problem=SimpleNamespace(anew=None, local_background=None),
        fitted=fitted,
        again=lambda optics, problem: went_on.append(problem) or further,
        say=went_on.append,
        checkpoint=lambda: SimpleNamespace(policy=None),
    )
    assert successor(run, True) == (further, False)
    assert went_on == [OWN_LIGHT, "more voxels", all_shines]
    if not all_shines:
        monkeypatch.setattr(f"{there}.ground_again", lambda problem, fitted: None)
        monkeypatch.setattr(f"{there}._in_lit_surroundings", lambda run, plain: None)
        assert successor(run, True) == (None, False)  # no other PSF is tried after that


def test_a_run_that_was_edited_is_not_asked_for_tails(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "napari_deltamic.fitting.successor.tails_instead", lambda *given: asked.append(given)
    )
    run = SimpleNamespace(
        let_former_go=lambda: None,
        stage=SimpleNamespace(edited=True, tried=0),
        terms=None,
        fitted=SimpleNamespace(),
        objective=SimpleNamespace(now=SimpleNamespace(rendered=None)),
        spend=lambda evaluations: None,
    )
    assert successor(run, True) == (None, False)
    assert not asked


@pytest.mark.slow
def test_what_shines_is_held(monkeypatch):
    """Even where all may shine: in two nuclei, membranes took the credit of the tails.

    And once it was found at rest with one Gaussian, it is not asked again with two.
    """
    begun_with, own = [], psf_tails.begun
    asked, looked_for = [], model_choice.membranes_as_well

    def noted_again(terms, objective, *given):
        asked.append(type(objective.fitted.optics))
        return looked_for(terms, objective, *given)

    monkeypatch.setattr(model_choice, "membranes_as_well", noted_again)

    def noted(terms, fitted, factored):
        begun_with.append(fitted.structure)
        return own(terms, fitted, factored)

    monkeypatch.setattr(psf_tails, "begun", noted)
    found = list(nd.fit(image(), GRID, START, ABOUT, settings=FitSettings(structure="auto")))
    assert begun_with == ["interior"]
    first = [type(state.optics) for state in found].index(nd.GaussianMixturePSF)
    assert {state.light.membrane for state in found[first:]} == {0.0}
    assert asked == [nd.GaussianPSF]


def test_a_psf_that_was_found_is_kept_as_plain_values():
    again = psf_from(values_of(TAILED))
    assert again.described() == TAILED.described()
    held = nd.GaussianMixturePSF([0.1, 0.2, 0.3], (1, 2, 3), fitted=["mass2"])
    assert psf_from(values_of(held)).described() == held.described()
    assert values_of(ABOUT) is None


def test_settings_of_the_job_follow():
    settings = RunSettings(image="", seeds="", scene=SceneSettings(voxel_size=SIZE))
    job = FitInput(settings, image(), GRID, START, ABOUT, None)
    made = core_and_tails(ABOUT.sigma_um)
    found = following(job, replace(states()[0], optics=made))
    assert found.optics is made
    again = optics_of(RunSettings.model_validate(found.settings.model_dump()).scene)
    assert again.described() == made.described()
    # Also where the user had described a Gaussian.
    about = {"kind": "microscope", "na": 1.2, "wavelength": 0.5, "model": "gaussian"}
    for given in ({"kind": "gaussian", "sigma": (0.3, 0.1, 0.1)}, about):
        scene = SceneSettings(voxel_size=SIZE, optics=given)
        assert optics_of(scene_with(scene, made)).described() == made.described()


@pytest.mark.parametrize(
    ("optics", "pairs"),
    [
        (ABOUT, [(1, 2)]),
        (TAILED, [(1, 2), (4, 5), (1, 4)]),
        # Of another width across: as the user has it.
        (nd.GaussianMixturePSF([(0.2, 0.1, 0.1), (0.9, 0.2, 0.2)], (1, 1)), [(1, 2), (4, 5)]),
        # As a fit has left them.
        (
            nd.GaussianMixturePSF([(0.2, 0.1, 0.1), (0.9, 0.1001, 0.1)], (1, 1)),
            [(1, 2), (4, 5), (1, 4)],
        ),
        (nd.GaussianMixturePSF([0.1, 0.2], (1, 1), fitted=["sigma2_y", "sigma2_x"]), [(0, 1)]),
        (nd.ScalarPSF(1.2, 0.6, 1.33), []),
    ],
)
def test_widths_across_stay_alike(optics, pairs):
    start, effects = optics.parameters().numpy(), np.zeros(0)
    imaging = Imaging(optics, Effects(), optics, True, False)
    tied = []
    for i in range(len(start)):
        for j in range(i):
            moved = start.copy()
            moved[i], moved[j] = moved[i] + 0.1, moved[j] - 0.1
            if imaging.prior(moved, effects)[0] > 10:  # nats; 0.5 of a log width costs one
                tied.append((j, i))
    ties = {tuple(sorted(pair)) for pair in pairs}
    assert ties <= set(tied)
    together = start.copy()
    for i in {i for pair in pairs for i in pair}:
        together[i] += 0.1
    assert imaging.prior(together, effects)[0] < 1
