"""Seeds in the widget: any layers, mixed; the preview; spheres drawn; cells found; warnings."""

import shlex
import sys
import threading
import types

import numpy as np
import pytest
from napari.layers import Labels, Surface

from napari_deltamic import Grid, load_mesh, save_mesh
from napari_deltamic.cli import build_parser
from napari_deltamic.cli.inputs import gather
from napari_deltamic.cli.messages import Notes
from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.fitting.job import assemble
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.labels.bright_cells import CellsFound
from napari_deltamic.gui.seeding import find_cells_button
from napari_deltamic.runs.command import command
from napari_deltamic.runs.run_files import with_files
from napari_deltamic.runs.seeds import seeds_of
from napari_deltamic.runs.settings import NEAR_LEVELS

from .conftest import CENTER, SHAPE, SIZE
from .seeding import FRAME, MEMBRANE, PLACE, SPHERE, add_points, grid_of, taken, texts

BRIGHT = "napari_deltamic.geometry.labels.bright_cells"


@pytest.fixture
def mesh_file(tmp_path):
    path = tmp_path / "start.ply"
    save_mesh(sphere((4.0, 3.4, 3.4), 0.7, edge_length=0.4), path)
    return path


@pytest.fixture
def finder(monkeypatch):
    """In the place of the search for cells, which has tests of its own."""
    asked = []

    def find(image, voxel_size, size=None):
        asked.append(size or 2.5)
        if asked[-1] > 3:
            raise InputError("no cell is as large as that")
        labels = np.zeros(image.shape, np.int32)
        labels[5:12, 5:12, 5:12] = len(asked)
        others = (types.SimpleNamespace(size=1.5, cells=9),)
        return types.SimpleNamespace(labels=labels, size=asked[-1], others=others)

    monkeypatch.setitem(sys.modules, BRIGHT, types.SimpleNamespace(cells_of=find))
    return asked


# Sources --------------------------------------------------------------------------------------


def test_new_layers_are_ticked_but_not_those_of_a_fit(panel, with_image):
    ball = sphere(CENTER, 1.0)
    with_image.add_surface((ball.vertices, ball.faces), name="mine", **FRAME)
    made = with_image.add_surface(
        (ball.vertices, ball.faces), name="theirs", metadata={"deltamic": {"fit": True}}, **FRAME
    )
    with_image.add_points(np.zeros((1, 2)), name="flat")
    rows = [panel.chooser.item(k).text() for k in range(panel.chooser.count())]
    assert rows == ["mine (surface)", "theirs (surface)"]
    assert [layer.name for layer in panel.cells.ticked] == ["mine"]
    panel.cells.choose(made)
    panel.cells.choose(with_image.layers["mine"], False)
    with_image.add_points(ndim=3, name="new")  # the ticks of the others stay
    assert [layer.name for layer in panel.cells.ticked] == ["theirs", "new"]
    del with_image.layers["new"]
    assert [layer.name for layer in panel.cells.ticked] == ["theirs"]


def test_spheres_of_a_mirrored_layer_are_as_large_as_they_are_drawn(panel, with_image):
    points = add_points(panel, with_image, CENTER)
    points.scale = np.multiply(points.scale, (-1, 1, 1))
    panel.shape.setCurrentIndex(SPHERE)
    panel.radius.setValue(0.8)
    assert np.asarray(points.size) * np.abs(points.scale).mean() == pytest.approx(1.6)


def test_another_region_leaves_spheres_as_large_as_they_were(panel, with_image):
    points = add_points(panel, with_image, CENTER, CENTER)
    panel.shape.setCurrentIndex(SPHERE)
    panel.radius.setValue(0.8)
    points.selected_data = {1}
    panel.radius.setValue(0.5)
    before = np.array(points.size)
    assert before[0] > before[1]
    panel._image.take_region(((2, 12), (2, 12), (2, 12)))
    assert panel.radius.value() == pytest.approx(0.5)
    np.testing.assert_array_equal(points.size, before)


def test_another_region_leaves_the_size_of_cells_as_it_was(panel, with_image, pixels):
    finder = panel.find_cells
    finder.cell_size.setValue(1.7)
    finder._sizes = [(1.0, 40)]  # as counted in the whole image
    panel._image.take_region(((2, 12), (2, 12), (2, 12)))
    assert finder._sizes == []
    assert finder.cell_size.value() == pytest.approx(1.7)
    assert finder.tried
    panel._image.choose(with_image.add_image(pixels, scale=SIZE, name="other"))
    assert finder.cell_size.value() != pytest.approx(1.7)
    assert not finder.tried


def test_each_source_alone(panel, with_image, ball_labels):
    points = add_points(panel, with_image, CENTER)
    assert taken(panel).kind == "image"
    panel.shape.setCurrentIndex(SPHERE)
    assert taken(panel).kind == "rough"
    panel.cells.choose(points, False)
    labels = with_image.add_labels(ball_labels, **PLACE)
    mesh = taken(panel).make(panel._image.stack(), grid_of(panel))
    assert mesh.region_ids().tolist() == [3]
    panel.cells.choose(labels, False)
    with pytest.raises(InputError, match="no cells yet"):
        taken(panel)


def test_all_sources_mixed_give_regions_of_their_own(
    panel, with_image, ball_labels, mesh_file, spin
):
    add_points(panel, with_image, CENTER)
    with_image.add_labels(ball_labels, **PLACE)
    panel.use_file(str(mesh_file))
    spin(lambda: "start" in with_image.layers)
    seeds = taken(panel)
    mesh = seeds.make(panel._image.stack(), grid_of(panel))
    assert len(mesh.region_ids()) == 3
    of_region = [mesh.faces[(mesh.regions == k).any(axis=1)] for k in mesh.region_ids()]
    middles = sorted(mesh.vertices_numpy()[np.unique(faces), 1].mean() for faces in of_region)
    assert middles == pytest.approx([1.2, 2.3, 3.4], abs=0.3)
    assert seeds.kind == "rough"
    panel.cells.choose(with_image.layers["start"], False)
    assert taken(panel).kind == "labels"


@pytest.mark.parametrize(("radii", "spheres"), [(None, False), ((0.5, 0.7), True)])
def test_points_of_a_file_are_seeds(panel, with_image, tmp_path, spin, radii, spheres):
    """As the command takes them: where they lie, and as large."""
    beside = np.add(CENTER, (0, 0.3, 0.3))
    rows = np.column_stack([[CENTER, beside], *([] if radii is None else [radii])])
    header = "z,y,x" if radii is None else "z,y,x,radius"
    path = tmp_path / "cells.csv"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    panel.use_file(str(path))
    spin(lambda: "cells" in with_image.layers)
    found = taken(panel)
    assert (panel.shape.currentIndex() == SPHERE) is spheres
    asked = seeds_of(str(path))
    np.testing.assert_allclose(found.places(grid_of(panel)), asked.points)
    if spheres:
        np.testing.assert_allclose(found.radii, radii)


def test_radii_of_some_points_only_are_not_used(panel, with_image, tmp_path, spin):
    path = tmp_path / "cells.csv"
    path.write_text("z,y,x,radius\n1,1,1,0.5\n1,2,2,\n")
    told = []
    panel._doc.warned.connect(told.append)
    panel.use_file(str(path))
    spin(lambda: "cells" in with_image.layers)
    assert panel.shape.currentIndex() == MEMBRANE
    assert any("radii are not used" in text for text in told)


def test_layers_that_are_empty_yet_do_not_disturb(panel, with_image, ball_labels):
    add_points(panel, with_image)
    with pytest.raises(InputError, match="'seeds' has no points yet"):
        taken(panel)
    with_image.add_labels(ball_labels, **PLACE)
    with_image.add_labels(np.zeros(SHAPE, int), **PLACE)
    assert taken(panel).kind == "labels"


def test_points_of_several_layers_are_one_set(panel, with_image, tmp_path):
    """So that two in one cell are seen, and one table holds them."""
    add_points(panel, with_image, CENTER)
    with_image.add_points([np.add(CENTER, (0, 0.2, 0.2))], name="more", **FRAME)
    seeds = taken(panel)
    with pytest.warns(RepairWarning, match="points 1 and 2 lie in the same region"):
        seeds.make(panel._image.stack(), grid_of(panel))
    path = seeds.save(tmp_path, panel._image.stack(), grid_of(panel))
    assert path.name == "seeds.csv"
    assert len(path.read_text().splitlines()) == 3


@pytest.mark.parametrize(
    ("names", "spheres"),
    [(["seeds", "labels"], MEMBRANE), (["labels", "start"], SPHERE), (["start"], MEMBRANE)],
)
def test_the_command_repeats_a_mixed_run(
    make_widget, with_image, ball_labels, mesh_file, spin, tmp_path, names, spheres
):
    widget = make_widget()
    panel = widget.seeds
    add_points(panel, with_image, CENTER)
    with_image.add_labels(ball_labels, name="labels", **PLACE)
    panel.use_file(str(mesh_file))
    spin(lambda: "start" in with_image.layers)
    panel.shape.setCurrentIndex(spheres)
    for layer in panel.cells.ticked:
        panel.cells.choose(layer, layer.name in names)
    seeds, pixels, grid = taken(panel), panel._image.stack(), grid_of(panel)
    settings = with_files(widget.doc.run_settings(seeds.path), pixels, grid, seeds, tmp_path)
    words = shlex.split(command(settings, str(tmp_path / "result")))
    repeated = gather(build_parser().parse_args(words[1:]), Notes())
    settings, start = widget.doc.run_settings(seeds.path), seeds.make(pixels, grid)
    run = assemble(settings, pixels, grid, start, seeds.kind)
    # The command takes the PSF from the image first, from which flatness follows.
    fits = [one.settings.fit.model_copy(update={"flatness": 1.0}) for one in (repeated, run)]
    assert fits[0] == fits[1]
    np.testing.assert_array_equal(repeated.mesh.faces, run.mesh.faces)
    np.testing.assert_array_equal(repeated.mesh.regions, run.mesh.regions)
    np.testing.assert_allclose(repeated.mesh.vertices_numpy(), run.mesh.vertices_numpy(), atol=1e-5)
    near = names == ["seeds", "labels"]
    assert run.settings.fit.levels == (NEAR_LEVELS if near else None)


# Mesh files -----------------------------------------------------------------------------------


def test_mesh_files_become_layers_in_the_frame_of_the_image(panel, with_image, mesh_file, spin):
    other = mesh_file.with_name("other.stl")
    save_mesh(sphere(CENTER, 0.5), other)
    panel.use_file(str(mesh_file), str(other))
    spin(lambda: "other" in with_image.layers)
    layers = panel.cells.ticked
    assert [layer.name for layer in layers] == ["start", "other"]
    world = np.asarray(layers[0].data[0]) * layers[0].scale + layers[0].translate
    assert world.mean(axis=0) == pytest.approx(np.add((4.0, 3.4, 3.4), (1, 2, 3)), abs=0.05)
    panel.cells.choose(layers[1], False)
    assert taken(panel).path == str(mesh_file)
    mesh = taken(panel).make(None, Grid(SHAPE, SIZE))
    np.testing.assert_array_equal(mesh.vertices_numpy(), load_mesh(mesh_file).vertices_numpy())


def test_a_file_that_is_no_mesh_is_told_in_words(panel, tmp_path, spin):
    said = []

    def hear(text):
        said.append(text)

    panel._doc.warned.connect(hear)
    bad = tmp_path / "bad.ply"
    bad.write_text("no mesh")
    panel.use_file(str(bad))
    spin(lambda: said)
    assert "bad.ply" in said[0]


# Find cells -----------------------------------------------------------------------------------


def test_cells_found_are_seeds_that_can_be_corrected(panel, with_image, finder, spin):
    panel.find_cells.click()
    assert "Looking for cells" in panel.note.text()
    spin(lambda: "found cells" in with_image.layers)
    layer = with_image.layers["found cells"]
    assert isinstance(layer, Labels)
    assert panel.cells.ticked == [layer]
    assert tuple(layer.translate) == (1, 2, 3)
    assert finder == [2.5]
    assert panel.find_cells.cell_size.value() == pytest.approx(2.5, abs=0.01)
    assert "Found 1 cell of about 2.5 µm" in panel.note.text()
    assert "9 cells of 1.5 µm" in panel.note.text()
    assert taken(panel).make(np.zeros(SHAPE), grid_of(panel)).region_ids().tolist() == [1]
    panel.find_cells.cell_size.setValue(1.25)
    panel.cells.choose(layer, False)
    panel.find_cells.click()
    spin(lambda: layer.data.max() == 2)  # the same layer
    assert finder[1] == pytest.approx(1.25, abs=0.01)
    assert [one.name for one in with_image.layers].count("found cells") == 1
    assert panel.cells.ticked == [layer]
    panel.note.linkActivated.emit("1.5")
    spin(lambda: layer.data.max() == 3)
    assert finder[2] == pytest.approx(1.5)


def test_no_cells_found_is_told_in_words(panel, with_image, finder, spin):
    panel.find_cells.cell_size.setValue(4)
    panel.find_cells.click()
    assert panel.note.text() == "Looking for cells ..."
    spin(lambda: panel.note.text() == "No cell is as large as that.")
    assert "found cells" not in with_image.layers
    assert panel._form.isRowVisible(panel.find_cells.cell_size)


def test_what_was_found_is_forgotten_with_its_layer(panel, with_image, finder, spin):
    panel.find_cells.click()
    spin(lambda: "found cells" in with_image.layers)
    layer = with_image.layers["found cells"]
    layer.data[15:18, 15:18, 15:18] = 9
    panel.corrections.edited.emit()
    assert panel.note.text().startswith("2 cells.")
    assert "9 cells of 1.5 µm" in panel.note.text()
    with_image.layers.remove(layer)
    assert panel.note.text() == "Press 'Find cells', or 'Click cells' and click inside each."
    panel.place.click()
    assert panel.note.text() == "Click inside each cell."


def test_labels_of_other_voxels_are_resampled(panel, with_image):
    coarse = np.zeros((10, 6, 8), np.uint16)
    coarse[3:7, 1:4, 2:5] = 500
    # Twice, four times and three times as large as those of the image; the first voxels cover the
    # same corner, but along Z, where they begin three voxels of the image below it.
    scale = np.multiply(SIZE, (2, 4, 3))
    corner = np.subtract((1, 2, 3), np.divide(SIZE, 2)) - (3 * SIZE[0], 0, 0)
    place = {"scale": scale, "translate": corner + scale / 2, "units": ("um",) * 3}
    layer = with_image.add_labels(coarse, name="elsewhere", **place)
    fine = coarse.repeat(2, 0).repeat(4, 1).repeat(3, 2)
    expected = np.zeros(SHAPE, int)
    expected[:17] = fine[3:20, : SHAPE[1], : SHAPE[2]]
    np.testing.assert_array_equal(taken(panel).labels, expected)
    layer.scale = (1, 1, 1)
    layer.units = ("pixel",) * 3
    with pytest.raises(InputError, match="the same scale"):
        taken(panel)  # its voxel size is missing


def test_labels_of_as_many_voxels_are_meant_to_lie_on_those_of_the_image(panel, with_image):
    labels = np.ones(SHAPE, int)
    with_image.add_labels(labels, scale=np.multiply(SIZE, 2), units=("um",) * 3)
    with pytest.raises(InputError, match="the same scale"):
        taken(panel)


def test_labels_that_say_no_place_lie_on_the_voxels_of_the_image(panel, with_image):
    labels = np.zeros(SHAPE, int)
    labels[5:9, 6:12, 7:13] = 1
    layer = with_image.add_labels(labels)
    np.testing.assert_array_equal(taken(panel).labels, labels)
    assert tuple(layer.translate) == (1, 2, 3)
    other = with_image.add_labels(labels[:, 1:], name="other")
    assert tuple(other.scale) == (1, 1, 1), "it may lie anywhere"


def test_what_lies_on_the_image_goes_along_with_another_voxel_size(panel, with_image):
    with_image.layers.clear()
    image = with_image.add_image(np.zeros(SHAPE))
    labels = with_image.add_labels(np.ones(SHAPE, int), name="labels")
    clicks = add_points(panel, with_image, (4, 6, 8))
    theirs = with_image.add_points([(2, 3, 4)], name="theirs")
    apart = with_image.add_points([(2, 3, 4)], name="apart", scale=(0.5, 0.5, 0.5))
    for size in ((0.3, 0.2, 0.2), (0.6, 0.1, 0.2)):
        panel._image.rescale(size)
        frame = panel._image.frame()
        assert frame.voxel_size == pytest.approx(size)
        for layer, voxel in ((clicks, (4, 6, 8)), (theirs, (2, 3, 4))):
            scale, shift = frame.data_to_um(layer)
            np.testing.assert_allclose(layer.data[0] * scale + shift, np.multiply(voxel, size))
        assert tuple(labels.scale) == tuple(image.scale) == pytest.approx(size)
        assert tuple(apart.scale) == (0.5, 0.5, 0.5)


def test_any_labels_make_room_for_the_meshes_of_a_fit(panel, with_image):
    labels = with_image.add_labels(np.ones(SHAPE, int), name="mine", **PLACE)
    points = add_points(panel, with_image, CENTER)
    panel.make_room()
    assert not labels.visible
    assert points.visible


def test_a_second_press_starts_anew(panel, with_image, spin, monkeypatch):
    gate, sizes = threading.Event(), []

    def look(read, voxel_size, size):
        sizes.append(size)
        assert gate.wait(20)
        return CellsFound(np.full(read().shape, len(sizes), np.int32), 1.0, False)

    monkeypatch.setattr(find_cells_button, "look", look)
    for _ in range(3):
        panel.find_cells.click()
        spin(lambda: sizes)
    gate.set()
    spin(lambda: "found cells" in with_image.layers)
    assert len(sizes) == 2, "the press in between was given up before it began"
    assert with_image.layers["found cells"].data.max() == 2


def test_a_search_for_cells_is_given_up_with_its_image(panel, with_image, spin, monkeypatch):
    gate = threading.Event()

    def look(read, voxel_size, size):
        assert gate.wait(20)
        return CellsFound(np.ones(read().shape, np.int32), 1.0, False)

    monkeypatch.setattr(find_cells_button, "look", look)
    panel.find_cells.click()
    del with_image.layers["cell"]
    gate.set()
    spin(seconds=0.3, must=False)
    assert "found cells" not in with_image.layers
    assert "Looking" not in panel.note.text()


# Series and other places ----------------------------------------------------------------------


def test_of_a_series_the_time_shown_counts(panel, viewer, pixels, spin):
    del viewer.layers["cell"]
    viewer.add_image(np.stack([pixels, pixels]), scale=(60, *SIZE), name="series")
    assert panel._image.layer is viewer.layers["series"]
    own = viewer.add_points([(0, *CENTER), (1, 50, 1, 1)], scale=(60, 1, 1, 1), name="tracks")
    ball = sphere(CENTER, 0.5)
    timed = [np.column_stack([np.full(len(ball.vertices), t), ball.vertices]) for t in (0, 1)]
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    surface = viewer.add_surface((np.concatenate(timed), faces), scale=(60, 1, 1, 1), name="both")
    viewer.dims.set_current_step(0, 0)
    seeds = taken(panel)
    assert len(seeds.parts[0].points) == 1
    assert len(seeds.parts[1].surface.faces) == len(ball.faces)
    spin(lambda: panel.preview.mesh is not None)
    assert texts(panel) == []
    viewer.dims.set_current_step(0, 1)
    spin(lambda: texts(panel) == ["Point 2 lies outside the image: move or delete it"])
    spin(lambda: panel.preview.mesh is None, 3)
    assert own in panel.cells.ticked
    assert surface in panel.cells.ticked


def test_surfaces_are_listed_whoever_added_them(panel, with_image):
    ball = sphere(CENTER, 0.5)
    with_image.add_layer(Surface((ball.vertices, ball.faces), name="opened", **FRAME))
    assert taken(panel).kind == "rough"
    assert taken(panel).path == ""
