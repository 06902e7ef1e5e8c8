"""Whether insides alone explain as much as both."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from benchmarks.shapes import box

from napari_deltamic.fitting.model.shape import Shape
from napari_deltamic.fitting.objective.fit_objective import Objective
from napari_deltamic.fitting.rivals import rival_structures, small_cells
from napari_deltamic.fitting.rivals.gains import gains_over
from napari_deltamic.fitting.rivals.rival_structures import (
    errors_asked,
    gains_exceed_error,
    moved_in,
)
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.geometry.topology.crossings import crosses


@pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
def test_a_surface_that_begins_further_in_does_not_cross_itself():
    """A plate thinner than twice the depth."""
    mesh = box((0.0, 0.0, 0.0), (0.6, 4.0, 4.0), edge_length=0.4)
    shape, places = Shape.begun(mesh, "uniform"), mesh.vertices_numpy()
    moved = moved_in(shape, 0.4, True)
    assert np.abs(moved - places).max(0).min() > 0.1
    assert not crosses(mesh.with_vertices(moved))
    assert crosses(mesh.with_vertices(moved_in(shape, 0.4, False)))


def test_a_surface_that_begins_further_in_keeps_its_pins():
    mesh = box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), edge_length=0.5)
    places = mesh.vertices_numpy()
    pinned = places[:, 1] > 0.9
    moved = moved_in(Shape.begun(mesh, "uniform").with_pins(pinned), 0.1, False)
    np.testing.assert_array_equal(moved[pinned], places[pinned])
    away = np.linalg.norm(moved - places, axis=1)[~pinned]
    np.testing.assert_allclose(away, 0.1, rtol=1e-6)


def answer(gains, asked="auto"):
    """One that explains so many nats more in each block, whichever way insides are measured."""
    settings = SimpleNamespace(structure=asked)
    return SimpleNamespace(
        terms=SimpleNamespace(settings=settings),
        nats_left=lambda other, evened: np.stack([0 * gains[evened], gains[evened]]),
        cells_of_blocks=lambda: np.ones(len(gains[True]), int),
    )


def compared(evened, measured, asked="auto"):
    gains = {True: np.asarray(evened), False: np.asarray(measured)}
    losses = {k: -g for k, g in gains.items()}
    one, other = answer(gains, asked), answer(losses, asked)
    return gains_exceed_error(gains_over(one, other), errors_asked(one))


EVERYWHERE = np.full(100, 1.0)
IN_ONE_PLACE = np.concatenate([[100.0], np.zeros(99)])


@pytest.mark.parametrize(
    ("evened", "measured", "more"),
    [
        (EVERYWHERE, EVERYWHERE, True),
        (EVERYWHERE, IN_ONE_PLACE, False),  # 100 nats, with an error of 100
        (IN_ONE_PLACE, EVERYWHERE, False),
        (EVERYWHERE, -EVERYWHERE, False),
        (0.1 * EVERYWHERE, EVERYWHERE, False),  # 10 nats
    ],
)
def test_it_must_explain_more_all_over_and_either_way(evened, measured, more):
    assert compared(evened, measured) is more


def test_where_both_are_asked_for_one_place_is_enough():
    assert compared(IN_ONE_PLACE, IN_ONE_PLACE, "both")
    assert not compared(0.1 * IN_ONE_PLACE, IN_ONE_PLACE, "both")


def test_the_bound_is_what_a_membrane_must_differ_by():
    just = (rival_structures.RULES.nats + 0.1) / 100 * EVERYWHERE
    assert compared(just, just)
    assert not compared(just - 0.002, just)


def test_what_one_leaves_over_another_is_a_mean_over_the_voxels_of_each():
    def at(left, its):
        posed = SimpleNamespace(left_by=lambda image: (its, 0.0))
        return SimpleNamespace(left=left, posed=posed, now=SimpleNamespace(rendered=None))

    # Twice as much on its own voxels, eight times as much on those of the other.
    assert Objective.leaves_over(at(2.0, 1.0), at(1.5, 12.0)) == pytest.approx(4.0)
    assert np.isfinite(Objective.leaves_over(at(0.0, 0.0), at(0.0, 0.0)))


def test_an_image_evened_for_one_of_them_does_not_judge():
    def at(structure, left, of_other):
        posed = SimpleNamespace(
            nats_left_by=lambda image, evened: torch.tensor([(9.0 if evened else 1.0) * image])
        )
        return SimpleNamespace(
            fitted=SimpleNamespace(structure=structure),
            now=SimpleNamespace(rendered=left),
            posed=posed,
            leaves_over=lambda other: of_other,
        )

    one, other = at("membrane", 3.0, 7.0), at("both", 4.0, 8.0)
    assert Objective.leaves_of_measured(one, other) == pytest.approx(0.75)
    assert Objective.leaves_of_measured(at("interior", 3.0, 7.0), other) == 7.0


def fit_of_both(evened, measured, interior=1.0, leaves=0.9, membrane=1.0, vary=np.inf):
    """It explains so many nats more than insides alone, and leaves so much of what they do.

    vary : how much brightness deep inside varies at most, of the peak of a membrane's image.
    """
    # The peak of the image of a membrane of 1, through a PSF of this width, is 1.
    optics = SimpleNamespace(sigma_um=(1 / np.sqrt(2 * np.pi),) * 3)
    return SimpleNamespace(
        **vars(answer({True: evened, False: measured})),
        leaves_over=lambda other: leaves,
        insides_vary=lambda: (0.0, vary),
        now=SimpleNamespace(light=SimpleNamespace(membrane=membrane, interior=interior)),
        fitted=SimpleNamespace(optics=optics),
    )


ONCE = np.array([20.0, 15.0, 10.0, 5.0, 3.0])  # nats of a small cell by block
FEW, SURE = np.append(ONCE, np.zeros(5)), np.tile(ONCE, 2)  # 1.9 errors at most, and 2.7


@pytest.mark.parametrize(
    ("given", "stand"),
    [
        ({"evened": EVERYWHERE, "measured": EVERYWHERE, "interior": 9.0, "leaves": 2.0}, True),
        ({"evened": FEW, "measured": SURE}, True),  # insides alone were evened
        ({"evened": -FEW, "measured": SURE}, True),
        ({"evened": FEW, "measured": FEW}, False),
        ({"evened": FEW, "measured": SURE, "leaves": 1.1}, False),
        ({"evened": FEW, "measured": SURE, "interior": 2.6}, False),
        ({"evened": 0.1 * SURE, "measured": 0.1 * SURE}, False),  # 11 nats
        ({"evened": FEW, "measured": SURE, "interior": 0.0, "membrane": 0.0}, False),
        # A bright rim around even insides is no chromatin, however uneven it is.
        ({"evened": -EVERYWHERE, "measured": EVERYWHERE, "vary": 0.14, "leaves": 1.2}, True),
        ({"evened": -EVERYWHERE, "measured": EVERYWHERE, "vary": 0.16, "leaves": 1.2}, False),
        ({"evened": FEW, "measured": 0.1 * SURE, "vary": 0.1}, False),
        ({"evened": FEW, "measured": FEW, "vary": 0.1}, False),
        # The membrane would add less than 4 % to the inside.
        (
            {"evened": -EVERYWHERE, "measured": EVERYWHERE, "vary": 0.1, "interior": 6.0},
            False,
        ),
    ],
)
def test_membranes_that_are_clear_stand_by_what_was_measured(given, stand):
    alone = answer({True: -given["evened"], False: -given["measured"]})
    assert rival_structures.both_beat_insides(fit_of_both(**given), alone) is stand


def fit_at(leg):
    return SimpleNamespace(leg=leg, fitted=leg)


# Nats that insides alone lack after each leg.
@pytest.mark.parametrize(
    ("lacking", "taken", "legs"),
    [
        ((-1,), 0, 0),
        ((100, -50), 1, 1),  # a crowd of nuclei
        ((100, 40, 10, -1), 3, 3),
        ((100, 60, 20, -1), None, 1),  # another such leg would not do
        ((100, 40, 15, 5, -1), None, 3),
    ],
)
def test_insides_alone_are_followed_while_they_may_come_near(monkeypatch, lacking, taken, legs):
    """Where the membranes of both do not stand, they are taken."""

    def gains(one, other):  # both explain more than insides alone, and these than before
        return [np.array([lacking[other.leg] - (0 if one is both else lacking[one.leg])])]

    def stay(one, alone, known):
        assert known == gains(one, alone)
        return lacking[alone.leg] > 0

    both = SimpleNamespace(evaluations=lambda: 1)
    monkeypatch.setattr(rival_structures, "_alone_further_out", lambda *_: None)
    monkeypatch.setattr(rival_structures, "begun", lambda *_: None)
    monkeypatch.setattr(
        rival_structures,
        "descend_and_pose_anew",
        lambda one: (fit_at(0 if one is None else one.leg + 1), 5),
    )
    monkeypatch.setattr(rival_structures, "_stay", stay)
    monkeypatch.setattr(rival_structures, "gains_over", gains)
    objective = SimpleNamespace(anew=lambda: both)
    found, evaluations = rival_structures.insides_alone(None, objective, None)
    assert found == taken
    assert evaluations == 6 + 5 * legs


@pytest.mark.parametrize(
    ("evened", "measured", "stay"),
    [(FEW, FEW, True), (FEW, FEW[:2], False), (FEW[:2], FEW, False), (0.2 * FEW, FEW, False)],
)
def test_both_stay_where_insides_alone_are_near_and_explain_less(evened, measured, stay):
    """By 1.9 errors, here; two such blocks would be 1.4, and less than 13 nats are too few."""
    both = fit_of_both(evened, measured, interior=9.0)
    assert rival_structures._stay(both, None, [evened, measured]) is stay


def test_insides_alone_begin_where_they_look_like_both():
    mesh = sphere((0.0, 0.0, 0.0), 2.0, edge_length=0.4)

    def displaced(vertices, optics):
        return SimpleNamespace(with_structure=lambda name: (name, vertices))

    # No further than a width of the PSF.
    brightness = ((0.1, 0.5, 0.2), (0.1, -0.5, -0.2), (9.0, 0.5, 0.3), (0.1, 0.0, 0.0))
    for membrane, interior, further in brightness:
        fitted = SimpleNamespace(
            shape=Shape.begun(mesh, "uniform"),
            first_optics=SimpleNamespace(sigma_um=(0.3, 0.3, 0.3)),
            displaced=displaced,
        )
        now = SimpleNamespace(light=SimpleNamespace(membrane=membrane, interior=interior))
        terms = SimpleNamespace(settings=SimpleNamespace(collisions=False))
        both = SimpleNamespace(fitted=fitted, now=now)
        name, vertices = rival_structures._alone_further_out(terms, both)
        assert name == "interior"
        np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 2 + further, atol=0.02)


class Begun:
    """What is told of where a rival begins."""

    def __init__(self, vertices, *told):
        self.vertices, self.told = vertices, told

    def with_structure(self, structure):
        return Begun(self.vertices, *self.told, structure)

    def with_density(self, model):
        return Begun(self.vertices, *self.told, model)


@pytest.mark.parametrize(
    ("name", "density", "other", "radius"),
    [
        ("interior", "smooth", ("membrane", "interface"), 1.549),
        ("interior", "uniform", ("membrane", "uniform"), 1.549),
        ("membrane", "smooth", ("interior",), 2.582),
    ],
)
def test_the_other_alone_begins_where_its_light_is_spread_alike(name, density, other, radius):
    mesh = sphere((0.0, 0.0, 0.0), 2.0, edge_length=0.4)
    fitted = SimpleNamespace(
        mesh=mesh,
        structure=name,
        shape=Shape.begun(mesh, "uniform"),
        first_optics=None,
        displaced=lambda vertices, optics: Begun(vertices),
    )
    terms = SimpleNamespace(settings=SimpleNamespace(collisions=False, density=density))
    found = small_cells.other_alone(terms, fitted)
    assert found.told == other
    np.testing.assert_allclose(np.linalg.norm(found.vertices, axis=1), radius, atol=0.02)


def test_radii_are_those_of_the_smallest_cell_at_a_vertex_whatever_cells_are_called():
    two = Mesh.merge([sphere((0, 0, 0), 2.0, subdivisions=4), sphere((0, 0, 9), 1.0)])
    names = np.array([0, 7, 2_000_000_000])
    mesh = Mesh(two.vertices, two.faces, names[two.regions])
    radii = small_cells._radii(mesh)
    first = two.vertices_numpy()[:, 2] < 5
    np.testing.assert_allclose(radii[first], 2.0, rtol=0.01)
    np.testing.assert_allclose(radii[~first], 1.0, rtol=0.05)
