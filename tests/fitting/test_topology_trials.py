"""At the end of a fit other arrangements are tried, and kept where the image speaks for them."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from noisy_cells import events_of, photographed

from napari_deltamic import GaussianPSF, Mesh, fit
from napari_deltamic.fitting.model.fitted import Fitted
from napari_deltamic.fitting.surface import topology_trials
from napari_deltamic.fitting.surface.local_misfit import Gap
from napari_deltamic.fitting.surface.topology import Judgement, TopologyPolicy, Trial
from napari_deltamic.fitting.surface.topology_trials import TopologyTrials
from napari_deltamic.geometry import remesh
from napari_deltamic.geometry.contacts import contacts
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.geometry.topology.rearranging import give_way
from napari_deltamic.geometry.topology.small_pieces import small_pieces
from napari_deltamic.geometry.topology.thin_places import ThinPlace, short_junctions, small_walls
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.light import Light

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
VOXEL, EDGE = 0.15, 0.25
OPTICS = GaussianPSF(0.2)
SETTINGS = FitSettings(levels=(1.0,))


def fitted(truth, start, photons=40, draw=0):
    image, grid = photographed(truth, voxel=VOXEL, optics=OPTICS, photons=photons, draw=draw)
    states = list(fit(image, grid, start, OPTICS, settings=SETTINGS))
    assert states[-1].converged
    return states, events_of(states)


def five(half):
    """Cells 1 and 2 at the ends of a junction of three others, or through it if they are near."""
    turns = 2 * np.pi * np.arange(3) / 3 + 0.3
    around = 0.8 * np.stack([0 * turns, np.sin(turns), np.cos(turns)], axis=1)
    ends = np.array([[-half, 0.02, 0.01], [half, 0, 0]])
    return foam(np.concatenate([ends, around]), np.full(5, 1.15), 0.15)


def flip_of(mesh):
    """Its coarser start, in which cells 1 and 2 touch where they should not, or the reverse."""
    mesh = remesh(mesh, EDGE).mesh
    if (1, 2) in contacts(mesh):
        (place,) = [p for p in small_walls(mesh, 1.0) if p.regions == (1, 2)]
    else:
        (place,) = [p for p in short_junctions(mesh, 1.0) if p.sides == (1, 2)]
    made = give_way(mesh, [place], EDGE).mesh
    assert contacts(made) ^ contacts(mesh) == {(1, 2)}
    return made


def test_a_wrong_neighbour_is_exchanged():
    truth = five(0.45)  # of six draws of noise four or five are decided, this one at once
    states, told = fitted(truth, flip_of(truth), draw=3)
    assert contacts(states[-1].mesh) == contacts(truth)
    assert told.endswith("cell 1 touches cell 2")  # may have been undecided at first
    assert all(len(state.density) == len(state.mesh.faces) for state in states)


def test_nothing_is_tried_where_that_is_switched_off():
    truth = five(0.5)
    image, grid = photographed(truth, voxel=VOXEL, optics=OPTICS, photons=40)
    settings = SETTINGS.model_copy(update={"trials": False})
    states = list(fit(image, grid, flip_of(truth), OPTICS, settings=settings))
    assert states[-1].converged
    assert contacts(states[-1].mesh) ^ contacts(truth) == {(1, 2)}
    assert not events_of(states)


# Where the junction has collapsed to nothing first, the tube that is opened there is so narrow that
# it has not relaxed when it is judged: with none of four draws of the noise is it found.
COLLAPSES = pytest.param(0.6, 2000, marks=pytest.mark.xfail(strict=True, reason="judged too soon"))


@pytest.mark.slow
@pytest.mark.parametrize(("half", "photons"), [COLLAPSES, (0.9, 200), (0.9, 2000)])
def test_a_wrong_neighbour_is_exchanged_or_told(half, photons):
    """A wrong wall shrinks until the image can hardly tell it from none: 0 to 5 of 8 are found."""
    truth = five(half)
    states, told = fitted(truth, flip_of(truth), photons)
    undecided = "undecided: how cells 1, 2, 3, 4 and 5 meet at (" in told
    assert undecided or contacts(states[-1].mesh) == contacts(truth)
    assert all(len(state.density) == len(state.mesh.faces) for state in states)


@pytest.mark.parametrize("photons", [40, pytest.param(2000, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "half",
    [0.55, pytest.param(0.68, marks=pytest.mark.slow), pytest.param(0.9, marks=pytest.mark.slow)],
)
def test_right_neighbours_stay(half, photons):
    truth = five(half)
    states, told = fitted(truth, remesh(truth, EDGE).mesh, photons)
    assert contacts(states[-1].mesh) == contacts(truth)
    # What the image cannot tell by three standard errors is said, and stays.
    assert told == "" or told.startswith("undecided")


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [True, False])
def test_where_the_image_says_neither_the_present_neighbours_stay(wrong):
    """A wall as wide as the PSF: the two best shapes differ by less than an error."""
    truth = five(0.68)
    start = flip_of(truth) if wrong else remesh(truth, EDGE).mesh
    states, told = fitted(truth, start)
    assert contacts(states[-1].mesh) == contacts(start)
    assert told.startswith("undecided: how cells 1, 2, 3, 4 and 5 meet at (")
    assert ";" not in told


def with_gap(size):
    """Four cells around a gap, which is a fifth one taken away."""
    corners = 1.2 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the tips of the fifth
        mesh = foam(np.concatenate([corners, [[0, 0, 0]]]), np.array([*4 * [1.25], size]), 0.15)
    return Mesh(mesh.vertices, mesh.faces, np.where(mesh.regions == 5, 0, mesh.regions))


@pytest.mark.slow
def test_a_gap_that_is_not_in_the_image_closes():
    begun = with_gap(0.75)
    (gap,) = small_pieces(begun, 0.5)
    truth = remesh(give_way(begun, [gap], 0.15).mesh, 0.15).mesh
    states, told = fitted(truth, begun)
    assert not small_pieces(states[-1].mesh, 0.5)
    assert "has closed" in told


@pytest.mark.slow
@pytest.mark.xfail(
    reason="judged before all has come to rest: it closes with three of four draws", strict=True
)
def test_a_gap_that_is_in_the_image_stays():
    truth = with_gap(0.75)
    (gap,) = small_pieces(truth, 0.5)
    assert gap.volume < 4 / 3 * np.pi * 0.4**3  # or it would not even be tried
    states, told = fitted(truth, remesh(truth, EDGE).mesh)
    assert small_pieces(states[-1].mesh, 0.5)
    assert "closed" not in told


# ------------------------------------------------------------------------------ what is decided


def place(x=0.0, regions=(1, 2), sides=(3, 4), width=0.1, volume=0.0):
    return ThinPlace(regions, sides, np.array([[0.0, 0.0, x]]), width, volume)


def judged(tried, *gaps, places=None):
    places = places or tuple(place(10.0 * k) for k in range(len(gaps)))
    trial = Trial(None, None, tuple(places), (), 0, tried)
    return TopologyPolicy().judged(trial, [Gap(nats, 1.0) for nats in gaps])


def test_a_trial_stays_only_where_the_image_is_explained_better_by_three_errors():
    policy, found = judged(True, 3.1, 2.9, -2.9, -3.1)
    better, hardly, hardly_worse, worse = (10.0 * k for k in range(4))
    assert [p.points[0, 2] for p in found.kept] == [better]
    assert [p.points[0, 2] for p in found.undone] == [hardly, hardly_worse, worse]
    assert [p.points[0, 2] for p in found.undecided] == [hardly, hardly_worse]
    assert policy.left_alone == found.undone


def test_what_pressed_stays_unless_the_image_is_explained_worse_by_three_errors():
    _, found = judged(False, 3.1, -2.9, -3.1)
    assert [p.points[0, 2] for p in found.kept] == [0.0, 10.0]
    assert [p.points[0, 2] for p in found.undone] == [20.0]
    assert not found.undecided


def test_a_piece_smaller_than_the_psf_needs_no_evidence_to_go():
    _, found = judged(True, -1.0, places=[place(volume=0.01)])
    assert found.kept


def test_what_another_level_saw_does_not_count():
    policy = TopologyPolicy(seen=(place(),), past=(place(3.0),), left_alone=(place(6.0),))
    again = policy.restarted()
    assert not again.seen
    assert (again.past, again.left_alone) == (policy.past, policy.left_alone)


def test_a_policy_goes_through_plain_values():
    one = TopologyPolicy(seen=(place(),), past=(place(3.0, volume=0.2),), late=2, most=7)
    other = TopologyPolicy.from_dict(one.to_dict())
    assert other.to_dict() == one.to_dict()
    assert other.past[0].volume == 0.2
    assert (other.late, other.most, other.left_alone) == (2, 7, ())


def test_what_is_undone_takes_psf_and_light_back(monkeypatch):
    """They have gone along with the wrong shape: a nucleus that was taken away made a wide PSF."""
    begun = Fitted.begun(flip_of(five(0.5)), OPTICS, Effects(), "smooth", "both")
    begun = begun.shining(Light(0.0, 1.0, ((1, 0.4), (2, 1.6))))
    wide = replace(begun, optics=GaussianPSF(0.5), light=Light(0.0, 1.0, ((1, 9.0), (2, 0.2))))
    trials = TopologyTrials(None)
    place = ThinPlace((1,), (2,), np.zeros((1, 3)), 1.0)
    trials.trial = Trial(begun, None, (place,), (), 0, False)
    judgement = Judgement((), (place,), ())
    monkeypatch.setattr(TopologyTrials, "_misfit", lambda *given: None)
    monkeypatch.setattr(topology_trials, "gaps", lambda *given: [])
    monkeypatch.setattr(TopologyPolicy, "judged", lambda self, *given: (self, judgement))
    after = trials.judged(wide, SETTINGS)
    assert after.optics.sigma_um == begun.optics.sigma_um
    assert after.light == begun.light
    assert trials.trial is None
