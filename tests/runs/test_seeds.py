"""Kinds of seeds: each makes surfaces, and what it saves makes the same again."""

import numpy as np
import pytest
import tifffile

import napari_deltamic as nd
from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.runs.seeds import (
    FoundSeeds,
    LabelSeeds,
    MeshSeeds,
    PointSeeds,
    mixed,
    seeds_of,
)

GRID = nd.Grid((20, 24, 24), (0.3, 0.2, 0.2))
CENTER = (2.9, 2.3, 2.3)


@pytest.fixture(scope="module")
def image():
    """One cell, bright on its membrane."""
    truth = sphere(CENTER, 1.3, edge_length=0.3)
    rendered = nd.render(truth, GRID, nd.GaussianPSF((0.36, 0.24, 0.24))).numpy()
    return 100 + 400 * rendered / rendered.max()


def labels():
    z, y, x = np.indices(GRID.shape) * np.reshape(GRID.voxel_size, (3, 1, 1, 1))
    inside = (z - CENTER[0]) ** 2 + (y - CENTER[1]) ** 2 + (x - CENTER[2]) ** 2 < 1.2**2
    return 7 * inside.astype(np.uint8)


KINDS = {
    "points": (PointSeeds(np.array([CENTER]), None), "image"),
    "spheres": (PointSeeds(np.array([CENTER]), np.array([1.1])), "rough"),
    "labels": (LabelSeeds(labels()), "labels"),
    "mesh": (MeshSeeds(sphere(CENTER, 1.1, edge_length=0.4)), "rough"),
    "found": (FoundSeeds(2.4), "labels"),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_kind_makes_a_closed_surface_and_saves_itself(name, image, tmp_path):
    seeds, kind = KINDS[name]
    mesh = seeds.make(image, GRID)
    assert mesh.is_closed()
    assert 2 < mesh.region_volume(int(mesh.region_ids()[0])) < 14  # 9.2 um^3 inside the membrane
    assert seeds.kind == kind
    again = seeds_of(str(seeds.save(tmp_path, image, GRID)))
    np.testing.assert_allclose(again.make(image, GRID).bounds(), mesh.bounds(), atol=0.01)


def test_a_points_layer_that_napari_saved_is_in_voxels(image, tmp_path):
    path = tmp_path / "points.csv"
    place = (np.array(CENTER) - GRID.origin) / GRID.voxel_size
    path.write_text("index,axis-0,axis-1,axis-2,label\n0,{},{},{},cell\n\n".format(*place))
    seeds, same = seeds_of(str(path)), KINDS["points"][0]
    expected = same.make(image, GRID).bounds()
    np.testing.assert_allclose(seeds.make(image, GRID).bounds(), expected, atol=1e-6)
    again = seeds_of(str(seeds.save(tmp_path, image, GRID)))
    np.testing.assert_allclose(again.points, [CENTER], rtol=1e-12)
    assert not again.in_voxels
    assert seeds.kind == "image"
    both = mixed([same, seeds])  # numbers of voxels and um stay apart
    assert len(both.parts) == 2


def test_of_a_mixture_all_parts_are_there(image):
    apart = MeshSeeds(sphere((2.9, 1.0, 4.2), 0.4, edge_length=0.2))
    both = mixed([KINDS["spheres"][0], apart])
    assert len(both.make(image, GRID).region_ids()) == 2
    assert both.kind == "rough"
    assert mixed([apart]) is apart


def test_auto_looks_for_cells(image):
    seeds = seeds_of("auto")
    assert isinstance(seeds, FoundSeeds)
    assert seeds.path == "auto"
    found = seeds.labels(image, GRID)
    at = tuple(np.round(np.array(CENTER) / GRID.voxel_size).astype(int))
    assert found[at] > 0


def nuclei_and_membranes(path, image):
    z, y, x = np.indices(GRID.shape) * np.reshape(GRID.voxel_size, (3, 1, 1, 1))
    away = np.sqrt((z - CENTER[0]) ** 2 + (y - CENTER[1]) ** 2 + (x - CENTER[2]) ** 2)
    nuclei = np.random.default_rng(1).poisson(5 + 100 / (1 + np.exp(8 * (away - 0.6))))
    both = np.stack([np.asarray(image), nuclei], axis=1).astype(np.float32)
    tifffile.imwrite(path, both, imagej=True, metadata={"axes": "ZCYX"})
    return nuclei.astype(np.float32)


@pytest.mark.parametrize("told", ["auto@2", "auto@2:1.2"])
def test_nuclei_of_another_channel_mark_the_cells(image, tmp_path, told):
    nuclei = nuclei_and_membranes(tmp_path / "two.tif", image)
    seeds = seeds_of(told, str(tmp_path / "two.tif"))
    marks = seeds.labels(image, GRID)
    np.testing.assert_array_equal(marks, FoundSeeds(seeds.size).labels(nuclei, GRID))
    assert seeds.size == (1.2 if ":" in told else None)
    with pytest.warns(RepairWarning, match="lies well inside what the image shows"):
        mesh = seeds.make(image, GRID)
    (volume,) = mesh.volumes().values()
    assert 5 < volume < 12  # 9.2 um^3 inside the membrane
    assert (marks > 0).sum() * np.prod(GRID.voxel_size) < 2


@pytest.mark.parametrize(
    ("told", "file", "words"),
    [
        ("auto@", "two.tif", "which channel of the image"),
        ("auto@2", "", "which channel of the image"),
        ("auto@2:x", "two.tif", "'x' is not a cell size"),
        ("auto@3", "two.tif", "3"),
        ("auto@1", "other.tif", "the nuclei have shape"),
    ],
)
def test_a_channel_of_nuclei_that_cannot_be_used(image, tmp_path, told, file, words):
    nuclei_and_membranes(tmp_path / "two.tif", image)
    write_image(tmp_path / "other.tif", np.ones((4, 4, 4), np.float32), GRID.voxel_size)
    with pytest.raises(InputError, match=words):
        seeds_of(told, file and str(tmp_path / file)).make(image, GRID)


def test_padding_around_nuclei_is_no_cell(image, tmp_path):
    nuclei = nuclei_and_membranes(tmp_path / "two.tif", image)
    both = np.stack([image, 100 + nuclei], axis=1).astype(np.float32)
    both[:6] = 0
    tifffile.imwrite(tmp_path / "two.tif", both, imagej=True, metadata={"axes": "ZCYX"})
    marks = seeds_of("auto@2", str(tmp_path / "two.tif")).labels(image, GRID)
    assert marks.max() == 1
    assert (marks > 0).sum() * np.prod(GRID.voxel_size) < 2


def test_labels_beside_other_seeds_stay_as_they_are(image):
    """They know nothing of the ground of the others."""
    marks = LabelSeeds(3 * (np.indices(GRID.shape).sum(0) == 33).astype(np.uint8))
    marks.labels[8:12, 10:14, 10:14] = 3
    (labels,) = [
        part for part in mixed([marks, KINDS["spheres"][0]]).parts if part.kind == "labels"
    ]
    assert not labels.marks
    assert mixed([marks]).marks


def test_what_is_no_file_of_seeds(tmp_path):
    with pytest.raises(InputError, match=r"unknown extension '\.doc'.*or auto"):
        seeds_of(str(tmp_path / "seeds.doc"))
    with pytest.raises(InputError, match="shape"):
        LabelSeeds(np.ones((2, 2, 2), int)).make(np.zeros(GRID.shape), GRID)


def test_large_labels_are_saved(tmp_path):
    seeds = LabelSeeds(70_000 * labels().astype(np.int32))
    path = seeds.save(tmp_path, np.zeros(GRID.shape), GRID)
    np.testing.assert_array_equal(read_image(path)[0], seeds.labels)
