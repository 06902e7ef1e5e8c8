"""Cells corrected by clicks: split, added, merged, removed, undone."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from napari_deltamic.gui.document import Document
from napari_deltamic.gui.seeding.seeds_panel import SeedsPanel

from .mouse import Mouse

SIZE = (0.4, 0.2, 0.2)
LEFT, RIGHT, BESIDE = (2.4, 3.0, 2.0), (2.4, 3.0, 5.0), (0.4, 0.4, 6.8)
PLACE = {"scale": SIZE, "translate": (1, 2, 3), "units": ("um",) * 3}


@pytest.fixture(scope="module")
def scene():
    """An image of two cells with a wall between them, and which is where."""
    z, y, x = np.indices((13, 31, 36)) * np.reshape(SIZE, (3, 1, 1, 1))
    truth = np.zeros(z.shape, np.int32)
    inside = (abs(z - 2.4) < 1.6) & (abs(y - 3.0) < 1.8)
    truth[inside & (x > 0.6) & (x < 3.4)] = 1
    truth[inside & (x >= 3.4) & (x < 6.4)] = 2
    hull = np.maximum(np.maximum(abs(z - 2.4) - 1.6, abs(y - 3.0) - 1.8), abs(x - 3.5) - 2.9)
    image = np.exp(-((hull / 0.2) ** 2)) + np.exp(-(((x - 3.4) / 0.2) ** 2)) * (hull < 0)
    return image.astype(np.float32), truth


@pytest.fixture
def seeds(app, viewer, scene):
    """The panel of seeds with the image, and a way to give it labels and click into them."""
    viewer.add_image(scene[0], name="two", **PLACE)
    doc = Document(viewer)
    panel = SeedsPanel(doc)
    yield panel
    doc.close()


@pytest.fixture
def joined(seeds, viewer, scene):
    """Labels in which both cells are one."""
    return viewer.add_labels((scene[1] > 0).astype(np.int32), name="labels", **PLACE)


@pytest.fixture
def apart(seeds, viewer, scene):
    return viewer.add_labels(scene[1].copy(), name="labels", **PLACE)


def test_no_click_reads_the_image_on_the_main_thread(seeds, apart, click, monkeypatch):
    read, threads = seeds._image.under, []

    def under(layer):
        frame, pixels = read(layer)

        def noted():
            threads.append(threading.current_thread())
            return pixels()

        return frame, noted

    monkeypatch.setattr(seeds._image, "under", under)
    click("remove", LEFT)
    click("remove", RIGHT)
    assert not apart.data.any()
    assert len(threads) == 1  # once for all clicks
    assert threads[0] is not threading.main_thread()


@pytest.fixture
def click(seeds, viewer, spin):
    """Use a tool at places, um, and wait until it has done its work."""

    def click(tool, *places, **options):
        seeds.corrections.bar.use(tool)
        mouse = Mouse(viewer, SimpleNamespace(frame=seeds._image.frame()))
        for place in places:
            viewer.dims.set_point(0, 1 + place[0])
            mouse.drag(place, **options)
        spin(lambda: not seeds.corrections.busy)

    return click


def numbers(layer):
    return sorted(set(np.unique(layer.data)) - {0})


def told(seeds):
    return seeds.corrections.bar.hint.text(), seeds.corrections.count.text()


def test_the_tools_are_there_for_labels_only(seeds, viewer, scene):
    bar = seeds.corrections.bar
    assert bar.isHidden()
    layer = viewer.add_labels(scene[1], name="labels", **PLACE)
    assert not bar.isHidden()
    seeds.cells.choose(layer, False)
    assert bar.isHidden()


def test_a_click_splits_a_cell(seeds, joined, click, scene):
    click("split", LEFT)
    assert numbers(joined) == [1, 2]
    both = (joined.data == 2) & (scene[1] == 1)
    assert both.sum() > 0.9 * (scene[1] == 1).sum()
    assert told(seeds)[1] == "2 cells"


def test_a_click_adds_a_cell_that_was_missed(seeds, apart, click, scene):
    apart.data = np.where(scene[1] == 1, 1, 0)
    click("split", RIGHT)
    assert numbers(apart) == [1, 2]
    assert ((apart.data == 2) & (scene[1] == 2)).sum() > 0.7 * (scene[1] == 2).sum()
    assert not ((apart.data == 2) & (scene[1] == 1)).any()


def test_while_labels_are_corrected_their_number_is_told_once(seeds, apart, click):
    seeds.find_cells._tell("Found 2 cells of about 3 µm.")
    click("split", (2.4, 3.0, 3.4))  # on the wall
    reason = "That click cuts nothing off: click in the middle of the cell."
    assert told(seeds) == (reason, "2 cells")
    assert "Found 2 cells" not in seeds.note.text()
    seeds.corrections.bar.use(None)
    assert "Found 2 cells" in seeds.note.text()


def test_two_clicks_merge_and_one_removes(seeds, apart, click):
    click("merge", LEFT)
    assert numbers(apart) == [1, 2]
    assert "Click the other half" in told(seeds)[0]
    click("merge", RIGHT)
    assert numbers(apart) == [1]
    click("remove", LEFT)
    assert numbers(apart) == []
    assert told(seeds)[1] == "0 cells"


def test_seeds_are_the_corrected_labels(seeds, joined, click):
    click("split", LEFT)
    seed = seeds.cells.seeds(seeds._image.frame())
    np.testing.assert_array_equal(seed.labels, joined.data)


def test_clicks_in_3d_cut_and_do_not_add(seeds, viewer, joined, click, scene):
    seeds.corrections.bar.use("split")
    viewer.dims.ndisplay = 3
    # From above, through the middle of the left cell.
    mouse = Mouse(viewer, SimpleNamespace(frame=seeds._image.frame()))
    assert "on slices only" in told(seeds)[0]
    mouse.drag((-5.0, *BESIDE[1:]), direction=(1.0, 0.0, 0.0))
    assert numbers(joined) == [1]
    assert "In 3D, click on a cell" in told(seeds)[0]
    click("split", (-5.0, *LEFT[1:]), direction=(1.0, 0.0, 0.0))
    assert numbers(joined) == [1, 2]


def test_a_drag_moves_the_view(seeds, viewer, joined, click):
    seeds.corrections.bar.use("split")
    mouse = Mouse(viewer, SimpleNamespace(frame=seeds._image.frame()))
    mouse.drag(LEFT, (2.4, 4.0, 2.0))
    assert not seeds.corrections.busy
    assert numbers(joined) == [1]


def test_the_brush_of_the_layer_takes_over(seeds, joined, click):
    seeds.corrections.bar.use("split")
    joined.mode = "paint"
    click("split", LEFT)
    assert numbers(joined) == [1]
    assert seeds.corrections.bar.tool is None


def test_undo_goes_back_click_by_click_as_napari_does(seeds, viewer, joined, click):
    first = joined.data.copy()
    click("split", LEFT)
    split = joined.data.copy()
    click("remove", RIGHT)
    seeds.corrections.undo_button.click()
    np.testing.assert_array_equal(joined.data, split)
    assert told(seeds)[1] == "2 cells"
    joined.undo()  # napari's own, on Ctrl+Z
    np.testing.assert_array_equal(joined.data, first)
    seeds.corrections.undo()
    np.testing.assert_array_equal(joined.data, first)


def test_the_first_of_two_clicks_can_be_taken_back(seeds, apart, click):
    click("merge", LEFT)
    seeds.corrections.undo()
    assert "Click both halves" in told(seeds)[0]
    click("merge", LEFT, RIGHT)
    assert numbers(apart) == [1]


def test_what_a_click_cannot_do_is_told_without_numbers(seeds, apart, click):
    click("remove", BESIDE)
    assert told(seeds)[0] == "That click lies in no cell."
    click("merge", LEFT, LEFT)
    assert told(seeds)[0] == "Both clicks lie in the same cell already."
    assert numbers(apart) == [1, 2]
    assert told(seeds)[1] == "2 cells"


def test_labels_off_the_voxels_are_refused_in_words(seeds, joined, click):
    joined.translate = (0, 0, 0)
    click("split", LEFT)
    assert "does not lie on the voxels" in told(seeds)[0]


def test_labels_of_small_numbers_can_be_split(seeds, viewer, scene, click):
    layer = viewer.add_labels(np.where(scene[1] > 0, 255, 0).astype(np.uint8), name="b", **PLACE)
    click("split", LEFT)
    assert numbers(layer) == [255, 256]


def test_one_tool_of_all_is_in_use(make_widget, with_image, ball_labels, pixels):
    with_image.add_labels(
        ball_labels, scale=(0.3, 0.2, 0.2), translate=(1, 2, 3), units=("um",) * 3
    )
    widget = make_widget()
    correcting, sculpting = widget.seeds.corrections.bar, widget.running.edit
    correcting.use("merge")
    sculpting.use("push")
    assert correcting.tool is None
    correcting.use("merge")
    assert sculpting.tool is None
    widget.seeds.place_seeds()
    assert correcting.tool is None


def test_closing_leaves_no_connection(seeds, viewer, joined):
    before = len(viewer.mouse_drag_callbacks)
    seeds.corrections.bar.use("split")
    assert len(viewer.mouse_drag_callbacks) == before + 1
    seeds._doc.close()
    assert len(viewer.mouse_drag_callbacks) == before


@pytest.mark.parametrize("kind", [np.uint64, np.int64])
def test_labels_are_counted_whatever_their_numbers(seeds, viewer, scene, click, kind):
    """Large numbers ask for no more memory, unsigned ones for no other kind."""
    viewer.add_labels(scene[1].astype(kind) * (2**31 - 2), name="labels", **PLACE)
    seeds.corrections.bar.use("split")
    assert "2 cells" in told(seeds)[1]
    viewer.layers["labels"].data = scene[1].astype(kind)
    seeds.corrections.renew()
    assert "2 cells" in told(seeds)[1]


def test_pyramids_of_labels_take_no_clicks(seeds, viewer, scene):
    viewer.add_labels([scene[1], scene[1][::2, ::2, ::2]], multiscale=True, name="labels", **PLACE)
    assert seeds.corrections.layer is None
    assert seeds.corrections.bar.isHidden()


def test_clicks_that_wait_are_made_in_the_layer_that_was_clicked(seeds, viewer, apart, spin, scene):
    other = viewer.add_labels(scene[1].copy(), name="other", **PLACE)
    viewer.layers.selection = {apart}
    corrections = seeds.corrections
    corrections.bar.use("remove")
    for place in (LEFT, RIGHT):
        corrections.click(np.array(place))
    viewer.layers.selection = {other}
    spin(lambda: not corrections.busy)
    assert numbers(apart) == []
    assert numbers(other) == [1, 2]


def test_cells_of_two_layers_are_not_merged(seeds, viewer, apart, click, scene):
    click("merge", LEFT)
    viewer.add_labels(scene[1].copy(), name="other", **PLACE)
    seeds.corrections.renew()
    assert "Click both halves" in told(seeds)[0]
    click("merge", RIGHT)
    assert numbers(apart) == numbers(viewer.layers["other"]) == [1, 2]


def test_labels_that_were_replaced_have_nothing_to_undo(seeds, joined, click):
    click("split", LEFT)
    joined.data = np.ones((2, 3, 4), np.int32)
    seeds.corrections.undo()
    assert (joined.data == 1).all()


def test_labels_replaced_under_a_click_stay_as_they_are(seeds, joined, spin, scene):
    corrections = seeds.corrections
    corrections.bar.use("remove")
    corrections.click(np.array(LEFT))
    joined.data = scene[1].copy()
    spin(lambda: not corrections.busy)
    assert numbers(joined) == [1, 2]
    assert "working" not in told(seeds)[0]


def test_another_image_ends_what_is_said_of_the_work(seeds, viewer, joined, scene):
    corrections = seeds.corrections
    corrections.bar.use("remove")
    corrections.click(np.array(LEFT))
    assert "working" in told(seeds)[0]
    seeds._doc.image.choose(viewer.add_image(scene[0], name="again", **PLACE))
    assert "working" not in told(seeds)[0]


def test_selecting_another_layer_starts_a_merge_anew(seeds, viewer, apart, scene, spin):
    other = viewer.add_labels(scene[1].copy(), name="other", **PLACE)
    viewer.layers.selection = {apart}
    corrections = seeds.corrections
    corrections.bar.use("merge")
    corrections.click(np.array(LEFT))
    viewer.layers.selection = {other}
    corrections.click(np.array(RIGHT))
    spin(lambda: not corrections.busy)
    assert numbers(other) == [1, 2]


def test_labels_that_are_replaced_have_cells_of_another_size(seeds, joined, click, scene):
    click("split", LEFT)
    first = seeds.corrections._corrector
    click("split", RIGHT)
    assert seeds.corrections._corrector is first  # the membranes are looked at once
    joined.data = (scene[1] > 0).astype(np.int32)
    click("split", LEFT)
    assert seeds.corrections._corrector is not first


def test_undo_is_there_where_there_is_something_to_undo(seeds, viewer, apart, click, scene):
    button = seeds.corrections.undo_button
    assert not button.isEnabled()
    assert "Nothing to undo" in button.toolTip()
    click("merge", LEFT)
    assert button.isEnabled()  # the first of two clicks
    button.click()
    assert not button.isEnabled()
    click("remove", RIGHT)
    assert button.isEnabled()
    apart.undo()  # napari's own, on Ctrl+Z
    assert not button.isEnabled()
    apart.paint((6, 15, 15), 3)
    assert button.isEnabled()
    other = viewer.add_labels(scene[1].copy(), name="other", **PLACE)
    viewer.layers.selection = {other}
    seeds.cells.choose(apart, False)
    assert not button.isEnabled()
