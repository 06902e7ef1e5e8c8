"""Random actions of a user in the window, and a dock that is opened and closed."""

import pytest

pytest.importorskip("napari")
window = pytest.importorskip("benchmarks.robustness.window")


@pytest.mark.slow
def test_many_actions_raise_nothing_and_lose_nothing():
    did, troubles = window.play(0, 40, cycles=2)
    assert troubles == []
    assert min(did.get(name, 0) for name in ("anything", "fits")) > 0, did


@pytest.mark.slow
def test_thousands_of_actions_raise_nothing_and_lose_nothing():
    strokes = 0
    for seed in range(1, 11):
        did, troubles = window.play(seed, 400, cycles=50 if seed == 10 else 0)
        assert troubles == []
        assert did["anything"] > 50, "or nothing was tried"
        strokes += did.get("strokes", 0)
    assert strokes > 0
    assert did["opened and closed"] == 50
