"""What the panels share: the image and its region, one task at a time, a record for each image."""

import ast
from pathlib import Path

import numpy as np
import pytest

import napari_deltamic
from napari_deltamic.errors import InputError
from napari_deltamic.gui.cell_source import seeds_from_layer
from napari_deltamic.gui.document import Document
from napari_deltamic.gui.work import Task, Work
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.effects import Effects

from .conftest import CENTER, SHAPE, SIZE
from .seeding import PLACE

GUI = Path(napari_deltamic.__file__).parent / "gui"


@pytest.fixture
def doc(app, with_image):
    doc = Document(with_image)
    yield doc
    doc.close()


def rectangle(viewer, low, high):
    """One drawn around some voxels of the slice in the middle, Y and X."""
    (y0, x0), (y1, x1) = low, high
    corners = [[10, y0, x0], [10, y0, x1], [10, y1, x1], [10, y1, x0]]
    return viewer.add_shapes([np.array(corners, float)], name="around", **PLACE)


def test_a_rectangle_is_a_region_over_all_slices(doc, with_image, pixels):
    rectangle(with_image, (4, 6), (12, 20))
    doc.image.follow_drawn()
    assert doc.image.box == ((0, SHAPE[0]), (4, 13), (6, 21))
    np.testing.assert_array_equal(doc.image.stack(), pixels[:, 4:13, 6:21])
    assert doc.image.shape() == (SHAPE[0], 9, 15)
    # The frame begins where the region does.
    corner = doc.image.frame().to_world((0, 0, 0))
    assert corner == pytest.approx(np.add((1, 2, 3), np.multiply((0, 4, 6), SIZE)))
    assert doc.image.file()[0] == ""


def test_a_region_needs_a_rectangle_and_a_few_voxels(doc, with_image):
    with pytest.raises(InputError, match="draw a rectangle"):
        doc.image.follow_drawn()
    rectangle(with_image, (4, 6), (5, 20))
    with pytest.raises(InputError, match="voxels wide"):
        doc.image.follow_drawn()
    assert doc.image.box is None


def test_the_region_follows_its_rectangle(doc, with_image):
    layer, said = rectangle(with_image, (4, 6), (12, 20)), []
    doc.image.stayed.connect(said.append)
    doc.image.follow_drawn()
    assert doc.image.box == ((0, SHAPE[0]), (4, 13), (6, 21))
    moved = [np.add(layer.data[0], (0, 3, -2))]
    layer.data = moved
    assert doc.image.box == ((0, SHAPE[0]), (7, 16), (4, 19))
    layer.data = [np.add(moved[0], (0, 500, 0))]
    assert doc.image.box == ((0, SHAPE[0]), (7, 16), (4, 19))
    assert said == ["the region must be 4 voxels wide along each axis: it stays where it was"]
    layer.data = moved
    doc.image.rescale(np.multiply(SIZE, 2))
    np.testing.assert_allclose(layer.scale, np.multiply(SIZE, 2))  # it lies on the same voxels
    layer.data = [np.add(moved[0], (0, 1, 0))]
    assert doc.image.box == ((0, SHAPE[0]), (8, 17), (4, 19))
    doc.image.take_region(None)
    layer.data = moved
    assert doc.image.box is None, "all of the image is wanted"
    doc.image.follow_drawn()
    layer.data = []
    with_image.layers.remove(layer)
    assert doc.image.box == ((0, SHAPE[0]), (7, 16), (4, 19))
    assert len(said) == 1


def test_what_is_chosen_of_a_fit_needs_no_panel(doc, with_image):
    chosen, news = doc.settings, []
    chosen.changed.connect(news.append)
    fit = FitSettings(max_iterations=7, accuracy=1e-3)
    chosen.show_fit(fit)
    chosen.show_effects(Effects.of("attenuation"))
    assert (chosen.fit_settings(), chosen.accuracy) == (fit, "1e-3")
    assert chosen.scene_settings().effects.names == ("attenuation",)
    assert chosen.psf_is_open
    assert not any(news), "nothing of it was edited"
    chosen.edit_fit({"levels": (1.0, 2.0)})
    chosen.edit_sigma((0.5, 0.3, 0.3))
    assert news[-2:] == [True, True]
    with pytest.raises(InputError, match="levels must decrease"):
        chosen.fit_settings()
    scale = np.multiply(SIZE, 2)
    doc.image.choose(with_image.add_image(np.zeros(SHAPE), scale=scale, name="other"))
    assert chosen.scene_settings().sigma == (0.5, 0.3, 0.3), "the user knows"


def test_another_image_has_no_region(doc, with_image, pixels):
    doc.image.take_region(((0, 10), (0, 10), (0, 10)))
    doc.image.choose(with_image.add_image(pixels, name="other"))
    assert doc.image.box is None


def test_seeds_are_those_of_the_region(doc, with_image, ball_labels):
    layer = with_image.add_labels(ball_labels, **PLACE)
    points = with_image.add_points([CENTER, (2.9, 0.1, 0.1)], **{**PLACE, "scale": (1, 1, 1)})
    box = ((2, 18), (4, 20), (5, 20))
    doc.image.take_region(box)
    frame = doc.image.frame()
    labels = seeds_from_layer(layer, frame, (0, 0, 0), spheres=False)
    np.testing.assert_array_equal(labels.labels, ball_labels[2:18, 4:20, 5:20])
    found = seeds_from_layer(points, frame, (0, 0, 0), spheres=False)
    first = np.multiply((2, 4, 5), SIZE)
    np.testing.assert_allclose(found.points, [np.subtract(CENTER, first)])


def test_cells_beside_the_region_are_told_before_a_fit(doc, with_image, pixels):
    labels = np.zeros(SHAPE, int)
    labels[4:8, 2:6, 2:6], labels[4:8, 8:14, 8:14], labels[4:8, 18:22, 18:22] = 1, 2, 3
    layer = with_image.add_labels(labels, name="found", **PLACE)
    scale = {**PLACE, "scale": (1, 1, 1)}
    with_image.add_points([CENTER, (2.9, 0.1, 0.1)], name="clicks", **scale)
    assert doc.cells.remarks(()) == []
    doc.image.take_region(((0, 20), (4, 20), (4, 24)))
    told = [remark.text for remark in doc.cells.remarks(())]
    assert told[0] == "Of 3 cells in 'found', 2 are cut by the border of the region"
    assert told[1].startswith("Of 2 points in 'clicks', 1 lies beyond the border of the region")
    doc.image.take_region(((0, 20), (7, 20), (4, 24)))
    assert doc.cells.remarks(())[0].text == (
        "Of 3 cells in 'found', 1 lies beyond the border of the region, and will not be fitted; "
        "1 is cut by it"
    )
    doc.cells.choose(layer, ticked=False)
    one = with_image.add_labels((labels == 3).astype(int), name="one", **PLACE)
    told = [remark.text for remark in doc.cells.remarks(())]
    assert "Of 1 cell in 'one', 1 is cut by the border of the region" in told
    doc.cells.choose(one, ticked=False)
    # Cells that were looked for in the region lie in it.
    place = {**PLACE, "translate": doc.image.frame().translate}
    with_image.add_labels(labels[:, 7:20, 4:24], name="found there", **place)
    assert not any("found" in remark.text for remark in doc.cells.remarks(()))


def test_a_layer_that_is_turned_is_told_when_a_fit_starts(doc, with_image):
    turned = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    labels = np.zeros(SHAPE, int)
    labels[4:8, 8:14, 8:14] = 1
    with_image.add_labels(labels, name="turned", rotate=turned, **PLACE)
    doc.image.take_region(((0, 20), (4, 20), (4, 24)))
    assert doc.cells.remarks(()) == []
    with pytest.raises(InputError, match="rotated"):
        doc.cells.seeds(doc.image.frame(), copied=False)


class Waits(Task):
    """Goes on until it is stopped."""

    title = "something runs"

    def __init__(self):
        super().__init__()
        self.ended = []

    def steps(self):
        while True:
            yield

    def end(self, outcome):
        self.ended.append(outcome)


def test_one_task_at_a_time(app, spin):
    work, first = Work(), Waits()
    work.start(first)
    with pytest.raises(InputError, match="something runs already"):
        work.start(Waits())
    work.stop()
    spin(lambda: not first.running)
    assert first.ended == [None]
    assert work.task is None


def test_a_task_that_gives_way_ends_at_once(app, spin):
    work, first, second = Work(), Waits(), Waits()
    first.gives_way = second.gives_way = True
    work.start(first)
    work.start(second)
    assert first.ended == [None]
    assert work.task is second
    work.stop()
    assert second.ended == [None]
    spin(lambda: first.done and second.done)


def test_what_a_task_cannot_show_ends_it(app, spin):
    class Broken(Waits):
        def look(self):
            raise KeyError("a bug")

    work, task = Work(), Broken()
    work.start(task)
    spin(lambda: not task.running)
    assert "a bug" in task.ended[0]


def test_after_closing_nobody_is_told(app, spin):
    work, task = Work(), Waits()
    work.start(task)
    work.close()
    spin(lambda: task.done)
    assert task.ended == []


def test_no_panel_knows_another():
    """Nor does a tool or a control: they meet in the document, and in the widget of the dock."""
    panels = {path.stem for path in GUI.rglob("*_panel.py")}
    assert len(panels) > 5
    wrong = []
    for path in GUI.rglob("*.py"):
        if path.stem == "fit_widget":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                target = node.module.rpartition(".")[2]
                if target in panels and path.stem in panels:
                    wrong.append(f"{path.stem} imports {target}")
    assert wrong == []


def test_what_the_rooms_share_knows_none_of_them():
    """Beside them lie the widget of the dock and what opens it: these alone know the rooms."""
    wrong = []
    for path in GUI.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module:
                room = node.module.partition(".")[0]
                if (GUI / room).is_dir() and room != "viewing":
                    wrong.append(path.stem)
    assert set(wrong) == {"fit_widget", "menu"}


def outermost(target):
    """The names that an assignment to an attribute goes through: ``self._doc.run`` -> three."""
    names = []
    while isinstance(target, (ast.Attribute, ast.Subscript)):
        names.append(target.attr if isinstance(target, ast.Attribute) else "[]")
        target = target.value
    return [*names, target.id] if isinstance(target, ast.Name) else names


def test_only_the_document_writes_what_it_holds():
    assert outermost(ast.parse("self._doc.run = 1").body[0].targets[0]) == ["run", "_doc", "self"]
    held = {"doc", "_doc", "record", "result", "present", "link", "cells"}
    wrong = [
        f"{path.stem}, line {node.lineno}"
        for path in GUI.rglob("*.py")
        if path.stem != "document"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, (ast.Assign, ast.AugAssign))
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        for one in (target.elts if isinstance(target, ast.Tuple) else [target])
        if held & set(outermost(one)[1:])
    ]
    assert wrong == []
