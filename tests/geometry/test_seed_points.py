"""Seeds: regions found from points, surfaces made from regions, spheres, point files."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from benchmarks.ridge import ridge_distance
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
)
from numpy.typing import NDArray
from scipy import ndimage

from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry.labels import basins
from napari_deltamic.geometry.labels.meshes import MOST_FACES, mesh_from_labels
from napari_deltamic.geometry.mesh import Mesh
from napari_deltamic.geometry.seed_points import (
    labels_from_points,
    read_napari_points,
    read_points_csv,
    seeds_from_points,
)

POINTS = Path(__file__).parents[2] / "benchmarks" / "data_points" / "vesicles_GUV.csv"


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
        (np.pad(np.ones((4, 4, 4), int), 2), 0.0, "edge length must be positive"),
        (np.pad(np.ones((4, 4, 4), int), 2), 1e-4, "edges of 0.0001 um are too short"),
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


@pytest.mark.slow
def test_seed_errors_name_the_point_as_given() -> None:
    image = noisy(membrane(ball(CENTER, 2.5)))
    points = [(5, 4.7, 8.5), CENTER, (1.0, 1.0, 1.0)]
    with pytest.warns(RepairWarning) as caught:
        mesh = seeds_from_points(image, SIZE, points, [0.5, 0, 0])
    assert str(caught[0].message).startswith(
        "1 of 3 points is left out: point 3 lies in no closed region"
    )
    assert mesh.region_ids().tolist() == [1, 2]
    with pytest.raises(InputError, match="3 points need as many radii, not 2"):
        seeds_from_points(image, SIZE, points, [0.5, 1])


def test_all_bad_points_are_named_at_once_and_the_rest_go_on() -> None:
    centers = [(5.0, 4.7, 2.5), (5.0, 4.7, 7.0)]
    image = noisy(sum(membrane(ball(center, 1.9)) for center in centers))
    points = [
        (5, 4.7, 30), centers[0], (np.nan, 1, 1), (5, 4.7, 2.9), (1, 1, 1), centers[1],
        (5, 4.7, 6.8), (5, 4.7, 6.9),
    ]  # fmt: skip
    radii = [np.nan, np.nan, np.nan, np.nan, np.nan, 1.5, 0.3, -1]
    with pytest.warns(RepairWarning) as caught:
        mesh = seeds_from_points(image, SIZE, points, radii)
    assert mesh.region_ids().tolist() == [2, 6]
    assert len(caught) == 1
    told = str(caught[0].message)
    assert "\n" not in told
    assert told.startswith("6 of 8 points are left out: point 1 (5, 4.7, 30 um) lies outside the")
    reasons = [
        "point 3 (nan, 1, 1 um): a coordinate is not finite",
        "points 2 and 4 lie in the same region",
        "point 5 lies in no closed region",
        "the sphere of point 7 lies wholly inside others",
        "point 8: radius -1 is not a length",
    ]
    assert [told.count(reason) for reason in reasons] == [1] * 5


@pytest.mark.slow
def test_points_of_which_none_can_be_used_are_all_named() -> None:
    image = noisy(membrane(ball(CENTER, 2.5)))
    with pytest.raises(InputError, match=r"^point 1 .* outside the image; point 2 lies in no clos"):
        seeds_from_points(image, SIZE, [(5, 4.7, 30), (1, 1, 1)])


def test_all_small_labels_are_named_at_once_and_the_rest_go_on() -> None:
    labels = (ball(CENTER, 2.5) < 0).astype(int) * 3
    labels[:2, :2, :2], labels[:2, :2, -2:] = 7, 9
    with pytest.warns(RepairWarning) as caught:
        mesh = mesh_from_labels(labels, SIZE, edge_length=0.8)
    assert mesh.region_ids().tolist() == [3]
    assert [str(w.message) for w in caught] == [
        "2 of 3 labels are left out: label 7 is too small for edges of 0.8 um, likewise 9"
    ]


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
        ("z,y,x\n1,2\n1,2,3\n\n1,2,inf\n", "line 2: 2 fields .*; line 5: a coordinate is not"),
    ],
)
def test_bad_point_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_points_csv(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("index,axis-0,axis-1\n0,1,2\n", "2 coordinates, not Z, Y and X"),
        ("index,axis-0,axis-1,axis-2,axis-3\n0,1,2,3,4\n", "4 coordinates"),
        ("index,axis-0,axis-1,axis-2\n", "no points"),
        ("index,axis-0,axis-1,axis-2\n0,1,2,3\n1,2,3\n", "line 3: .*"),
        ("index,axis-0,axis-1,axis-2\n0,1,two,3\n", "line 2: .*two"),
    ],
)
def test_bad_points_of_napari(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_napari_points(path)


def test_points_of_napari(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("index,axis-0,axis-1,axis-2,size\n0.0,1.5,2,3,10\n1.0,4,5,6,10\n")
    found = read_napari_points(path)
    assert found is not None
    assert found.tolist() == [[1.5, 2, 3], [4, 5, 6]]
    path.write_text("z,y,x\n1,2,3\n")
    assert read_napari_points(path) is None


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


def test_a_tree_tells_of_each_dark_part_how_large_it_is_and_where_it_is_cut():
    ranked = np.random.default_rng(2).integers(0, 6, (5, 6, 7)).astype(np.uint16)
    size = np.array([0.4, 0.2, 0.1])
    tree = basins._new_tree(ranked, size)
    border = basins.border_area(ranked.shape, size)
    nodes = np.flatnonzero(ranked.ravel()[tree.parent] != ranked.ravel())
    assert len(nodes) > 20
    for node in nodes:
        parts, _ = ndimage.label(ranked <= ranked.flat[node])
        part = parts == parts.flat[node]
        assert tree.volume[node] == part.sum()
        assert tree.border[node] == pytest.approx(border[part].sum())
        assert tree.lowest[node] == ranked[part].min()


@pytest.mark.parametrize("radius", [1.7, pytest.param(0.6, marks=pytest.mark.slow)])
def test_blocks_find_the_same_regions(monkeypatch: pytest.MonkeyPatch, radius: float) -> None:
    """Of the smaller ball, blocks are so few that all voxels are flooded after them."""
    made: list[tuple[int, ...]] = []
    make = basins._new_tree
    monkeypatch.setattr(basins, "_new_tree", lambda *a: made.append(a[0].shape) or make(*a))
    image = noisy(membrane(ball((5.0, 4.7, 2.7), radius)) + membrane(ball((5.0, 4.7, 6.7), 1.7)))
    points = [(5.0, 4.7, 2.7), (5.0, 4.7, 6.7)]
    found, trees = {}, {}
    two, four, none = 30_000, 0, 10**9  # voxels of an image from which on there are blocks
    for many in (two, none, four):
        monkeypatch.setattr(basins, "BASINS", replace(basins.BASINS, many=many))
        found[many] = labels_from_points(image, SIZE, points)
        trees[many] = len(made)
    assert made[:3] == [(34, 32, 32), (34, 64, 64), (34, 16, 16)]
    assert trees[two] == (1 if radius > 1 else 2)
    assert trees[none] == 2
    for k in (1, 2):
        assert overlap(found[two] == k, found[none] == k) > 0.97
        assert overlap(found[four] == k, found[none] == k) > 0.97


def test_large_spheres_have_no_more_triangles_than_labels_may():
    """Of planes 50 um apart and voxels of 0.2 um in one of them, one sphere had 2.5 million."""
    image = np.random.default_rng(0).random((30, 30, 40))
    mesh = seeds_from_points(image, (0.3, 0.2, 50.0), [(4.0, 3.0, 1000.0)], [200.0])
    assert 10_000 < len(mesh.faces) < 2 * MOST_FACES
