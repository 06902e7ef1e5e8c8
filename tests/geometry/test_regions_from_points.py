"""Regions found from points in images of membranes."""

from __future__ import annotations

import numpy as np
import pytest
from membranes import (
    CENTER,
    SHAPE,
    SIZE,
    Float,
    ball,
    coordinates,
    membrane,
    noisy,
    overlap,
    sausage,
)

from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry.seed_points import labels_from_points


@pytest.mark.parametrize("noise", [0.0, 30.0, 150.0])
def test_region_ends_on_the_membrane(noise: float) -> None:
    distance = ball(CENTER, 2.5)
    labels = labels_from_points(noisy(membrane(distance), noise), SIZE, [CENTER])
    assert labels.dtype == np.int32
    assert labels.shape == SHAPE
    assert overlap(labels == 1, distance < 0) > (0.93 if noise < 100 else 0.85)


def test_origin_moves_points() -> None:
    image, origin = noisy(membrane(ball(CENTER, 2.0))), (10.0, -20.0, 30.0)
    moved = labels_from_points(image, SIZE, [np.add(CENTER, origin)], origin)
    assert np.array_equal(moved, labels_from_points(image, SIZE, [CENTER]))


def test_one_side_five_times_brighter() -> None:
    distance = ball(CENTER, 2.5)
    side = np.clip((coordinates()[..., 2] - 2) / 5.5, 0, 1)
    image = noisy(membrane(distance, 300 + 1200 * side, haze=60))
    assert overlap(labels_from_points(image, SIZE, [CENTER]) == 1, distance < 0) > 0.93


def test_dim_object_beside_a_bright_one() -> None:
    dim, bright = ball((5, 4.7, 2.5), 1.9), ball((5, 4.7, 6.9), 2.0)
    image = noisy(membrane(dim, 250) + membrane(bright, 3000, haze=300), 20)
    labels = labels_from_points(image, SIZE, [(5, 4.7, 2.5), (5, 4.7, 6.9)])
    assert overlap(labels == 1, dim < 0) > 0.9
    assert overlap(labels == 2, bright < 0) > 0.9


@pytest.mark.parametrize("seeded", [[0], [1], [0, 1], [1, 0]])
def test_touching_objects_do_not_swallow_each_other(seeded: list[int]) -> None:
    centers = [(5.0, 4.7, 2.7), (5.0, 4.7, 6.7)]
    shapes = [ball(center, 2.05) for center in centers]
    image = noisy(sum(membrane(shape) for shape in shapes))
    labels = labels_from_points(image, SIZE, [centers[k] for k in seeded])
    assert labels.max() == len(seeded)
    for name, k in enumerate(seeded, 1):
        assert overlap(labels == name, shapes[k] < 0) > 0.9


@pytest.mark.parametrize("shape", ["ball", "bean"])
def test_every_point_inside_gives_the_same_region(shape: str) -> None:
    bend = np.array([[5, 2.5, 2.5], [5, 6.0, 2.7], [5, 6.6, 6.8]])
    distance = ball(CENTER, 2.5) if shape == "ball" else sausage(bend, 1.5)
    neighbour = membrane(ball((5, 1.2, 8.2), 1.0), 2000)
    image = noisy(membrane(distance, haze=80) + neighbour)
    if shape == "ball":
        steps = np.concatenate([np.eye(3), -np.eye(3)]) * 2.5 / 2
        points = np.concatenate([[CENTER], CENTER + steps])
    else:
        up = np.array([0.7, 0, 0])
        points = np.concatenate([bend, bend[:1] + up, bend[2:] - up])
    first = labels_from_points(image, SIZE, points[:1])
    assert overlap(first == 1, distance < 0) > 0.9
    for point in points[1:]:
        assert np.array_equal(labels_from_points(image, SIZE, [point]), first)


def test_a_weak_wall_divides_only_if_asked() -> None:
    tube = sausage(np.array([[5, 4.7, 2.6], [5, 4.7, 6.8]]), 2.0)
    halves = [(5, 4.7, 3.0), (5, 4.7, 6.5)]
    wall = membrane(np.abs(coordinates()[..., 2] - 4.7)) * (tube < 0)
    image = noisy(np.maximum(membrane(tube), 0.8 * wall), 10)
    labels = labels_from_points(image, SIZE, halves[:1])
    assert overlap(labels == 1, tube < 0) > 0.9
    labels = labels_from_points(image, SIZE, halves)
    right = coordinates()[..., 2] > 4.7
    assert overlap(labels == 1, (tube < 0) & ~right) > 0.9
    assert overlap(labels == 2, (tube < 0) & right) > 0.9
    with pytest.warns(RepairWarning, match="points 1 and 2 lie in the same region"):
        labels = labels_from_points(np.maximum(membrane(tube), 0.3 * wall), SIZE, halves)
    assert overlap(labels == 1, tube < 0) > 0.9
    assert labels.max() == 1


def test_object_cut_by_the_border_is_kept() -> None:
    distance = ball((5, 4.7, 0.3), 2.5)
    labels = labels_from_points(noisy(membrane(distance)), SIZE, [(5, 4.7, 0.8)])
    assert overlap(labels == 1, distance < 0) > 0.9


def test_bright_debris_inside_and_outside() -> None:
    distance = ball(CENTER, 2.8)
    debris = membrane(ball((5, 4.7, 4.2), 0.0), 5000, width=0.25)
    debris = debris + membrane(ball((5, 4.7, 8.2), 0.0), 8000, width=0.3)
    labels = labels_from_points(noisy(membrane(distance) + debris), SIZE, [(5, 4.0, 5.5)])
    assert overlap(labels == 1, distance < 0) > 0.9


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([(-0.5, 1.0, 1.0)], "point 1 .* outside the image"),
        pytest.param([(5.0, 4.7, 7.3)], "point 1 lies in no closed region", marks=pytest.mark.slow),
        ([(5.0, 4.7)], "points must be"),
        (np.zeros((0, 3)), "points must be"),
        ([(np.nan, 0.0, 0.0)], "point 1 .* a coordinate is not finite"),
    ],
)
def test_points_that_cannot_be_used(points: object, message: str) -> None:
    image = noisy(membrane(ball(CENTER, 2.5)))
    with pytest.raises(InputError, match=message) as caught:
        labels_from_points(image, SIZE, points)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("point", "message"),
    [
        ((5.0, 4.7, 20.0), r"point 2 \(5, 4.7, 20 um\) lies outside the image"),
        ((5.0, 5.5, 5.5), "points 1 and 2 lie in the same region"),
        (CENTER, "points 1 and 2 lie in the same region"),
        ((1.0, 1.0, 1.0), "point 2 lies in no closed region"),
    ],
)
def test_a_point_that_cannot_be_used_leaves_the_others_as_they_are(
    point: tuple[float, ...], message: str
) -> None:
    image = noisy(membrane(ball(CENTER, 2.5)))
    with pytest.warns(RepairWarning, match=f"1 of 2 points is left out: {message}"):
        labels = labels_from_points(image, SIZE, [CENTER, point])
    assert np.array_equal(labels, labels_from_points(image, SIZE, [CENTER]))


@pytest.mark.parametrize(
    ("image", "size", "message"),
    [
        (np.zeros((5, 5)), SIZE, "finite 3D array"),
        (np.full((5, 5, 5), np.nan), SIZE, "finite 3D array"),
        (np.ones((5, 5, 5)), SIZE, "same value everywhere"),
        (np.eye(25).reshape(25, 5, 5), (1, 1), "voxel size"),
        (np.eye(25).reshape(25, 5, 5), (1, 0, 1), "voxel size"),
    ],
)
def test_images_that_cannot_be_used(image: Float, size: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        labels_from_points(image, size, [(0, 0, 0)])  # type: ignore[arg-type]


@pytest.mark.slow
def test_slab_on_the_border_is_refused() -> None:
    # A dark slab that ends on five sides of the image is no object.
    wall = np.abs(coordinates()[..., 0] - 1.5)
    with pytest.raises(InputError, match="point 1"):
        labels_from_points(noisy(membrane(wall)), SIZE, [(0.6, 4.7, 4.7)])
