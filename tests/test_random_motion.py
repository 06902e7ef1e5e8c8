"""A foam that is shaken and remeshed neither crosses nor cracks nor loses a label."""

import pytest

from napari_deltamic.geometry.remeshing import can_remesh

motion = pytest.importorskip("benchmarks.random_motion")


@pytest.mark.slow
@pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
def test_a_foam_that_is_shaken_stays_sound():
    _, outcome = motion.shaken(motion.start(12), 300)
    assert (outcome.crossings, outcome.cracks, outcome.labels) == (0, 0, 0)
    assert outcome.held > 0  # or the guard was not needed
    assert outcome.angle >= 25
