"""Found cells belong to their image; corrections come back; what cannot be used is named."""

import types

import numpy as np
import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.gui.seeding import find_cells_button

from .conftest import CENTER, SHAPE, SIZE
from .sessions import save
from .test_other_image import choose, other  # noqa: F401


@pytest.fixture(autouse=True)
def finder(monkeypatch):
    """In the place of the search for cells: each time another label, in half of the image."""
    calls = []

    def found(read, voxel_size, size):
        calls.append(size)
        labels = np.zeros(read().shape, np.int32)
        labels[3:15, 3:15, 3:15] = len(calls)
        others = (types.SimpleNamespace(size=1.5, cells=9),)
        return types.SimpleNamespace(labels=labels, size=2.5, others=others)

    monkeypatch.setattr(find_cells_button, "look", found)
    return calls


def find(widget, spin):
    widget.seeds.find_cells.click()
    spin(lambda: not widget.seeds.find_cells.background.busy)
    return widget.seeds.find_cells._in_use.layer


def test_undo_brings_corrections_back_that_another_search_replaced(make_widget, spin):
    widget = make_widget()
    layer = find(widget, spin)
    undo = widget.seeds.corrections.undo
    for again in range(2):  # also of several searches, the last
        layer.data_setitem((np.array([0]), np.array([0]), np.array([again])), np.array([7]))
        corrected = layer.data.copy()
        find(widget, spin)
        assert not np.array_equal(layer.data, corrected)
        assert sum(step[0][0] is find_cells_button._ALL for step in layer._undo_history) == 1
    undo()
    np.testing.assert_array_equal(layer.data, corrected)
    assert widget.seeds.find_cells.message == "2 cells."
    layer.redo()
    assert set(np.unique(layer.data)) == {0, 3}
    layer.undo()
    undo()
    assert layer.data[0, 0, 1] == 0, "what was done before can be undone, too"


def test_found_cells_belong_to_their_image_in_a_window_that_is_opened_again(
    make_widget,
    with_image,
    spin,
    other,  # noqa: F811
):
    widget = make_widget()
    first = find(widget, spin)
    other()
    choose(widget, "other")
    second = find(widget, spin)
    widget.close_links()
    again = make_widget()
    choose(again, "other")
    assert again.doc.cells.ticked == [second]
    assert again.seeds.find_cells.message == "Found 1 cell of about 2.5 µm."
    assert "9 cells of 1.5" in again.seeds.note.text()
    choose(again, "cell")
    assert again.doc.cells.ticked == [first]
    assert (first.visible, second.visible) == (True, False)
    assert find(again, spin) is first


def test_a_session_keeps_to_which_image_found_cells_belong(make_widget, with_image, spin, tmp_path):
    widget = make_widget()
    first = find(widget, spin)
    save(widget, tmp_path / "a.deltamic", spin)
    widget.sessions.open(str(tmp_path / "a.deltamic"))
    spin(lambda: not widget.sessions.busy)
    own = with_image.layers["cell"]
    opened, (layer,) = widget.doc.image.layer, widget.doc.cells.ticked
    assert opened is not own
    assert layer is not first
    assert widget.seeds.find_cells.message == "Found 1 cell of about 2.5 µm."
    assert "9 cells of 1.5" in widget.seeds.note.text()
    assert find(widget, spin) is layer, "no second one is added"
    widget.doc.image.choose(own)
    assert widget.doc.cells.ticked == [first]
    widget.doc.image.choose(opened)
    assert widget.doc.cells.ticked == [layer]


def test_what_someone_wrote_into_a_layer_is_no_reason_to_fail(make_widget, with_image):
    for noted in (None, 3, {}, {"image": str(with_image.layers["cell"].unique_id), "others": 4}):
        with_image.add_labels(np.ones(SHAPE, int), metadata={"deltamic": {"found": noted}})
    assert len(make_widget().doc.cells.ticked) == 4


def test_labels_of_another_image_are_named(make_widget, with_image):
    widget = make_widget()
    place = {"scale": SIZE, "translate": (1, 2, 3), "units": ("um",) * 3}
    with_image.add_labels(np.ones((10, 12, 12), int), name="smaller", **place)
    with pytest.raises(
        InputError, match=r"'smaller' has 10 x 12 x 12 voxels.*20 x 24 x 24.*untick"
    ):
        widget.doc.cells.seeds(widget.doc.image.frame())


def test_no_cells_of_a_size_are_told_in_voxels_where_nobody_knows_theirs(
    make_widget, with_image, pixels, spin, monkeypatch
):
    def none(*asked):
        raise InputError("no cells of about 10 um were found: try another size")

    monkeypatch.setattr(find_cells_button, "look", none)
    with_image.add_image(pixels, name="no size")
    widget = make_widget()
    for name, unit in (("no size", "voxels"), ("cell", "µm")):
        choose(widget, name)
        widget.seeds.find_cells.click()
        spin(lambda: not widget.seeds.find_cells.background.busy)
        assert f"about 10 {unit} were" in widget.seeds.note.text()


def test_units_that_are_no_lengths_are_told(make_widget, with_image, pixels):
    widget, panel = make_widget(), None
    for scale in ((1, 1, 1), (3, 2, 2)):
        with_image.add_image(pixels, name="odd", scale=scale, units=("s",) * 3)
        choose(widget, "odd")
        panel = widget.image
        assert "are not lengths: taken as µm" in panel.note.text()
        assert panel.note.verdict == "fair"
        del with_image.layers["odd"]
    choose(widget, "cell")
    assert "lengths" not in panel.note.text()


def test_points_are_added_where_a_cell_can_start_and_never_twice(
    make_widget, with_image, spin, soon
):
    widget = make_widget()
    said = []
    widget.doc.noted.connect(said.append)
    wall = (CENTER[0], CENTER[1], CENTER[2] + 1.1)
    things = [(CENTER, wall), (((0.3, 4.0, 0.3)), (0.3, 4.2, 0.4))]
    for text in ("1 point added to 'seeds'", "No point was added"):
        widget.doc.points_wanted.emit(things)
        spin(lambda: not widget.seeds._placing.busy)
        assert text in said[-1]
        layer = with_image.layers["seeds"]
        np.testing.assert_allclose(layer.data, [np.add(CENTER, 0)], atol=1e-6)
    assert "In 1 of 2 places no cell can start" in said[-3]
    widget.running.note.say(said[-1])
    with_image.layers.remove(layer)
    assert widget.running.note.text() == "", "what was said was of the points"


def test_spheres_are_added_but_not_in_each_other(seeded, with_image):
    inside, beside = np.add(CENTER, (0, 0.2, 0)), np.add(CENTER, (0, 1.5, 0))
    seeded.doc.points_wanted.emit([(inside,), (beside,)])
    np.testing.assert_allclose(with_image.layers["seeds"].data, [CENTER, beside], atol=1e-6)
