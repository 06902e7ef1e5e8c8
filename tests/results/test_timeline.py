"""The moments that are kept of a fit."""

import math
from itertools import pairwise
from types import SimpleNamespace

import pytest

from napari_deltamic import GaussianPSF
from napari_deltamic.geometry import sphere
from napari_deltamic.results.timeline import Moment, Timeline

MESH = sphere((0, 0, 0), 1.0, subdivisions=0)
OPTICS = GaussianPSF(0.2)


def state(iteration, loss=0.5):
    mesh = MESH.translated((0, 0, iteration))
    return SimpleNamespace(iteration=iteration, loss=loss, mesh=mesh, optics=OPTICS)


def iterations(timeline):
    return [moment.iteration for moment in timeline.moments]


def test_a_short_fit_is_kept_whole():
    timeline = Timeline()
    for k in range(1, 51):
        timeline.add(state(k))
    assert iterations(timeline) == list(range(1, 51))
    assert timeline.moments[7].mesh.vertices_numpy()[:, 2].mean() == pytest.approx(8)


@pytest.mark.parametrize("n", [199, 200, 201, 1000, 4321])
def test_a_long_fit_is_thinned_out_evenly(n):
    timeline = Timeline(most=20)
    for k in range(1, n + 1):
        timeline.add(state(k), "pushed" if k == 77 else "")
    kept = iterations(timeline)
    assert len(kept) <= 21
    assert kept[0] == 1
    assert kept[-1] == n
    assert 77 in kept
    assert kept == sorted(set(kept))
    gaps = [b - a for a, b in pairwise(kept)]
    assert max(gaps) <= 4 * n / 20


def test_notes_outlast_every_thinning():
    timeline = Timeline(most=10)
    for k in range(1, 400):
        timeline.add(state(k), str(k) if k % 20 == 0 else "")
    notes = [moment.note for moment in timeline.moments if moment.note]
    assert notes == [str(k) for k in range(20, 400, 20)]


def test_a_note_on_the_state_that_is_there_already_is_added_to_it():
    timeline = Timeline()
    now = state(3)
    timeline.add(now, "pushed")
    timeline.add(now, "pinned")
    assert [moment.note for moment in timeline.moments] == ["pushed; pinned"]


def test_iterations_count_on_through_the_next_run():
    timeline = Timeline()
    for k in (1, 2, 3):
        timeline.add(state(k))
    timeline.go_on()
    timeline.add(state(1))
    timeline.add(state(2))
    assert iterations(timeline) == [1, 2, 3, 4, 5]


def test_begins_with_what_was_saved():
    saved = [Moment(k, math.nan, MESH, OPTICS, "") for k in range(1, 31)]
    timeline = Timeline(saved, most=20)
    assert len(timeline.moments) <= 20
    timeline.go_on()
    timeline.add(state(1))
    assert iterations(timeline)[-1] == 31


def test_finds_the_nearest_moment():
    timeline = Timeline([Moment(k, 0.1, MESH, OPTICS, "") for k in (1, 10, 20)])
    assert timeline.nearest(13) == 1
    assert timeline.nearest(99) == 2
    assert Timeline().nearest(1) is None
