"""Tensions and pressures of double bubbles, whose tensions are given, and of what has none."""

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble

from napari_deltamic.errors import InputError
from napari_deltamic.measure import Junction, TensionSettings, measure, relative_tensions
from napari_deltamic.measure.tensions import Estimate, relative_pressures, walls_around

WALLS = [(1, 0), (2, 0), (2, 1)]


def junction(regions, angles, spread=1.0, length=10.0):
    return Junction(regions, np.array(angles, float), np.full(3, spread), length, 1.0)


@pytest.mark.parametrize("ratio", [0.6, 1.0, 1.4, 1.8])
@pytest.mark.parametrize("other", [1.0, 0.9])
def test_tensions_of_double_bubbles(ratio, other):
    bubble = DoubleBubble(3.0, (1.0, other, ratio), 0.1)
    measured = measure(bubble.mesh(0.4))
    exact = np.array(bubble.tensions) / np.mean(bubble.tensions)
    found = np.array(measured.walls.values("tension"), float)
    np.testing.assert_allclose(found, exact, rtol=0.01)
    errors = np.array(measured.walls.values("tension_se"), float)
    assert ((errors > 0) & (errors < 0.02)).all()
    pressures = np.array(bubble.pressures) / np.mean(bubble.tensions)
    np.testing.assert_allclose(measured.cells.values("pressure_per_um"), pressures, rtol=0.02)


def test_errors_follow_the_scatter_of_angles():
    angles = DoubleBubble(1.0, (1.0, 0.8, 1.2)).angles
    rng = np.random.default_rng(1)
    spread, length = 6.0, 9.0  # nine independent stretches: the mean is off by 2 degrees
    drawn = []
    for _ in range(300):
        noise = rng.normal(0, 2.0, 3)
        one = junction((0, 1, 2), angles + noise - noise.mean(), spread, length)
        found = relative_tensions([one], WALLS)
        drawn.append([(found[w].value, found[w].error) for w in WALLS])
    values, errors = np.moveaxis(np.array(drawn), 2, 0)
    ratio = values.std(0) / errors.mean(0)
    assert ((ratio > 0.5) & (ratio < 1.5)).all(), ratio


def test_junctions_that_agree_are_averaged_by_their_errors():
    right = DoubleBubble(1.0, (1.0, 1.0, 1.2)).angles
    wrong = DoubleBubble(1.0, (1.0, 1.0, 0.8)).angles
    sure = junction((0, 1, 2), right, 1.0)
    unsure = junction((0, 1, 2), wrong, 30.0)
    found = relative_tensions([sure, unsure], WALLS)
    exact = np.array([1.0, 1.0, 1.2]) / np.mean([1.0, 1.0, 1.2])
    np.testing.assert_allclose([found[w].value for w in WALLS], exact, rtol=0.02)
    alone = relative_tensions([sure], WALLS)
    assert found[(2, 1)].error > alone[(2, 1)].error  # they contradict each other


def test_each_cluster_has_a_mean_of_one():
    one, other = (
        junction((0, 1, 2), DoubleBubble(1.0, (1.0, 1.0, 1.5)).angles),
        junction((3, 4, 5), DoubleBubble(1.0, (2.0, 2.0, 2.0)).angles),
    )
    walls = [*walls_around(one.regions), *walls_around(other.regions), (9, 0)]
    found = relative_tensions([one, other], walls)
    for each in (one, other):
        assert np.mean([found[w].value for w in walls_around(each.regions)]) == pytest.approx(1)
    assert found[(9, 0)] == Estimate(reason="no junction whose angles could be measured")


def test_angles_that_no_tensions_explain_are_told():
    found = relative_tensions([junction((0, 1, 2), (20, 20, 320))], WALLS)
    assert any("contradict" in e.reason and e.value is None for e in found.values())


def test_scattered_angles_determine_nothing():
    found = relative_tensions([junction((0, 1, 2), (120, 120, 120), 80.0, 0.5)], WALLS)
    assert {e.reason for e in found.values()} == {"angles do not determine its tension"}


def test_too_many_walls_are_not_solved_for():
    found = relative_tensions(
        [junction((0, 1, 2), (120, 120, 120))], WALLS, settings=TensionSettings(most_walls=2)
    )
    assert all("more than 2 walls" in e.reason for e in found.values())


def test_settings_are_positive():
    with pytest.raises(InputError, match="positive"):
        TensionSettings(angle_error=0.0)


def test_cells_that_no_measured_wall_joins_to_the_outside_have_no_pressure():
    tensions = {(2, 1): Estimate(1.0, 0.1), (3, 0): Estimate(1.0, 0.1)}
    found = relative_pressures(
        tensions, {(2, 1): 0.1, (3, 0): 0.2}, {(2, 1): 1.0, (3, 0): 1.0}, [1, 2, 3, 4]
    )
    assert found[1].reason == found[2].reason == "no measured walls lead to the outside"
    assert found[3].value == pytest.approx(0.4)
    assert found[3].error == pytest.approx(0.04)
    assert found[4].reason == "tension and curvature are not both known for any of its walls"
