"""Seeds: regions found from points, surfaces made from regions, spheres, point files."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import ndimage

from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry.labels import basins
from napari_deltamic.geometry.labels.meshes import mesh_from_labels
from napari_deltamic.geometry.mesh import Mesh
from napari_deltamic.geometry.seeds import (
    labels_from_points,
    read_points_csv,
    seeds_from_points,
)
from napari_deltamic.measure.ridge import ridge_distance

Float = NDArray[np.float64]
SIZE = np.array([0.3, 0.15, 0.15])
SHAPE = (34, 64, 64)
POINTS = Path(__file__).parents[2] / "benchmarks" / "data_points" / "vesicles_GUV.csv"


def coordinates(shape: tuple[int, ...] = SHAPE) -> Float:
    return np.stack(np.indices(shape), axis=-1) * SIZE


def ball(center: tuple[float, ...], radius: float) -> Float:
    """Signed distance, negative inside."""
    return np.linalg.norm(coordinates() - center, axis=-1) - radius


def sausage(points: Float, radius: float) -> Float:
    """Signed distance to a tube around a polyline."""
    x = coordinates()
    best = np.full(SHAPE, np.inf)
    for a, b in pairwise(points):
        t = np.clip(((x - a) @ (b - a)) / ((b - a) @ (b - a)), 0, 1)
        best = np.minimum(best, np.linalg.norm(x - a - t[..., None] * (b - a), axis=-1))
    return best - radius


def membrane(
    distance: Float, brightness: Float | float = 1000.0, haze: float = 0.0, width: float = 0.2
) -> Float:
    """A blurred shell; `haze` is added inside."""
    return brightness * np.exp(-0.5 * (distance / width) ** 2) + haze * (distance < 0)


def noisy(image: Float, noise: float = 30.0) -> Float:
    return image + 100 + np.random.default_rng(0).normal(0, noise, image.shape)


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    return float((a & b).sum() / (a | b).sum())


def smallest_angles(mesh: Mesh) -> Float:
    surface = trimesh.Trimesh(mesh.vertices[:, ::-1], mesh.faces, process=False)
    return np.degrees(surface.face_angles).min(axis=1)


def check_surface(mesh: Mesh, euler: int = 2) -> trimesh.Trimesh:
    surface = trimesh.Trimesh(mesh.vertices[:, ::-1], mesh.faces, process=False)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.euler_number == euler
    assert surface.volume > 0
    assert np.bincount(surface.faces_unique_edges.ravel()).max() == 2
    return surface


CENTER = (5.0, 4.7, 4.8)


# Labels ---------------------------------------------------------------------------------------


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
    with pytest.raises(InputError, match="points 1 and 2 lie in the same region"):
        labels_from_points(np.maximum(membrane(tube), 0.3 * wall), SIZE, halves)


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
        ([CENTER, (5.0, 4.7, 20.0)], r"point 2 \(5, 4.7, 20 um\) lies outside the image"),
        ([(-0.5, 1.0, 1.0)], "point 1 .* outside the image"),
        ([CENTER, (5.0, 5.5, 5.5)], "points 1 and 2 lie in the same region"),
        ([CENTER, CENTER], "points 1 and 2 lie in the same region"),
        ([CENTER, (1.0, 1.0, 1.0)], "point 2 lies in no closed region"),
        ([(5.0, 4.7, 7.3)], "point 1 lies in no closed region"),
        ([(5.0, 4.7)], "points must be"),
        (np.zeros((0, 3)), "points must be"),
        ([(np.nan, 0.0, 0.0)], "points must be"),
    ],
)
def test_points_that_cannot_be_used(points: object, message: str) -> None:
    image = noisy(membrane(ball(CENTER, 2.5)))
    with pytest.raises(InputError, match=message) as caught:
        labels_from_points(image, SIZE, points)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


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


def test_slab_on_the_border_is_refused() -> None:
    # A dark slab that ends on five sides of the image is no object.
    wall = np.abs(coordinates()[..., 0] - 1.5)
    with pytest.raises(InputError, match="point 1"):
        labels_from_points(noisy(membrane(wall)), SIZE, [(0.6, 4.7, 4.7)])


# Surfaces -------------------------------------------------------------------------------------


@pytest.mark.parametrize("edge", [0.25, 0.45, 0.8])
def test_ball_surface(edge: float) -> None:
    mesh = mesh_from_labels((ball(CENTER, 2.5) < 0).astype(int) * 3, SIZE, edge_length=edge)
    surface = check_surface(mesh)
    assert mesh.region_ids().tolist() == [3]
    off = np.linalg.norm(mesh.vertices - CENTER, axis=1) - 2.5
    # A coarse mesh of the right volume has its vertices a little outside.
    assert np.abs(off).mean() < max(0.03, 0.05 * edge)
    assert surface.edges_unique_length.mean() == pytest.approx(edge, rel=0.1)
    assert (smallest_angles(mesh) > 25).mean() > 0.99
    assert mesh.region_volume(3) == pytest.approx(4 / 3 * np.pi * 2.5**3, rel=0.03)


def test_origin_moves_the_surface() -> None:
    labels = (ball(CENTER, 2.0) < 0).astype(np.uint8)
    here, there = mesh_from_labels(labels, SIZE), mesh_from_labels(labels, SIZE, (1, 2, 3))
    assert np.allclose(there.vertices - here.vertices, [1, 2, 3])


def test_holes_and_crumbs_go_and_the_border_is_closed() -> None:
    labels = ((ball((5, 4.7, 1.0), 2.5) < 0) & (ball((5, 4.7, 1.0), 0.7) > 0)).astype(int)
    labels[1:3, 2:5, 55:60] = 1
    with pytest.warns(RepairWarning, match="label 1: "):
        mesh = mesh_from_labels(labels, SIZE)
    surface = check_surface(mesh)
    assert surface.bounds[0][0] == pytest.approx(-SIZE[2] / 2, abs=0.1)
    assert surface.bounds[1][0] < 4


def test_touching_labels_may_have_surfaces_of_their_own() -> None:
    labels = np.zeros(SHAPE, int)
    inside = ball(CENTER, 2.5) < 0
    right = coordinates()[..., 2] > 4.8
    labels[inside & ~right], labels[inside & right] = 2, 7
    mesh = mesh_from_labels(labels, SIZE, shared_walls=False)
    assert mesh.region_ids().tolist() == [2, 7]
    assert (mesh.regions[:, 1] == 0).all()
    for region in (2, 7):
        check_surface(mesh.region_surface(region))


def test_ring_keeps_its_hole() -> None:
    z, y, x = np.moveaxis(coordinates() - CENTER, -1, 0)
    ring = np.hypot(np.hypot(y, x) - 2.6, z) < 1.0
    check_surface(mesh_from_labels(ring.astype(int), SIZE, edge_length=0.4), euler=0)


@pytest.mark.filterwarnings("ignore::napari_deltamic.errors.RepairWarning")
def test_random_blobs_are_manifold() -> None:
    random = np.random.default_rng(1)
    for sigma in (1.0, 1.5, 2.5):
        field = ndimage.gaussian_filter(random.normal(size=(20, 40, 40)), sigma)
        mesh = mesh_from_labels((field > 0).astype(int), SIZE, edge_length=0.3)
        surface = trimesh.Trimesh(mesh.vertices[:, ::-1], mesh.faces, process=False)
        assert surface.is_watertight
        assert surface.is_winding_consistent
        assert np.bincount(surface.faces_unique_edges.ravel()).max() == 2


@pytest.mark.parametrize(
    ("labels", "edge", "message"),
    [
        (np.zeros((4, 4, 4), int), None, "no labels"),
        (np.ones((4, 4), int), None, "labels are 2D"),
        (np.full((4, 4, 4), 0.5), None, "not whole numbers"),
        (np.ones((4, 4, 4), int), 0.0, "edge length must be positive"),
        (np.ones((4, 4, 4), int), 1e-4, "edges of 0.0001 um are too short"),
        (np.pad(np.ones((1, 1, 1), int), 4), 50.0, "label 1 is too small for edges of 50 um"),
    ],
)
def test_labels_that_cannot_be_used(
    labels: NDArray[np.int64], edge: float | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        mesh_from_labels(labels, SIZE, edge_length=edge)


# Points and spheres ---------------------------------------------------------------------------


def test_seeds_from_points_and_radii() -> None:
    centers = [(5.0, 4.7, 2.5), (5.0, 4.7, 7.0)]
    image = noisy(sum(membrane(ball(center, 1.9)) for center in centers))
    mesh = seeds_from_points(image, SIZE, centers, [0.8, np.nan], edge_length=0.3)
    assert mesh.region_ids().tolist() == [1, 2]
    assert mesh.region_volume(1) == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=0.1)
    assert mesh.region_volume(2) == pytest.approx(4 / 3 * np.pi * 1.9**3, rel=0.1)
    assert mesh.is_closed()
    surface = mesh.region_surface(2)
    assert np.abs(surface.vertices.mean(axis=0) - centers[1]).max() < 0.15


def test_all_radii_need_no_membranes() -> None:
    image = np.random.default_rng(0).normal(size=SHAPE)
    mesh = seeds_from_points(image, SIZE, [CENTER, (5, 4.7, 8.0)], [1.0, 0.5])
    assert mesh.region_ids().tolist() == [1, 2]


def test_seed_errors_name_the_point_as_given() -> None:
    image = noisy(membrane(ball(CENTER, 2.5)))
    points = [(5, 4.7, 8.5), CENTER, (1.0, 1.0, 1.0)]
    with pytest.raises(InputError, match="point 3 lies in no closed region"):
        seeds_from_points(image, SIZE, points, [0.5, 0, 0])
    with pytest.raises(InputError, match="point 2: radius -1"):
        seeds_from_points(image, SIZE, points, [0.5, -1, 0])
    with pytest.raises(InputError, match="3 points need as many radii, not 2"):
        seeds_from_points(image, SIZE, points, [0.5, 1])


def test_read_points(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("z,y,x\n1,2,3\n\n 4.5 , 5 , 6e0\n")
    points, radii = read_points_csv(path)
    assert points.tolist() == [[1, 2, 3], [4.5, 5, 6]]
    assert radii is None
    path.write_text("\ufeffZ,Y,X,radius\n1,2,3,0.5\n1,2,4,\n", encoding="utf-8")
    points, radii = read_points_csv(str(path))
    assert points.shape == (2, 3)
    assert radii is not None
    assert radii[0] == 0.5
    assert np.isnan(radii[1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "first line must be"),
        ("x,y,z\n1,2,3\n", "first line must be"),
        ("z,y,x\n", "no points"),
        ("z,y,x\n1,2\n", "line 2: 2 fields instead of 3"),
        ("z,y,x\n1,2,three\n", "line 2: .*three"),
        ("z,y,x\n1,2,nan\n", "line 2: a coordinate is not finite"),
    ],
)
def test_bad_point_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_points_csv(path)
    assert "\n" not in str(caught.value)


def test_missing_point_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read points"):
        read_points_csv(tmp_path / "absent.csv")


# A real image ---------------------------------------------------------------------------------


def test_real_vesicles(shared_data: Path) -> None:
    from tifffile import imread

    image, size = imread(shared_data / "images" / "vesicles_GUV.tif"), (0.34, 0.133, 0.133)
    points, radii = read_points_csv(POINTS)
    with POINTS.open() as lines:
        assert next(csv.reader(lines)) == ["z", "y", "x"]
    mesh = seeds_from_points(image, size, points, radii)
    assert mesh.region_ids().tolist() == [1, 2, 3]
    for region in (1, 2, 3):
        surface = mesh.region_surface(region)
        check_surface(surface)
        distance = ridge_distance(surface, image, size).summary()
        assert distance["lateral_voxels"] < 0.6
        assert distance["fraction_without_ridge"] < 0.1
        assert (smallest_angles(surface) > 25).mean() > 0.97
    # Shifted by a quarter of its extent, each point still names the same region.
    shifted = points + np.array([[1.4, 0, 0], [0, 2.0, 0], [0, 0.6, 0]])
    again = seeds_from_points(image, size, shifted)
    assert np.array_equal(again.faces, mesh.faces)
    assert np.array_equal(again.vertices, mesh.vertices)


def test_the_next_point_in_the_same_image_is_quick(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    make = basins._new_tree
    monkeypatch.setattr(basins, "_new_tree", lambda *a: made.append(1) or make(*a))
    one, two = (5.0, 4.7, 2.7), (5.0, 4.7, 6.7)
    image = noisy(membrane(ball(one, 1.7)) + membrane(ball(two, 1.7)))
    first = labels_from_points(image, SIZE, [one])
    both = labels_from_points(image, SIZE, [one, two])
    assert len(made) == 1
    assert np.array_equal(both == 1, first == 1)
    labels_from_points(image + 50 * (image > 900), SIZE, [one])
    assert len(made) == 2
