"""Scenes of benchmarks.defaults that the default command once got wrong."""

import pytest

scenes = pytest.importorskip("benchmarks.defaults.scenes")
from benchmarks.defaults.command import fitted, renumbered  # noqa: E402
from benchmarks.defaults.scoring import score  # noqa: E402

pytestmark = pytest.mark.usefixtures("judged")
COMMIT = "eb6f8a2203be47013e73a9f6a6b5c447cc5e424c"  # whose draws they are


@pytest.mark.slow
def test_a_fit_that_has_collapsed_begins_anew_with_membranes(tmp_path):
    """One side of the cell is bright, and passed as an inside: it had ended 0.77 voxel off."""
    scene = scenes.made("uneven", 1, COMMIT)
    outcome = fitted(scene, tmp_path, False, 200)
    assert score(scene, renumbered(scene, outcome.mesh)).surface < 0.1
    assert outcome.report["verdict"]["grade"] == "good"


@pytest.mark.slow
def test_the_inner_side_of_a_thick_layer_is_not_called_good(tmp_path):
    """2 voxels from the middle of the layer, and good, as a dark inside in a bright medium."""
    scene = scenes.made("thick", 1, COMMIT)
    verdict = fitted(scene, tmp_path, False, 200).report["verdict"]
    assert verdict["grade"] != "good"
    assert any("thick bright layer" in reason for reason in verdict["reasons"])
