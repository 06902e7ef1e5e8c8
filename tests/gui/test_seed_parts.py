"""The parts of the seeds panel, without it: files, checks, background work, spheres drawn."""

import gc
import threading
import weakref

import numpy as np
import pytest
from napari.layers import Image, Points

from napari_deltamic import Grid, save_mesh
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import read_points_csv, sphere
from napari_deltamic.gui.cell_source import seeds_from_layer
from napari_deltamic.gui.viewing.cell_layers import load_meshes, surface_layer, unchanged_file
from napari_deltamic.gui.viewing.frame import Frame
from napari_deltamic.gui.work import Background
from napari_deltamic.runs.seed_checks import PointSet, in_one_sphere, of_engine, outside
from napari_deltamic.runs.seed_preview import SMALL, coarsening, coarser, find
from napari_deltamic.runs.seeds import LabelSeeds, MeshSeeds, MixedSeeds, PointSeeds, mixed

from .conftest import CENTER, SHAPE, SIZE


@pytest.fixture
def frame():
    layer = Image(np.zeros(SHAPE), scale=SIZE, translate=(1, 2, 3), units=("um",) * 3)
    return Frame.of(layer)


# Mesh files -----------------------------------------------------------------------------------


def move(layer, path):
    layer.translate = np.add(layer.translate, (0, 0.1, 0))


def stretch(layer, path):
    layer.scale = (1, 1.1, 1)


def edit(layer, path):
    layer.data = (layer.data[0] + 0.1, *layer.data[1:])


def edit_in_place(layer, path):
    layer.data[0][0] += 0.1


def flip(layer, path):
    layer.data = (layer.data[0], layer.data[1][:, ::-1], layer.data[2])


def rewrite(layer, path):
    save_mesh(sphere(CENTER, 0.9), path)


def delete(layer, path):
    path.unlink()


@pytest.mark.parametrize(
    "change", [move, stretch, edit, edit_in_place, flip, rewrite, delete], ids=lambda f: f.__name__
)
def test_the_command_names_a_mesh_file_only_while_it_is_what_the_layer_shows(
    frame, tmp_path, change
):
    path = tmp_path / "start.ply"
    save_mesh(sphere(CENTER, 0.7, edge_length=0.4), path)
    layer = surface_layer(load_meshes([str(path)])[0], frame)
    assert seeds_from_layer(layer, frame, (), spheres=False).path == str(path)
    change(layer, path)
    assert unchanged_file(layer, frame) == ""


def test_a_mesh_file_of_another_image_is_saved_anew(frame, tmp_path):
    path = tmp_path / "start.ply"
    save_mesh(sphere(CENTER, 0.7, edge_length=0.4), path)
    layer = surface_layer(load_meshes([str(path)])[0], frame)
    moved = Frame.of(Image(np.zeros(SHAPE), scale=SIZE, translate=(1, 2, 4), units=("um",) * 3))
    assert unchanged_file(layer, moved) == ""


# Mixed seeds ----------------------------------------------------------------------------------


def test_the_kind_of_mixed_seeds_is_that_of_the_farthest():
    image, rough = PointSeeds(np.ones((1, 3)), None), MeshSeeds(sphere(CENTER, 1.0))
    labels = LabelSeeds(np.ones(SHAPE, int))
    assert mixed([image, labels]).kind == "labels"
    assert mixed([labels, rough, image]).kind == "rough"
    assert mixed([image]) is image
    assert mixed([image, image]).kind == "image"
    assert isinstance(mixed([rough, rough]), MixedSeeds)


def test_points_with_and_without_radius_share_a_table(tmp_path):
    some = PointSeeds(np.array([[1.1, 2, 3]]), None)
    spheres = PointSeeds(np.array([[4, 5, 6.0], [7, 8, 9]]), np.array([0.5, 1 / 3]))
    together = mixed([some, spheres])
    assert together.kind == "rough"
    path = together.save(tmp_path, np.zeros(SHAPE), Grid(SHAPE, SIZE))
    points, radii = read_points_csv(path)
    np.testing.assert_array_equal(points, [[1.1, 2, 3], [4, 5, 6], [7, 8, 9]])
    np.testing.assert_array_equal(radii, [np.nan, 0.5, 1 / 3])


# Checks ---------------------------------------------------------------------------------------


def point_set(points, radii=None, rows=None, several=False):
    points = np.array(points, float)
    rows = np.arange(len(points)) if rows is None else np.array(rows)
    layer = Points(ndim=3, name="p")
    return PointSet(layer, points, None if radii is None else np.array(radii), rows, several)


def test_the_border_voxels_are_inside_the_image():
    edge = (np.array(SHAPE) - 0.51) * SIZE
    assert outside([point_set([edge, [-0.14, -0.09, -0.09]])], SHAPE, SIZE) == []
    [remark] = outside([point_set([(np.array(SHAPE) - 0.49) * SIZE], rows=[4])], SHAPE, SIZE)
    assert remark.text == "Point 5 lies outside the image: move or delete it"
    assert remark.points[0][1] == 4


def test_many_points_are_not_all_named():
    [remark] = outside([point_set(np.full((20, 3), -9.0))], SHAPE, SIZE)
    assert remark.text.startswith("Points 1, 2, 3, 4, 5, 6 and 14 others lie outside")
    assert len(remark.points) == 20


def test_spheres_that_only_touch_are_two_cells():
    apart = point_set([[0, 0, 0], [0, 0, 1.9]], [1.0, 1.0])
    assert in_one_sphere([apart]) == []
    small_in_large = point_set([[0, 0, 0], [0, 0, 1.9]], [2.0, 0.1])
    assert in_one_sphere([small_in_large])[0].text.startswith("Points 1 and 2 are in one sphere")
    assert in_one_sphere([point_set([[0, 0, 0], [0, 0, 0.1]])]) == [], "no spheres"


def test_what_the_engine_says_names_the_points_of_the_layers():
    sets = [point_set([CENTER], rows=[7]), point_set([CENTER, CENTER])]
    said = of_engine(sets, "point 2 lies in no closed region of the image", [2])
    assert said.text == "Point 1 lies in no closed region of the image"
    assert said.points == ((sets[1].layer, 0),)
    assert of_engine(sets, "points 1 and 3 lie in the same region", [1, 3]).text == (
        "Points 8 and 2 are in the same cell: delete one"
    )
    border = of_engine(sets, "the region of point 1 lies mostly on the border of the image", [1])
    assert border.text == "The region of point 8 lies mostly on the border of the image"
    assert of_engine(sets, "the image has the same value everywhere", []).points == ()


# Preview --------------------------------------------------------------------------------------


def test_small_images_are_previewed_as_they_are():
    image = np.zeros(SHAPE, np.float32)
    assert coarser(image, Grid(SHAPE, SIZE))[0] is image


def test_large_images_are_made_coarser_along_short_voxels_first():
    assert coarsening((29, 150, 150), (0.34, 0.133, 0.133)) == (1, 2, 2)
    assert coarsening((100, 100, 100), (0.1, 0.1, 0.1)) == (2, 2, 2)
    grid = Grid((29, 151, 150), (0.34, 0.133, 0.133))
    where = np.indices(grid.shape)[1] * 0.133
    image, coarse = coarser(where, grid)
    assert image.shape == (29, 76, 75)
    assert image.size <= SMALL
    along = coarse.origin[1] + coarse.voxel_size[1] * np.arange(75)
    np.testing.assert_allclose(image[3, :75, 3], along, rtol=1e-5)


def test_previews_of_fine_and_coarse_images_agree(monkeypatch, pixels):
    fine_pixels = np.kron(pixels, np.ones((2, 2, 2)))
    grid = Grid(fine_pixels.shape, tuple(np.divide(SIZE, 2)))
    points = np.array([CENTER, (50, 0, 0)])
    fine = find(points, fine_pixels, grid)
    monkeypatch.setattr("napari_deltamic.gui.seeding.preview.SMALL", fine_pixels.size - 1)
    rough = find(points, fine_pixels, grid)
    assert rough.problems == fine.problems == ()
    volumes = [found.mesh.region_volume(1) for found in (rough, fine)]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.2)
    middles = [found.mesh.bounds().mean(axis=0) for found in (rough, fine)]
    np.testing.assert_allclose(middles[0], middles[1], atol=0.1)


def test_a_preview_without_any_good_point(pixels):
    found = find(np.array([(50.0, 0, 0)]), pixels, Grid(SHAPE, SIZE))
    assert found.mesh is None
    found = find(np.array([(0.1, 0.1, 0.1)]), pixels, Grid(SHAPE, SIZE))
    assert found.mesh is None
    assert found.problems[0][1] == (1,)


# Background -----------------------------------------------------------------------------------


def test_of_works_in_the_background_the_last_counts(app, spin):
    results, errors, ran, gate = [], [], [], threading.Event()

    def work(k):
        def run():
            ran.append(k)
            assert gate.wait(20)
            return k

        return run

    background = Background(errors.append)
    for k in range(4):
        background.ask(work(k), results.append)
    spin(lambda: ran)
    assert background.busy
    gate.set()
    spin(lambda: not background.busy)
    assert results == [3]
    assert ran == [0, 3]
    gate.clear()
    background.ask(work(4), results.append)
    spin(lambda: ran[-1] == 4)
    background.drop()
    assert not background.busy
    gate.set()
    spin(seconds=0.1, must=False)
    assert results == [3]
    background.ask(work(5), results.append)
    spin(lambda: results == [3, 5])
    assert errors == []


@pytest.mark.parametrize(
    ("error", "words"),
    [(InputError("no such cell"), "no such cell"), (RuntimeError("odd"), "odd"),
     (MemoryError(), "not enough memory")],
)  # fmt: skip
def test_errors_in_the_background_are_sentences(app, spin, error, words):
    results, errors = [], []

    def fail():
        raise error

    background = Background(errors.append)
    background.ask(fail, results.append)
    spin(lambda: errors)
    assert words in errors[0]
    assert results == []
    background.ask(lambda: 1, results.append)  # it goes on
    spin(lambda: results == [1])


def test_closing_lets_go_of_whoever_waits(app, spin):
    class Waiting:
        def __init__(self):
            self.background = Background(self.take)
            self.taken = []

        def take(self, result):
            self.taken.append(result)

    gate, done = threading.Event(), []

    def work():
        assert gate.wait(20)
        done.append(True)

    waiting = Waiting()
    waiting.background.ask(work, waiting.take)
    spin(seconds=0.05, must=False)
    refs = [weakref.ref(waiting), weakref.ref(waiting.background)]
    waiting.background.close()
    waiting.background.ask(work, waiting.take)  # nothing happens
    del waiting
    gc.collect()
    assert [ref() for ref in refs] == [None, None]
    gate.set()
    spin(lambda: done)


def test_what_the_engine_said_of_points_that_are_gone_is_dropped():
    assert of_engine([], "point 1 (1, 2, 3 um) lies on a membrane", [1]) is None
