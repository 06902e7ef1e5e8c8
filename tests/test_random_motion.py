"""A foam that is shaken and remeshed neither crosses nor cracks nor loses a label."""

import pytest

from napari_deltamic.geometry.remeshing import can_remesh

motion = pytest.importorskip("benchmarks.clusters.random_motion")


@pytest.mark.slow
@pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
def test_a_foam_that_is_shaken_stays_sound():
    _, outcome = motion.shaken(motion.start(12), 300)
    assert (outcome.crossings, outcome.cracks, outcome.labels) == (0, 0, 0)
    assert outcome.held > 0  # or the guard was not needed
    assert outcome.angle >= 25


@pytest.mark.slow
@pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
def test_a_foam_pressed_into_thin_sheets_stays_sound_and_small():
    first = motion.start(12)
    last, outcome = motion.shaken(first, 200, motion.ROUGH)
    assert (outcome.crossings, outcome.cracks, outcome.labels) == (0, 0, 0)
    assert len(last.faces) < 2 * len(first.faces)
