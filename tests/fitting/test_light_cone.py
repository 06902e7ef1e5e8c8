"""A fit whose image shows the cone of light of an objective goes on with such a PSF."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.common.doing import listening
from napari_deltamic.evidence.facts import CellFacts, Facts
from napari_deltamic.evidence.predicted_error import predicted_error
from napari_deltamic.evidence.verdict import judged
from napari_deltamic.fitting.job import FitInput, following, optics_of
from napari_deltamic.fitting.rivals import light_cone
from napari_deltamic.fitting.rivals.light_cone import (
    ABERRATED,
    ANEW,
    GOES_ON,
    confocal_of,
    objective_instead,
    spherical_of,
    widefield_of,
)
from napari_deltamic.fitting.rivals.rival_structures import RULES as RIVALS
from napari_deltamic.fitting.rivals.rival_structures import descend_and_pose_anew, stepped
from napari_deltamic.fitting.successor import BACK, NARROW, is_given_up, successor
from napari_deltamic.fitting.surface.topology_trials import TopologyTrials
from napari_deltamic.geometry import sphere
from napari_deltamic.measure.surface_distance import distance_to_surface
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings

SIZE, SHAPE = (0.2, 0.1, 0.1), (22, 32, 32)
ABOUT = (0.3, 0.11, 0.11)  # um; widths of the PSF of NA 1.2 in water at 0.6 um
TRUE = sphere((2.1, 1.55, 1.55), 0.95, edge_length=0.13)
START = sphere((2.1, 1.55, 1.55), 0.85, edge_length=0.28)
GRID = nd.Grid(SHAPE, SIZE)
OBJECTIVE, GAUSSIAN = nd.ScalarPSF(1.2, 0.6, 1.33), nd.GaussianPSF(ABOUT)
CONFOCAL = nd.ConfocalPSF(nd.ScalarPSF(1.2, 0.6, 1.33), 0.6)


@cache
def image_through(optics):
    clean = nd.render(TRUE, GRID, optics).numpy()
    drawn = np.random.default_rng(0).poisson(5 + 100 * clean / clean.max())
    return drawn.astype(np.float32)


def begun(optics, fit_psf=True, **further):
    """A fit of a cell seen through some PSF, as a Gaussian that may change."""
    settings = FitSettings(fit_psf=fit_psf, structure="auto")
    return nd.fit(image_through(optics), GRID, START, GAUSSIAN, settings=settings, **further)


@cache
def states_of(optics):
    return list(begun(optics))


def off(state):
    """um, root mean square over the true surface."""
    away = distance_to_surface(TRUE.vertices_numpy(), state.mesh)
    return float(np.sqrt((np.asarray(away) ** 2).mean()))


@pytest.mark.parametrize(("optics", "told"), [(OBJECTIVE, ANEW), (CONFOCAL, GOES_ON)])
@pytest.mark.slow
def test_a_fit_goes_on_with_the_psf_of_an_objective(optics, told):
    states = states_of(optics)
    kinds = [type(state.optics) for state in states]
    first = kinds.index(type(optics))
    assert set(kinds[:first]) == {nd.GaussianPSF}
    assert set(kinds[first:]) == {type(optics)}
    assert [told in state.message for state in states].index(True) == first - 1
    assert [state.iteration for state in states] == list(range(1, len(states) + 1))
    assert (states[first].level < states[first - 1].level) == (told == ANEW)
    assert [state.converged for state in states] == [False] * (len(states) - 1) + [True]
    assert not states[-1].cone
    found = {p.name: p.value for p in states[-1].optics.described()}
    assert found["na"] == pytest.approx(1.2, rel=0.05)
    assert found["wavelength"] == pytest.approx(0.6, rel=0.05)
    assert states[-1].optics.sigma_um == pytest.approx(optics.sigma_um, rel=0.03)
    before = off(states[first - 1])
    # A confocal cone is fainter, and a Gaussian is less wrong without it: a tenth of a voxel.
    assert off(states[-1]) < (0.5 * before if told == ANEW else min(0.0095, before))


def test_a_fit_that_was_remeshed_goes_on():
    # Growth of the surface is told from faces, which are others by then.
    image, settings = image_through(CONFOCAL), FitSettings(flatness=0.0005, levels=(1.0,))
    states = list(nd.fit(image, GRID, START, GAUSSIAN, settings=settings))
    assert any(GOES_ON in state.message for state in states)
    faces = [len(state.mesh.faces) for state in states]
    assert faces[-1] > 1.5 * faces[0]
    assert states[-1].converged


@pytest.mark.slow
def test_a_gaussian_stays():
    states = states_of(GAUSSIAN)
    assert {type(state.optics) for state in states} == {nd.GaussianPSF}
    assert not states[-1].cone


@pytest.mark.slow
def test_a_psf_that_is_held_is_not_asked():
    *_, state = begun(OBJECTIVE, fit_psf=False)
    assert isinstance(state.optics, nd.GaussianPSF)
    assert not state.cone


@pytest.mark.slow
def test_a_gaussian_narrower_than_voxels_tell_stays(monkeypatch):
    asked = []

    def narrow(sigma_um, voxel_size):
        asked.append((sigma_um, voxel_size))
        return True

    for module in ("light_cone", "psf_tails"):
        monkeypatch.setattr(f"napari_deltamic.fitting.rivals.{module}.narrower_than_told", narrow)
    *_, state = begun(OBJECTIVE)
    assert isinstance(state.optics, nd.GaussianPSF)
    assert not state.cone
    sigma_um, voxel_size = asked[0]
    assert sigma_um == pytest.approx(state.optics.sigma_um, rel=1e-6)
    assert tuple(voxel_size) == SIZE


@pytest.mark.slow
def test_the_default_width_of_tall_voxels_asks_nothing(monkeypatch):
    # 1.2 voxels of 4 to 1 are as long as the PSF of an objective, and nobody has told them.
    tall = nd.Grid((12, 32, 32), (0.4, 0.1, 0.1))
    image = nd.render(TRUE, tall, nd.GaussianPSF((0.2, 0.12, 0.12))).numpy()
    asked = []
    monkeypatch.setattr(
        "napari_deltamic.fitting.rivals.light_cone._posed", lambda *a: asked.append(a)
    )
    start = nd.GaussianPSF([1.2 * d for d in tall.voxel_size])
    *_, state = nd.fit(image, tall, START, start, settings=FitSettings())
    assert state.optics.sigma_um[0] < 2.6 * state.optics.sigma_um[1]
    assert not asked


def test_a_rival_that_does_not_move_is_left():
    posed = []

    class Stuck:
        def __init__(self):
            posed.append(self)

        def anew(self):
            return Stuck()

        def step(self):
            return False

        def strayed(self):
            return False

        def evaluations(self):
            return 1

    *_, taken = stepped(Stuck())
    assert (taken, len(posed)) == (1, 1)  # not posed anew


@pytest.mark.slow
def test_what_a_user_has_changed_is_not_begun_anew():
    states = begun(OBJECTIVE)
    first = next(states)
    pinned = np.zeros(len(first.mesh.vertices), bool)
    pinned[0] = True
    last = states.send(nd.Change(pinned=pinned))
    for last in states:  # noqa: B007
        pass
    assert isinstance(last.optics, nd.GaussianPSF)
    assert last.converged
    assert last.cone
    settings = RunSettings(image="", seeds="", scene=SceneSettings(voxel_size=SIZE, sigma=ABOUT))
    given = settings, image_through(OBJECTIVE), GRID, START, GAUSSIAN, None
    assert predicted_error(FitInput(*given), last).cone


@pytest.mark.slow
@pytest.mark.parametrize("optics", [OBJECTIVE, CONFOCAL])
def test_a_checkpoint_goes_on_with_the_psf_that_was_found(tmp_path, optics):
    states = states_of(optics)
    first = [type(state.optics) for state in states].index(type(optics))
    kept = tmp_path / "state.npz"
    states[first + 20].save(kept)
    *_, resumed = begun(optics, resume=kept)
    assert type(resumed.optics) is type(optics)
    assert resumed.iteration == states[-1].iteration
    np.testing.assert_allclose(
        resumed.mesh.vertices_numpy(), states[-1].mesh.vertices_numpy(), atol=1e-6
    )


@pytest.fixture
def always_tried(monkeypatch):
    """The PSF of an objective is tried at the end of every fit; returns how often it was."""
    asked = []

    def tried(terms, fitted, image, left):
        asked.append(fitted.optics)
        return widefield_of(ABOUT), 1

    monkeypatch.setattr("napari_deltamic.fitting.successor.objective_instead", tried)
    return asked


@pytest.mark.slow
def test_a_fit_goes_back_where_the_psf_of_an_objective_explains_less(always_tried, monkeypatch):
    contacts_tried, tried = [], TopologyTrials.tried

    def noted(self, fitted, *given):
        contacts_tried.append(type(fitted.optics))
        return tried(self, fitted, *given)

    monkeypatch.setattr(TopologyTrials, "tried", noted)
    states = list(begun(GAUSSIAN))
    # It goes back as soon as it rests.
    assert set(contacts_tried) == {nd.GaussianPSF}
    told = [ANEW in state.message for state in states].index(True)
    back = [BACK in state.message for state in states].index(True)
    kinds = [type(state.optics) for state in states]
    assert set(kinds[told + 1 : back + 1]) == {nd.ScalarPSF}
    assert set(kinds[: told + 1] + kinds[back + 1 :]) == {nd.GaussianPSF}
    assert [state.iteration for state in states] == list(range(1, len(states) + 1))
    assert [state.converged for state in states] == [False] * (len(states) - 1) + [True]
    assert len(always_tried) == 1
    assert not states[-1].cone
    assert off(states[-1]) < 1.1 * off(states[told])


def resting(optics, left=1.0, edited=False, answered=False):
    """A run at rest that leaves so much, over what another does."""
    posed = SimpleNamespace(left_by=lambda image: (1.0, 0.0))
    objective = SimpleNamespace(
        left=left, posed=posed, leaves_of_measured=lambda other: left / other.left
    )
    return SimpleNamespace(
        stage=SimpleNamespace(edited=edited, progress=SimpleNamespace(answered=answered), tried=4),
        fitted=SimpleNamespace(optics=optics),
        objective=objective,
        terms=SimpleNamespace(level=SimpleNamespace(grid=GRID)),
        begun=None,
        problem=SimpleNamespace(anew=None, foreign=None, local_background=None),
        posed_here=lambda: objective,
    )


@pytest.mark.parametrize(
    ("run", "given_up"),
    [
        (resting(OBJECTIVE, left=1.5), True),
        (resting(OBJECTIVE, left=1.05), False),  # what is tried at rest may still win
        (resting(OBJECTIVE, left=0.7), False),
        (resting(nd.GaussianPSF((0.3, 0.05, 0.05)), left=0.7), True),  # narrower than voxels tell
        (resting(OBJECTIVE, left=1.5, edited=True), False),
        (resting(OBJECTIVE, left=1.5, answered=True), False),
    ],
)
def test_a_psf_that_explains_much_less_is_given_up_at_rest(run, given_up):
    former = resting(GAUSSIAN)
    assert is_given_up(run, former) == given_up
    assert not is_given_up(run, None)


def test_a_psf_narrower_than_voxels_tell_is_not_kept():
    """Whatever it explains: it stands in for something else."""
    former = resting(GAUSSIAN)
    former.come_back = lambda stage, tried: None
    for width, kept in ((0.1, True), (0.05, False)):
        said = []
        run = resting(
            nd.GaussianMixturePSF([(0.3, width, width), (0.9, width, width)], (1, 1)), 0.5
        )
        run.let_former_go, run.say = lambda: former, said.append
        assert successor(run, True) == (None if kept else former, False)
        assert said == ([] if kept else [NARROW])


def test_of_two_psfs_narrower_than_voxels_tell_the_one_that_explains_more_is_kept():
    former = resting(nd.GaussianPSF((0.3, 0.05, 0.05)))
    former.come_back = lambda stage, tried: None
    for left, kept in ((0.8, True), (1.2, False)):
        run = resting(nd.GaussianMixturePSF([(0.3, 0.07, 0.07), (0.9, 0.07, 0.07)], (1, 1)), left)
        assert is_given_up(run, former) != kept
        run.let_former_go, run.say = lambda: former, lambda remark: None
        assert successor(run, True) == (None if kept else former, False)


def after_steps(
    monkeypatch,
    confocal,
    widefield,
    spherical=0.0,
    widefield_at_first=0.99,
    wavelength=0.6,
    grid=GRID,
):
    """What is found where the confocal PSF leaves 0.95 at first, and so much after the steps."""

    def posed(optics, left):
        run = resting(optics, left)
        return SimpleNamespace(fitted=run.fitted, left=left, posed=run.objective.posed)

    end = nd.ConfocalPSF(
        nd.ScalarPSF(1.2, wavelength, 1.33, spherical=spherical), wavelength - 0.04
    )
    of_widefield = nd.ScalarPSF(1.2, 0.6, 1.33, spherical=spherical)
    ends = {nd.ConfocalPSF: (end, confocal), nd.ScalarPSF: (of_widefield, widefield)}
    at_first = {nd.ConfocalPSF: 0.95, nd.ScalarPSF: widefield_at_first}
    module = "napari_deltamic.fitting.rivals.light_cone"
    monkeypatch.setattr(
        f"{module}._posed", lambda optics, *_: posed(optics, at_first[type(optics)])
    )

    def stepped(rival, hopeless):
        hopeless(rival)
        return posed(*ends[type(rival.fitted.optics)]), 7

    monkeypatch.setattr(f"{module}.stepped", stepped)
    fitted = SimpleNamespace(
        optics=GAUSSIAN,
        first_optics=GAUSSIAN,
        seen_through=lambda optics: SimpleNamespace(first_optics=optics, first_effects=None),
    )
    terms = SimpleNamespace(settings=FitSettings(), second=None, level=SimpleNamespace(grid=grid))
    return (terms, fitted), objective_instead(terms, fitted, None)


@pytest.mark.parametrize(("pixel", "followed"), [(0.14, True), (0.16, False)])
def test_an_objective_that_begins_narrower_than_voxels_tell_is_not_followed(
    monkeypatch, pixel, followed
):
    """A Gaussian of 0.69 voxel can be told, a confocal PSF beside it cannot."""
    grid = nd.Grid(SHAPE, (0.2, pixel, pixel))
    _, (found, taken) = after_steps(monkeypatch, 0.8, 1.1, grid=grid)
    assert (taken > 0, found is not None) == (followed, followed)


def test_an_objective_that_has_become_narrower_than_voxels_tell_is_not_followed(monkeypatch):
    for wavelength, found in ((0.6, True), (0.25, False)):
        _, (optics, _) = after_steps(monkeypatch, 0.8, 1.1, wavelength=wavelength)
        assert (optics is not None) == found


def test_one_that_explains_less_than_what_is_too_narrow_is_not_followed_either(monkeypatch):
    narrow = {"wavelength": 0.25}  # of the confocal one alone
    assert after_steps(monkeypatch, 0.9, 0.8, **narrow)[1][0] is not None
    assert after_steps(monkeypatch, 0.7, 0.8, **narrow)[1][0] is None


@pytest.mark.parametrize(
    ("confocal", "widefield", "at_first", "expected"),
    [
        (0.8, 0.9, 0.99, confocal_of(GAUSSIAN.sigma_um)),
        (0.8, 1.1, 0.99, confocal_of(GAUSSIAN.sigma_um)),
        (0.9, 0.8, 0.99, widefield_of(GAUSSIAN.sigma_um)),
        (1.1, 0.8, 0.99, widefield_of(GAUSSIAN.sigma_um)),
        (1.1, 1.1, 0.99, None),
        (0.9, 0.8, 2.5, confocal_of(GAUSSIAN.sigma_um)),  # that one was far off
        (1.1, 0.8, 2.5, None),
        # The widefield one leads.
        (0.8, 0.9, 0.9, widefield_of(GAUSSIAN.sigma_um)),
        (0.8, 1.1, 0.9, confocal_of(GAUSSIAN.sigma_um)),
        (1.1, 1.1, 0.9, None),
    ],
)
def test_the_objective_that_leaves_least_after_a_few_steps_is_found(
    monkeypatch, confocal, widefield, at_first, expected
):
    _, (found, taken) = after_steps(monkeypatch, confocal, widefield, widefield_at_first=at_first)
    only_one = at_first > 2 or (at_first < 0.95 and widefield < 1)
    assert taken == (7 if only_one else 14)
    if expected is None:
        assert found is None
        return
    # As it was before the steps.
    assert type(found) is type(expected)
    assert found.described() == expected.described()


@pytest.mark.parametrize(
    ("left", "legs"),
    [
        ([1.7, 1.004, 0.7], 2),  # it gains what it lacks
        ([1.7, 1.4, 1.2, 1.1, 0.9], 1),  # it would not, if it gained as much again
        ([1.7, 0.9, 0.7], 1),  # it is enough
        ([4.0, 2.4, 1.6, 1.2, 0.9], 3),  # no further
    ],
)
def test_an_objective_is_followed_while_it_may_do(monkeypatch, left, legs):
    at = iter(left)

    class Rival:
        posed = SimpleNamespace(left_by=lambda image: (1.0, 0.0))

        def __init__(self):
            self.left = next(at)

        def anew(self):
            return self

    def stepped(rival, hopeless):
        hopeless(rival)
        return Rival(), 7

    monkeypatch.setattr(light_cone, "stepped", stepped)
    rival, taken = light_cone._followed(Rival(), None, 1.0)
    assert (rival.left, taken) == (left[legs], 7 * legs)


@pytest.mark.parametrize("spherical", [0.05, 0.2, -0.6])
def test_a_widefield_fit_begins_with_the_aberration_that_steps_find(monkeypatch, spherical):
    _, (found, _) = after_steps(monkeypatch, 0.9, 0.8, spherical)
    aberrated = abs(spherical) > 0.1
    assert ("spherical" in found.fitted) == aberrated
    assert spherical_of(found) == pytest.approx(spherical if aberrated else 0.0)


@pytest.mark.parametrize(
    ("spherical", "anew"), [(0.6, True), (-0.6, True), (0.2, False), (0.05, False)]
)
def test_a_confocal_fit_begins_anew_where_it_is_much_aberrated(monkeypatch, spherical, anew):
    (terms, fitted), (found, _) = after_steps(monkeypatch, 0.9, 1.1, spherical)
    assert spherical_of(found) == pytest.approx(spherical if anew else 0.0)
    assert ("spherical" in found.fitted) == (abs(spherical) > 0.1)
    went_on = []
    run = SimpleNamespace(
        let_former_go=lambda: None,
        stage=SimpleNamespace(edited=False, tried=1),
        begun=None,
        problem=SimpleNamespace(anew=None, foreign=None),
        terms=terms,
        fitted=fitted,
        objective=SimpleNamespace(now=SimpleNamespace(rendered=None)),
        spend=lambda evaluations: None,
        say=went_on.append,
        checkpoint=lambda: SimpleNamespace(saved=dict, policy="what was tried"),
        again=lambda optics, former=None, effects=None: SimpleNamespace(
            go_on_from=lambda kept: None,
            go_on_at=lambda *given: went_on.append(given),
        ),
    )
    successor(run, True)
    if anew:
        assert went_on == [ABERRATED]
        return
    told, (at, all_shines, policy) = went_on
    assert (told, all_shines, policy) == (GOES_ON, True, "what was tried")
    assert at.first_optics.fitted == found.fitted
    assert at.first_optics.values == found.values


ABERRATED_PSF = nd.ConfocalPSF(nd.ScalarPSF(1.2, 0.6, 1.33, spherical=0.6), 0.56)


@pytest.mark.slow
def test_a_cell_below_a_coverslip_is_found():
    states = states_of(ABERRATED_PSF)
    assert any(ABERRATED in state.message for state in states)
    found = states[-1].optics
    assert isinstance(found, nd.ConfocalPSF)
    assert spherical_of(found) == pytest.approx(0.6, abs=0.15)
    first = [type(state.optics) for state in states].index(nd.ConfocalPSF)
    assert off(states[-1]) < 0.5 * off(states[first - 1])


@pytest.mark.slow
def test_a_checkpoint_goes_on_with_an_aberrated_psf(tmp_path):
    states = states_of(ABERRATED_PSF)
    first = [type(state.optics) for state in states].index(nd.ConfocalPSF)
    states[first + 5].save(tmp_path / "state.npz")
    *_, resumed = begun(ABERRATED_PSF, resume=tmp_path / "state.npz")
    assert resumed.iteration == states[-1].iteration
    assert spherical_of(resumed.optics) == pytest.approx(spherical_of(states[-1].optics), abs=1e-6)
    np.testing.assert_allclose(
        resumed.mesh.vertices_numpy(), states[-1].mesh.vertices_numpy(), atol=1e-6
    )


@pytest.mark.slow
def test_a_widefield_cell_below_a_coverslip_is_found():
    states = states_of(nd.ScalarPSF(1.2, 0.6, 1.33, spherical=0.6))
    first = [type(state.optics) for state in states].index(nd.ScalarPSF)
    assert spherical_of(states[first].optics) > 0.3
    assert spherical_of(states[-1].optics) == pytest.approx(0.6, abs=0.1)
    assert off(states[-1]) < 0.5 * off(states[first - 1])


def test_a_psf_saved_with_fewer_values_is_another(tmp_path):
    given = image_through(CONFOCAL), GRID, START, CONFOCAL
    settings = FitSettings(max_iterations=3, structure="membrane")
    next(nd.fit(*given, settings=settings)).save(tmp_path / "state.npz")
    kept = dict(np.load(tmp_path / "state.npz"))
    run = json.loads(str(kept["run"]))
    del run["objective"]["spherical"]
    kept["run"] = np.array(json.dumps(run))
    np.savez(tmp_path / "less.npz", **kept)
    with pytest.raises(nd.InputError, match="belongs to a fit with other settings"):
        nd.fit(*given, settings=settings, resume=tmp_path / "less.npz")


@pytest.mark.slow
@pytest.mark.parametrize("of", [ANEW, BACK])
def test_a_fit_that_goes_back_can_be_resumed(tmp_path, always_tried, of):
    states = list(begun(GAUSSIAN))
    at = [of in state.message for state in states].index(True)
    states[at + 2].save(tmp_path / "state.npz")
    *_, resumed = begun(GAUSSIAN, resume=tmp_path / "state.npz")
    assert len(always_tried) == 1
    assert resumed.iteration == states[-1].iteration
    assert resumed.optics.sigma_um == pytest.approx(states[-1].optics.sigma_um, rel=1e-6)
    np.testing.assert_allclose(
        resumed.mesh.vertices_numpy(), states[-1].mesh.vertices_numpy(), atol=1e-6
    )


@pytest.mark.parametrize("optics", [OBJECTIVE, CONFOCAL])
def test_settings_of_the_job_follow(optics):
    settings = RunSettings(image="", seeds="", scene=SceneSettings(voxel_size=SIZE, sigma=ABOUT))
    job = FitInput(settings, image_through(optics), GRID, START, GAUSSIAN, None)
    first = next(begun(optics))
    assert following(job, first) is job
    made = widefield_of(ABOUT) if optics is OBJECTIVE else confocal_of(ABOUT)
    later = replace(first, optics=made)
    found = following(job, later)
    assert found.optics is made
    assert following(found, later) is found
    again = optics_of(RunSettings.model_validate(found.settings.model_dump()).scene)
    assert type(again) is type(optics)
    assert again.fitted == made.fitted
    assert again.parameters().tolist() == pytest.approx(made.parameters().tolist())


def test_a_fit_through_the_wrong_kind_of_psf_is_fair():
    cells = (CellFacts(1, 0.9),)
    facts = Facts(finished=True, explained=0.9, cells=cells)
    assert judged(facts).grade == "good"
    found = judged(Facts(True, 0.9, cells=cells, error=type(facts.error)(cone=True)))
    assert found.grade == "fair"
    assert "--modality" in found.sentence()
    assert found.as_plain()["error"]["cone"]


@pytest.mark.parametrize("aperture", [0.5, 0.9, 1.2])
def test_the_objective_is_about_as_wide(aperture):
    # Widths by the formulas that the module names, so that only their inverse is tested here.
    across = 0.22 * 0.5 / aperture
    along = 0.88 * 0.5 / (1.33 - np.sqrt(1.33**2 - aperture**2)) / 2.3548
    for made in (widefield_of, confocal_of):
        found = {p.name: p.value for p in made((along, across, across)).described()}
        assert found["na"] == pytest.approx(aperture, rel=1e-9)
        assert found["wavelength"] == pytest.approx(0.5, rel=1e-9)


def test_no_wavelength_is_longer_than_that_of_light():
    found = {p.name: p.value for p in widefield_of((30, 10, 10)).described()}
    assert found["wavelength"] == 2.0


def test_a_rival_is_dropped_before_it_is_posed_anew():
    posed, looks, heard = [], [], []

    class Slow:
        def __init__(self):
            posed.append(self)

        def anew(self):
            return Slow()

        def step(self):
            return True

        def strayed(self):
            return False

        def evaluations(self):
            return 6

    def hopeless(objective):
        looks.append(objective)
        return len(looks) > 1

    objective, taken = stepped(Slow(), hopeless)
    assert (objective, looks) == (posed[0], [posed[0], posed[0]])
    assert (taken, len(posed)) == (6, 1)
    with listening(heard.append):
        objective, taken = descend_and_pose_anew(Slow())  # to the end, where it is posed anew
    assert heard == ["comparing models"] * RIVALS.steps
    assert (objective, taken, len(posed)) == (posed[-1], 18, 4)


@pytest.mark.parametrize(
    ("ratio", "structure", "said", "first", "begins"),
    [
        ((1.9, 1.0), "interior", "auto", 0.5, True),
        ((1.7, 1.0), "interior", "auto", 0.5, False),
        ((1.9, 0.9), "interior", "auto", 0.5, False),
        ((1.9, 1.0), "both", "auto", 0.5, False),
        ((1.9, 1.0), "interior", "interior", 0.5, False),
        ((1.9, 1.0), "interior", "auto", None, False),
    ],
)
def test_insides_behind_a_long_gaussian_begin_anew_in_a_light_cone(
    ratio, structure, said, first, begins
):
    """Not where the first width was no more than a default, or someone said what is labelled."""
    grid = nd.Grid((8, 8, 8), (0.3, 0.2, 0.2))
    sigma = (first, 0.3, 0.3) if first else (0.36, 0.24, 0.24)
    fitted = SimpleNamespace(
        optics=nd.GaussianPSF((ratio[0] * sigma[0], ratio[1] * sigma[1], ratio[1] * sigma[2])),
        first_optics=nd.GaussianPSF(sigma),
        structure=structure,
    )
    settings = FitSettings(structure=said)
    terms = SimpleNamespace(settings=settings, second=None, level=SimpleNamespace(grid=grid))
    found = light_cone.widefield_anew(terms, fitted)
    assert (found is not None) is begins
    if begins:
        assert isinstance(found, nd.ScalarPSF)
        assert found.fitted == ("na", "wavelength")
