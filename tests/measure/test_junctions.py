"""Angles along junctions."""

import numpy as np
import pytest
from benchmarks.joined_spheres import joined_spheres

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.measure import junction_angles

CENTER = (3.0, -2.0, 7.0)


def angles_of(radii: tuple[float, float], distance: float) -> list[float]:
    """Openings of the outside, region 1 and region 2, from the law of cosines."""
    a, b = radii
    at_rim = np.degrees(np.arccos((a**2 + b**2 - distance**2) / (2 * a * b)))
    wall = (distance**2 + a**2 - b**2) / (2 * distance)
    first = 90 + np.degrees(np.arcsin(wall / a))
    second = 90 + np.degrees(np.arcsin((distance - wall) / b))
    assert first + second == pytest.approx(180 + at_rim)
    return [360 - first - second, first, second]


@pytest.mark.parametrize(
    ("radii", "distance"), [((5.0, 5.0), 5.0), ((5.0, 4.0), 6.0), ((5.0, 5.0), 8.0)]
)
def test_angles_of_spheres_that_share_a_wall(radii, distance):
    mesh = joined_spheres(CENTER, radii, distance, edge_length=0.5)
    (junction,) = junction_angles(mesh)
    assert junction.regions == (0, 1, 2)
    np.testing.assert_allclose(junction.angles, angles_of(radii, distance), atol=2.0)
    assert junction.angles.sum() == pytest.approx(360)
    wall = (distance**2 + radii[0] ** 2 - radii[1] ** 2) / (2 * distance)
    assert junction.length == pytest.approx(2 * np.pi * np.sqrt(radii[0] ** 2 - wall**2), rel=0.02)


def test_noise_of_the_vertices_spreads_the_angles_but_does_not_shift_them():
    mesh = joined_spheres(CENTER, (5.0, 5.0), 5.0, edge_length=0.5)
    rng = np.random.default_rng(0)
    v = mesh.vertices_numpy()
    (still,) = junction_angles(mesh)
    found = [
        junction_angles(mesh.with_vertices(v + rng.normal(0, 0.05, v.shape)))[0] for _ in range(5)
    ]
    assert min(j.spread.max() for j in found) > 2 * still.spread.max()
    np.testing.assert_allclose(np.mean([j.angles for j in found], 0), still.angles, atol=1.5)


def test_every_junction_of_a_foam_has_its_three_regions():
    centers = np.array([[0.0, 0, 0], [0, 0, 5], [0, 4.3, 2.5]])
    found = junction_angles(foam(centers, np.full(3, 4.0), 0.6))
    assert [j.regions for j in found] == [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    for junction in found:
        assert junction.angles.sum() == pytest.approx(360)
        np.testing.assert_allclose(junction.angles, 120, atol=20)  # of voxels, so not exact


def test_cells_that_do_not_touch_have_no_junction():
    assert junction_angles(sphere((0, 0, 0), 5)) == []


def test_the_reach_is_a_length():
    with pytest.raises(InputError, match="positive"):
        junction_angles(sphere((0, 0, 0), 5), reach=0)


def test_spheres_that_do_not_meet_are_refused():
    with pytest.raises(InputError, match="meet in a circle"):
        joined_spheres(CENTER, (1.0, 1.0), 3.0, edge_length=0.2)
