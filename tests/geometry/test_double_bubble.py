"""Double bubbles: the laws that they are made to obey, and meshes of them."""

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble

from napari_deltamic.errors import InputError

BUBBLES = [
    ((1.0, 1.0, 1.0), 0.0),
    ((1.0, 1.0, 1.8), 0.0),
    ((1.0, 0.8, 0.7), 0.2),
    ((1.0, 1.3, 0.6), -0.25),
]


@pytest.mark.parametrize(("tensions", "tilt"), BUBBLES)
def test_forces_balance_along_the_rim(tensions, tilt):
    bubble = DoubleBubble(4.0, tensions, tilt)
    outside, first, second = np.radians(bubble.angles)
    assert outside + first + second == pytest.approx(2 * np.pi)
    # Lami: each tension is to the sine of the opening opposite to its wall as every other.
    opposite = np.sin([second, first, outside])
    np.testing.assert_allclose(np.array(tensions) / opposite, tensions[0] / opposite[0])


@pytest.mark.parametrize(("tensions", "tilt"), BUBBLES)
def test_pressures_obey_laplace_across_every_wall(tensions, tilt):
    bubble = DoubleBubble(4.0, tensions, tilt)
    one, two = bubble.pressures
    assert two - one == pytest.approx(2 * tensions[2] * bubble.curvatures[2], abs=1e-12)
    assert (tilt == 0) == (one == pytest.approx(two) and tensions[0] == tensions[1])


def test_equal_tensions_without_tilt_are_the_bubble_of_equal_spheres():
    bubble = DoubleBubble(4.0, (1.0, 1.0, 1.0))
    radius = 4.0 / np.cos(np.pi / 6)  # the wall is half a radius from each centre
    np.testing.assert_allclose(bubble.curvatures, [1 / radius, 1 / radius, 0], atol=1e-15)
    np.testing.assert_allclose(bubble.volumes, 2 * [9 / 8 * np.pi * radius**3])
    np.testing.assert_allclose(bubble.areas, [3 * np.pi * radius**2] * 2 + [np.pi * 16])


@pytest.mark.parametrize(("tensions", "tilt"), BUBBLES)
def test_meshes_have_its_volumes_and_areas(tensions, tilt):
    bubble = DoubleBubble(2.0, tensions, tilt)
    mesh = bubble.mesh(0.4)
    assert mesh.is_closed()
    found = list(mesh.volumes().values())
    # Chords lie inside of arcs.
    np.testing.assert_allclose(found, bubble.volumes, rtol=0.04)
    pairs, wall = mesh.interfaces()
    assert pairs.tolist() == [[1, 0], [2, 0], [2, 1]]
    np.testing.assert_allclose(np.bincount(wall, mesh.areas()), bubble.areas, rtol=0.03)


@pytest.mark.parametrize(
    ("rim", "tensions", "tilt", "says"),
    [
        (4.0, (1.0, 1.0, 2.0), 0.0, "cannot balance"),
        (4.0, (1.0, -1.0, 1.0), 0.0, "cannot balance"),
        (0.0, (1.0, 1.0, 1.0), 0.0, "must be positive"),
        (4.0, (1.0, 1.0, 1.0), 2.5, "inside out"),
    ],
)
def test_bubbles_that_cannot_be_are_refused(rim, tensions, tilt, says):
    with pytest.raises(InputError, match=says):
        DoubleBubble(rim, tensions, tilt)


def test_edges_longer_than_the_rim_are_refused():
    with pytest.raises(InputError, match="half the rim"):
        DoubleBubble(1.0, (1.0, 1.0, 1.0)).mesh(2.0)
