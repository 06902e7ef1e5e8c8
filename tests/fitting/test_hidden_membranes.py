"""Membranes that a fit has lost: how long both are followed, and from where."""

from dataclasses import is_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic import GaussianPSF
from napari_deltamic.fitting.level_run import LevelRun
from napari_deltamic.fitting.model.amplitudes import all_flat
from napari_deltamic.fitting.model.fitted import Fitted
from napari_deltamic.fitting.model.shape import Shape
from napari_deltamic.fitting.model_choice import ModelChoice
from napari_deltamic.fitting.objective.schedule import Progress
from napari_deltamic.fitting.rivals import hidden_membranes
from napari_deltamic.fitting.rivals.hidden_membranes import (
    _followed,
    _Trial,
    membranes_as_well,
)
from napari_deltamic.geometry import sphere
from napari_deltamic.measure.surface_distance import distance_to_surface
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.light import Light

MIDDLE = np.full(3, 2.3)

FEW = np.array([20.0, 15.0, 10.0, 5.0, 3.0])  # nats of a small cell, 1.9 errors at most
SURE = np.concatenate([FEW, FEW])  # 2.7 errors

# Of nats by block: with it, 100 of them are three standard errors.
SCATTER = 5.5 * (-1.0) ** np.arange(16)


def squeezed(mesh, times):
    """Flatter along Z."""
    return mesh.with_vertices(MIDDLE + (mesh.vertices_numpy() - MIDDLE) * (times, 1, 1))


BALL, SHEET = sphere(MIDDLE, 1.0), squeezed(sphere(MIDDLE, 1.5), 0.15)
NARROW = SimpleNamespace(sigma_um=(0.1,) * 3)


def followed(
    monkeypatch,
    *gains,
    evened=(),
    shines="both",
    over=(),
    even=False,
    mesh=BALL,
    uneven=True,
    varies=0.1,
):
    """After how many legs a rival stops that has gained so much by then, and what it has taken.

    over : brightness of insides after each, 1 unless given. even : whether brightness deep inside
    hardly varies. mesh : the cells. uneven : whether insides of both are, by what is left of them.
    varies : by how much brightness deep inside surely does.
    """
    fitted = SimpleNamespace(mesh=mesh, first_optics=NARROW)

    def rival(leg):
        shows = SimpleNamespace(structure=shines)
        return SimpleNamespace(
            leg=leg, structure=lambda: shows, fitted=fitted, insides_vary=lambda: (varies, 2.0)
        )

    def gained(one, other):
        # Evened, it gains no more unless given: insides alone are too uneven.
        even = evened[one.leg] if evened else 1.0
        return [even * np.ones((1, 16)), (gains[one.leg] / 16 + SCATTER)[None]]

    monkeypatch.setattr(
        hidden_membranes, "descend_and_pose_anew", lambda one: (rival(one.leg + 1), 3)
    )
    monkeypatch.setattr(hidden_membranes, "gains_over", gained)
    monkeypatch.setattr(hidden_membranes, "are_even", lambda one: even)
    monkeypatch.setattr(hidden_membranes, "is_uneven", lambda one: uneven)
    monkeypatch.setattr(
        hidden_membranes, "more_than_insides", lambda one, known: known[-1].sum() > bounds[3.0]
    )
    monkeypatch.setattr(
        hidden_membranes, "insides_over", lambda one: over[one.leg] if over else 1.0
    )
    bounds = {3.0: 100, 2.0: 60}
    monkeypatch.setattr(
        hidden_membranes,
        "gains_exceed_error",
        lambda known, errors: known[-1].sum() > bounds[errors],
    )
    trial = _followed(_Trial(rival(0), 5), None, 6)
    leg, may = trial.rival.leg, shines != "interior"
    denied = uneven if mesh is SHEET else varies > 0.65
    seen = not denied and (even or not over or over[leg] <= 2.5)
    assert trial.stands == (may and gains[leg] > 100 and seen)
    assert trial.hints == (may and max(gains[: leg + 1]) > 60)
    assert trial.evaluations == 5 + 3 * leg
    return leg


@pytest.mark.parametrize(
    ("gains", "legs"),
    [
        ((120.0, 130.0), 0),
        ((-75.0, 44.0, 80.0, 90.0, 120.0), 4),
        ((-620.0, -40.0, 60.0, 120.0), 3),
        ((-300.0, -177.0, 120.0), 1),  # another such step would not do
        ((14.0, 20.0, 20.5, 99.0), 2),  # it hardly grows any more
        ((14.0, 80.0, 30.0, 99.0), 2),  # it could be, on the way
        ((14.0, 15.0, 16.0, 17.0, 18.0, 19.0, 20.0, 99.0), 6),  # it would take too long
    ],
)
def test_a_rival_is_followed_while_it_gains(monkeypatch, gains, legs):
    assert followed(monkeypatch, *gains) == legs


def test_a_rival_that_gains_over_evened_insides_is_followed_too(monkeypatch):
    gains = (90.0, 90.0, 90.0, 90.0)
    assert followed(monkeypatch, *gains) == 1
    assert followed(monkeypatch, *gains, evened=(-9.0, 1.0, 4.0, 4.1)) == 3
    assert followed(monkeypatch, *gains, evened=(-9.0, -7.0, 1.0)) == 1  # too little


@pytest.mark.parametrize(("shines", "legs"), [("interior", 0), ("membrane", 1), ("both", 1)])
def test_a_rival_whose_membranes_do_not_show_is_followed_no_further(monkeypatch, shines, legs):
    assert followed(monkeypatch, 20.0, 120.0, shines=shines) == legs


def test_a_rival_whose_insides_would_hide_membranes_does_not_stand(monkeypatch):
    assert followed(monkeypatch, 80.0, 120.0, 140.0, over=(2.8, 2.7, 2.4)) == 2


def test_a_rival_whose_membranes_fade_is_followed_no_further(monkeypatch):
    assert followed(monkeypatch, 20.0, 50.0, 120.0, over=(2.4, 2.6, 2.4)) == 1
    assert followed(monkeypatch, 20.0, 50.0, 120.0, over=(2.2, 2.4, 2.3)) == 2


def test_bright_insides_hide_no_membranes_if_they_are_even(monkeypatch):
    assert followed(monkeypatch, 80.0, 120.0, 140.0, over=(2.8, 2.9, 2.4), even=True) == 1
    assert followed(monkeypatch, 20.0, 50.0, 120.0, over=(2.4, 2.6, 2.8), even=True) == 2


def test_flat_cells_have_no_membrane_that_may_be_chromatin(monkeypatch):
    gains = 80.0, 120.0, 140.0, 141.0
    assert followed(monkeypatch, *gains, mesh=SHEET) == 3
    assert followed(monkeypatch, *gains, mesh=SHEET, uneven=False) == 1


@pytest.mark.parametrize(("varies", "legs"), [(0.0, 1), (0.6, 1), (0.7, 3)])
def test_nor_have_cells_whose_chromatin_is_as_bright_as_it(monkeypatch, varies, legs):
    assert followed(monkeypatch, 80.0, 120.0, 140.0, 141.0, varies=varies) == legs


@pytest.mark.parametrize(
    ("mesh", "varies", "stands"), [(BALL, 0.1, True), (BALL, 0.9, False), (SHEET, 0.1, False)]
)
def test_nor_at_once(monkeypatch, mesh, varies, stands):
    fitted = SimpleNamespace(
        shape=SimpleNamespace(mesh=mesh),
        first_optics=NARROW,
        displaced=lambda *_: fitted,
        with_density=lambda _: fitted,
        with_structure=lambda _: fitted,
        mesh=mesh,
    )
    terms = SimpleNamespace(settings=SimpleNamespace(collisions=False))
    shows = SimpleNamespace(structure="both")
    rival = SimpleNamespace(
        fitted=fitted, structure=lambda: shows, insides_vary=lambda: (varies, 2.0)
    )
    for name, value in (
        ("begun", rival),
        ("descend_and_pose_anew", (rival, 3)),
        ("moved_in", None),
        ("both_beat_insides", True),
        ("gains_over", 2 * [np.ones((1, 4))]),
        ("is_uneven", True),
        ("_followed", "followed"),
    ):
        monkeypatch.setattr(hidden_membranes, name, lambda *_, value=value: value)
    found = hidden_membranes._from_further_in(terms, SimpleNamespace(fitted=fitted), None, 6)
    assert (found != "followed") == stands


@pytest.mark.parametrize(
    ("stretched", "width", "flat"),
    [
        ((0.15, 1, 1), (0.1, 0.1, 0.1), True),
        ((0.5, 1, 1), (0.1, 0.1, 0.1), False),
        ((0.5, 1, 1), (0.4, 0.1, 0.1), True),  # as long as the PSF is there
        ((1, 1, 1), (0.5, 0.1, 0.1), True),
        ((1, 1, 1), (0.1, 0.1, 0.1), False),
        ((0.3, 0.3, 0.3), (0.1, 0.1, 0.1), False),  # small
    ],
)
def test_cells_are_flat_as_the_psf_sees_them(stretched, width, flat):
    mesh = sphere(MIDDLE, 1.5)
    mesh = mesh.with_vertices(mesh.vertices_numpy() * stretched)
    optics = SimpleNamespace(sigma_um=width)
    assert all_flat(mesh, optics) == flat


def test_most_cells_decide_whether_they_are_flat():
    ball, sheet = sphere(MIDDLE, 1.5), squeezed(sphere(MIDDLE, 1.5), 0.15)
    away = [10.0 * k for k in range(3)]

    def together(*parts):
        moved = [p.with_vertices(p.vertices_numpy() + d) for p, d in zip(parts, away, strict=True)]
        return nd.Mesh.merge(moved)

    assert all_flat(together(ball, sheet, sheet), NARROW)
    assert not all_flat(together(ball, ball, sheet), NARROW)


def found(
    monkeypatch,
    further_in,
    crosses=False,
    asked="auto",
    alone_wins=False,
):
    """What goes on where both are judged like that further in, and whether it is unsure.

    asked : which structure. alone_wins : whether membranes alone explain more than insides do.
    """
    mesh = sphere(MIDDLE, 1.0)
    alone = SimpleNamespace(fitted=SimpleNamespace(mesh=mesh), evaluations=lambda: 1)
    objective = SimpleNamespace(anew=lambda: alone)

    def trial(name, *judged):
        fitted = SimpleNamespace(name=name, mesh=mesh)
        terms = SimpleNamespace(settings=SimpleNamespace(collisions=True))
        return _Trial(SimpleNamespace(fitted=fitted, terms=terms), 10, *judged)

    guard = SimpleNamespace(watch=lambda mesh: None, allows=lambda mesh: not crosses)
    monkeypatch.setattr(hidden_membranes, "CollisionGuard", lambda collisions: guard)
    monkeypatch.setattr(
        hidden_membranes,
        "replace",
        lambda one, **new: replace(one, **new) if is_dataclass(one) else one,
    )
    first = trial("further in", *further_in)
    monkeypatch.setattr(hidden_membranes, "_from_further_in", lambda *_: first)
    third = trial("membranes").rival
    monkeypatch.setattr(hidden_membranes, "_membranes_alone", lambda *_: (third, 100, alone_wins))
    terms = SimpleNamespace(settings=SimpleNamespace(structure=asked))
    fitted, taken, unsure = membranes_as_well(terms, objective, None, 6)
    return None if fitted is None else fitted.name, taken, unsure


YES, MAYBE, NO = (True, True), (False, True), (False, False)  # whether it stands; hints


def test_what_is_not_sure_is_said(monkeypatch):
    assert found(monkeypatch, YES) == ("further in", 111, False)
    assert found(monkeypatch, MAYBE) == (None, 111, True)
    assert found(monkeypatch, NO) == (None, 111, False)
    assert found(monkeypatch, YES, crosses=True) == (None, 111, False)


@pytest.mark.parametrize(
    ("both", "name"), [(NO, None), (MAYBE, None), (YES, "further in")], ids=["no", "maybe", "yes"]
)
def test_membranes_alone_are_tried_in_any_case(monkeypatch, both, name):
    assert found(monkeypatch, both, alone_wins=True) == ("membranes", 111, False)
    assert found(monkeypatch, both)[:2] == (name, 111)
    asked = found(monkeypatch, both, alone_wins=True, asked="both")
    assert asked[:2] == (name, 11)
    crosses = found(monkeypatch, both, alone_wins=True, crosses=True)
    assert crosses[0] is None


def membranes_alone(monkeypatch, legs, wide=0.1, without_one=1.0, deep=0.1):
    """Whether membranes alone are taken, and after how many evaluations.

    legs : of each, nats that they gain with insides evened and as measured, and the share of the
    squares of insides, of both and of the leg before that they leave. wide : um, of the PSF; the
    cell has a radius of 1. without_one : times as much that they leave without one of the cells.
    deep : how bright insides are deep inside.
    """
    optics = SimpleNamespace(sigma_um=(wide,) * 3)
    known = SimpleNamespace(mesh=sphere(MIDDLE, 1.0), first_optics=optics)
    insides = SimpleNamespace(fitted=known, deep_brightness=lambda: deep)
    both = SimpleNamespace()

    def rival(leg):
        def leaves_over(other):
            return legs[leg][2 if other is insides else 3 if other is both else 4]

        return SimpleNamespace(leg=leg, leaves_over=leaves_over)

    monkeypatch.setattr(hidden_membranes, "other_alone", lambda *_: "small")
    monkeypatch.setattr(hidden_membranes, "_membranes_further_in", lambda *_: "large")
    begin = []
    monkeypatch.setattr(
        hidden_membranes,
        "begun",
        lambda terms, one, factored: begin.append(one) or SimpleNamespace(leg=-1),
    )
    monkeypatch.setattr(
        hidden_membranes, "descend_and_pose_anew", lambda one: (rival(one.leg + 1), 7)
    )
    monkeypatch.setattr(
        hidden_membranes, "gains_over", lambda one, _: [np.atleast_2d(g) for g in legs[one.leg][:2]]
    )
    monkeypatch.setattr(
        hidden_membranes,
        "leaves_without_one",
        lambda one, other: without_one * one.leaves_over(other),
    )
    found, taken, surely = hidden_membranes._membranes_alone(None, insides, both, None)
    if found is insides:
        assert not begin
        return surely, None
    assert taken == 7 * (found.leg + 1)
    assert begin == ["small" if wide > 1 / 6 else "large"]
    return surely, found.leg


@pytest.mark.parametrize(
    ("evened", "measured", "leaves", "over_both", "wide", "taken"),
    [
        (SURE, SURE, 0.6, 0.8, 0.1, True),
        (FEW, SURE, 0.6, 0.8, 0.1, False),
        (SURE, FEW, 0.6, 0.8, 0.1, False),
        (-SURE, SURE, 0.6, 0.8, 0.1, False),  # a nucleus with chromatin
        (SURE, SURE, 0.85, 0.8, 0.1, False),
        (SURE, SURE, 0.6, 1.0, 0.1, False),  # a bright droplet that fades
        (SURE, SURE, 0.75, 0.8, 0.18, True),  # of small cells
        (SURE, SURE, 0.97, 0.8, 0.18, False),
    ],
)
def test_membranes_alone_must_explain_much_more_than_insides(
    monkeypatch, evened, measured, leaves, over_both, wide, taken
):
    legs = [(evened, measured, leaves, over_both, 0.99)] * 2
    assert membranes_alone(monkeypatch, legs, wide)[0] == taken


def test_membranes_alone_are_followed_while_they_get_better(monkeypatch):
    far, near = (-SURE, SURE, 1.2, 1.2, 0.8), (SURE, SURE, 0.5, 0.8, 0.7)
    assert membranes_alone(monkeypatch, [far, near]) == (True, 1)
    assert membranes_alone(monkeypatch, [far, far, far, near]) == (True, 3)
    assert membranes_alone(monkeypatch, [far, far, far, far, near]) == (False, 3)
    slow = (*far[:4], 0.97)
    assert membranes_alone(monkeypatch, [far, slow, near]) == (False, 1)
    assert membranes_alone(monkeypatch, [(SURE, FEW, *far[2:]), near]) == (False, 0)
    small = [(SURE, SURE, 0.96, 1.2, 0.8), near]  # chromatin
    assert membranes_alone(monkeypatch, small, wide=0.18) == (False, 0)


def of_cells(*shares):
    """Gains of as many cells as there are shares, in proportion to them."""
    return np.outer(shares, SURE)


ALIKE, ONE_ALONE = of_cells(1, 1, 1, 1, 1), of_cells(0.05, -0.1, 9, 0.1, -0.05)


@pytest.mark.parametrize(
    ("gains", "taken"),
    [
        ((ALIKE, ALIKE), True),
        ((ONE_ALONE, ALIKE), False),
        ((ALIKE, ONE_ALONE), False),
        ((of_cells(0.05, 9, 0.1), ALIKE[:3]), True),  # too few to leave one out
    ],
)
def test_no_cell_decides_for_all(monkeypatch, gains, taken):
    assert membranes_alone(monkeypatch, 5 * [(*gains, 0.5, 0.8, 0.7)])[0] == taken


@pytest.mark.parametrize(
    ("deep", "wide", "tried"),
    [(None, 0.1, True), (0.9, 0.1, True), (1.1, 0.1, False), (1.1, 0.18, True)],
)
def test_where_depths_are_bright_there_is_no_membrane_alone(monkeypatch, deep, wide, tried):
    """Small cells have no depths that the light of a membrane does not reach."""
    legs = 5 * [(SURE, SURE, 0.5, 0.8, 0.7)]
    assert membranes_alone(monkeypatch, legs, wide, deep=deep)[0] == tried


def test_nor_for_how_much_is_left(monkeypatch):
    leg = ALIKE, ALIKE, 0.5, 0.8, 0.7
    assert membranes_alone(monkeypatch, 5 * [leg], without_one=1.5)[0]
    assert not membranes_alone(monkeypatch, 5 * [leg], without_one=1.7)[0]


def begun_within(mesh, width):
    """Membranes as they begin within insides; width : um, of the PSF at the start."""
    first, optics, none = GaussianPSF(width), GaussianPSF(0.2), Effects()
    shape = Shape.begun(mesh, "smooth")
    fitted = Fitted(shape, optics, none, first, none, structure="interior")
    terms = SimpleNamespace(settings=SimpleNamespace(collisions=False))
    begin = hidden_membranes._membranes_further_in(terms, fitted)
    assert begin.structure == "membrane"
    assert begin.optics is fitted.optics
    return begin


def test_membranes_of_large_cells_begin_within_the_outer_half_of_their_light():
    begin = begun_within(sphere((0.0, 0.0, 0.0), 2.0, edge_length=0.4), 0.2)
    lengths = np.linalg.norm(begin.mesh.vertices_numpy(), axis=1)
    np.testing.assert_allclose(lengths, 2 - 1.2 * 0.2, atol=0.02)
    assert begin.shape.model == "smooth"


@pytest.mark.parametrize(("times", "model"), [(0.15, "interface"), (0.6, "smooth")])
def test_membranes_of_flat_cells_are_as_bright_everywhere(times, model):
    """0.9 um high, and 3.6; the PSF begins with 0.2."""
    mesh = squeezed(sphere(MIDDLE, 3.0, edge_length=0.5), times)
    assert begun_within(mesh, 0.2).shape.model == model


@pytest.mark.parametrize(
    ("structure", "again", "word"),
    [("membrane", False, "better than insides"), ("both", True, "as well")],
)
def test_beside_membranes_that_were_found_alone_insides_are_asked_for_once_more(
    structure, again, word
):
    mesh, said, posed = sphere(MIDDLE, 1.0), [], []
    fitted = SimpleNamespace(structure=structure, mesh=mesh)
    stage = SimpleNamespace(progress=Progress(asked_again=True, unsure=True, iterations=7))
    at = SimpleNamespace(fitted=fitted, stage=stage)
    at.progressed = lambda progress: posed.append(progress) or at
    context = SimpleNamespace(
        reporter=SimpleNamespace(say=said.append), upkeep=SimpleNamespace(restart=lambda: None)
    )
    LevelRun._go_on_further_in(SimpleNamespace(at=at, _context=context))
    assert posed == [Progress(asked_again=again, unsure=True)]
    assert word in said[0]


@pytest.mark.parametrize(("structure", "unsure"), [("interior", True), ("both", False)])
def test_membranes_may_shine_as_well_only_where_none_do(monkeypatch, structure, unsure):
    """Where a user asks for both, the verdict would say that insides alone may do."""
    fitted = SimpleNamespace(structure=structure)
    monkeypatch.setattr(ModelChoice, "_asked_again", lambda *_: True)
    monkeypatch.setattr(ModelChoice, "_with_both_again", staticmethod(lambda *_: (fitted, 3, True)))
    choice = ModelChoice(FitSettings(structure="both"), 1)
    found = choice.asked_anew(None, None, fitted, None, Progress(), False)
    assert found == (fitted, 3, Progress(asked_again=True, unsure=unsure))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 4])
def test_noise_in_even_insides_is_no_chromatin(seed):
    """Three photons: brightness deep inside varies by up to 0.7 of the membrane's peak, or not.

    A start that is a quarter too large, from which insides alone would end 1.2 voxels too far out.
    """
    voxel, shape = (0.2, 0.1, 0.1), (23, 46, 46)
    grid = nd.Grid(shape, voxel)
    middle = (np.array(shape) - 1) * np.array(voxel) / 2
    optics = nd.GaussianPSF((0.13, 0.065, 0.065))
    true = sphere(middle, 1.3, edge_length=0.19)
    peak = np.sqrt(2 * np.pi) * np.prod(optics.sigma_um) ** (1 / 3)
    given = true, grid, optics, 1e-3, 1.0, 0.0
    both, rim = (
        nd.scene.expected_image(*given, light=Light(1.0, inside)) for inside in (0.8 / peak, 0.0)
    )
    light = np.maximum(3 * both / rim.max() + 20, 0)
    image = np.random.default_rng(seed).poisson(light)
    begin = sphere(middle, 1.25 * 1.3, edge_length=0.26)
    settings = FitSettings(structure="auto", levels=(1.0,))
    *_, last = nd.fit(image.astype(np.float32), grid, begin, optics, settings=settings)
    away = distance_to_surface(true.vertices_numpy(), last.mesh)
    assert last.light.membrane > 0
    assert np.sqrt(np.mean(np.asarray(away) ** 2)) < 0.5 * 0.1
