"""Results: files that other programs read, writing that fails, rows that lead to cells."""

import os
import shlex
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from napari.layers._source import layer_source
from qtpy.QtCore import Qt

import napari_deltamic as nd
from napari_deltamic.cli import build_parser
from napari_deltamic.cli.inputs import gather
from napari_deltamic.cli.messages import Notes
from napari_deltamic.fitting.history import History
from napari_deltamic.fitting.job import FitInput
from napari_deltamic.geometry import files, sphere
from napari_deltamic.gui.cell_table import why_of
from napari_deltamic.gui.results import more_actions
from napari_deltamic.gui.viewing.colours import BY_VALUE, region_colours
from napari_deltamic.gui.viewing.frame import OWN, camera_of
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.results.cell_columns import COLUMNS
from napari_deltamic.results.session_parts import SavedResult
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings

from .conftest import CENTER, SIZE

CENTERS = {3: (2.9, 2.3, 1.4), 7: (2.9, 2.3, 3.3)}


@pytest.fixture
def widget(make_widget, with_image):
    """With a result of two cells, as if it had been fitted."""
    widget = make_widget()
    parts = []
    for region, center in CENTERS.items():
        ball = sphere(center, 0.6, edge_length=0.3)
        regions = np.tile([region, 0], (len(ball.faces), 1))
        parts.append(nd.Mesh(ball.vertices, ball.faces, regions))
    mesh = nd.Mesh.merge(parts)
    image = with_image.layers["cell"].data
    settings = RunSettings(
        image="", seeds="", scene=SceneSettings(voxel_size=SIZE), fit=FitSettings()
    )
    grid, optics = nd.Grid(image.shape, SIZE), nd.GaussianPSF((0.36, 0.24, 0.24))
    state = nd.FitState(
        iteration=3,
        level=1,
        levels=1,
        mesh=mesh,
        optics=optics,
        density=np.ones(len(mesh.faces)),
        loss=0.5,
        amplitude=1.0,
        background=0.0,
        blur=1.0,
        _image=image * 0.5,
    )
    job = FitInput(settings, image, grid, mesh, optics, None)
    history = History([1.0, 0.7, 0.5], [1] * 3, [1.0] * 3)
    list(widget.doc.reopen(SavedResult(settings, state, history, 1.0), job))
    return widget


def test_the_rendered_image_is_ome_with_its_voxel_size_in_um(widget, tmp_path):
    path = tmp_path / "rendered.ome.tif"
    widget.results.save_image(str(path))
    with tifffile.TiffFile(path) as tif:
        assert tif.is_ome
        assert not tif.is_imagej, "two descriptions of the scale could contradict each other"
        assert tif.series[0].axes == "ZYX"
        pixels = tifffile.xml2dict(tif.ome_metadata)["OME"]["Image"]["Pixels"]
        assert tuple(pixels[f"PhysicalSize{a}"] for a in "ZYX") == pytest.approx(SIZE)
        assert {pixels[f"PhysicalSize{a}Unit"] for a in "ZYX"} == {"µm"}
        np.testing.assert_array_equal(tif.asarray(), widget.doc.result.state.rendered())
    assert read_image(path)[1] == pytest.approx(SIZE)


def test_a_plain_name_gives_what_imagej_reads(widget, tmp_path):
    path = tmp_path / "rendered.tif"
    widget.results.save_image(str(path))
    with tifffile.TiffFile(path) as tif:
        assert tif.is_imagej
        assert not tif.is_ome
    assert read_image(path)[1] == pytest.approx(SIZE, rel=1e-4)


def test_what_a_file_cannot_hold_is_told(widget, tmp_path, told):
    widget.results.save_meshes(str(tmp_path / "a.stl"))
    assert (tmp_path / "a.stl").exists()
    assert "cannot hold regions" in told[-1]
    widget.results.save_meshes(str(tmp_path / "a.ply"))
    assert told[-1] == f"saved {tmp_path / 'a.ply'}"
    assert nd.load_mesh(tmp_path / "a.ply").region_ids().tolist() == [3, 7]


def test_the_table_of_the_file_has_units_and_more_columns(widget, tmp_path):
    widget.results.save_table(str(tmp_path / "a.csv"))
    header, first, *_ = (tmp_path / "a.csv").read_text().splitlines()
    row = dict(zip(header.split(","), first.split(","), strict=True))
    assert {"region", "volume_um3", "area_um2", "sphericity"} <= set(row)
    for axis, value in zip("zyx", CENTERS[3], strict=True):
        assert float(row[f"centroid_{axis}_um"]) == pytest.approx(value, abs=0.01)


@pytest.mark.parametrize(  # no space, no permission, read-only
    ("what", "code"),
    [("meshes", 13), ("meshes", 30), ("meshes", 28), ("table", 28), ("image", 28), ("all", 28)],
)
def test_writing_that_fails_is_told_and_works_elsewhere(
    widget, tmp_path, told, monkeypatch, code, what
):
    save = getattr(widget.results, f"save_{what}")
    name = {"meshes": "a.ply", "table": "a.csv", "image": "a.tif", "all": "a"}[what]

    def fail(descriptor):
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", fail)
        widget.doc.attempt(lambda: save(str(tmp_path / name)))
    assert os.strerror(code) in told[-1]
    assert "\n" not in told[-1]
    assert widget.results.isEnabled()
    widget.doc.attempt(lambda: save(str(tmp_path / f"b{name}")))
    assert told[-1].startswith("saved")
    assert (tmp_path / f"b{name}").exists()


def test_a_folder_that_is_gone_is_told(widget, tmp_path, told):
    path = str(tmp_path / "gone" / "a.ply")
    widget.doc.attempt(lambda: widget.results.save_meshes(path))
    assert "cannot be written" in told[-1]


def test_dialogs_add_what_a_name_lacks(widget, tmp_path, monkeypatch):
    chosen = {}
    monkeypatch.setattr(
        "napari_deltamic.gui.results.results_panel.QFileDialog.getSaveFileName",
        lambda parent, title, *a: (str(tmp_path / chosen["name"]), chosen.get("kind", "")),
    )
    entries = {action.text(): action for action in widget.results.export.menu().actions()}
    for name, kind, entry, found in (
        ("m", "STL (*.stl)", "Meshes...", "m.stl"),
        ("i", "", "Image...", "i.ome.tif"),
        ("j.tif", "", "Image...", "j.tif"),
        ("t", "CSV (*.csv)", "Table...", "t.csv"),
    ):
        chosen.update(name=name, kind=kind)
        entries[entry].trigger()
        assert (tmp_path / found).exists(), found


# ---- rows and the viewer -------------------------------------------------------------------------


def test_a_row_dims_the_other_cells_and_goes_there(widget, with_image):
    surface = with_image.layers["cell: surfaces"]
    plain = np.array(surface.data[2])
    with_image.dims.ndisplay = 2
    widget.results.table.selectRow(1)
    assert widget.doc.link.contours.chosen == {7}
    assert (np.asarray(surface.data[2]) != plain).any()
    world = np.add(CENTERS[7], (1, 2, 3))  # the image lies there
    assert with_image.dims.point == pytest.approx(world, abs=0.2)
    scene = getattr(with_image, "scene", with_image)
    assert scene.camera.center[-2:] == pytest.approx(world[-2:], abs=0.05)
    widget.results.table.clearSelection()
    np.testing.assert_array_equal(surface.data[2], plain)


@pytest.mark.parametrize("chosen_first", [True, False])
def test_a_row_dims_the_other_cells_where_a_column_gives_the_colours(
    widget, with_image, chosen_first
):
    results, surface = widget.results, with_image.layers["cell: surfaces"]
    contours = with_image.layers["cell: contours"]
    world = np.add(CENTERS[7], (1, 2, 3))
    by_place = results.colour.findData("centroid_x_um")
    for chosen in (chosen_first, not chosen_first):
        if chosen:
            results.table.selectRow(1)
        else:
            results.colour.setCurrentIndex(by_place)
    with_image.dims.ndisplay = 3
    drawn = of_cells(surface)
    np.testing.assert_allclose(drawn[7], BY_VALUE.map(np.ones(1))[0], atol=0.01)
    assert drawn[3][3] < 0.5, "one looks through what is not chosen"
    with_image.dims.ndisplay = 2
    with_image.dims.set_point(0, world[0])
    lines = np.unique(contours.edge_color, axis=0)
    assert len(lines) == 2
    yellow = np.abs(lines - BY_VALUE.map(np.ones(1))).max(axis=1) < 0.01
    assert yellow.sum() == 1
    assert np.ptp(lines[~yellow][0, :3]) < 0.2, "greyish"
    results.table.clearSelection()
    drawn = of_cells(surface)
    np.testing.assert_allclose(drawn[3], BY_VALUE.map(np.zeros(1))[0], atol=0.01)
    np.testing.assert_allclose(drawn[7], BY_VALUE.map(np.ones(1))[0], atol=0.01)
    results.colour.setCurrentIndex(0)
    np.testing.assert_allclose(of_cells(surface)[7], region_colours(7), atol=0.01)


def of_cells(surface):
    """The colour in which a surface layer draws each cell."""
    _, faces, values = surface.data
    low, high = surface.contrast_limits
    regions = np.repeat(surface.metadata[OWN]["regions"].max(axis=1), 3)
    colours = surface.colormap.map((np.asarray(values)[faces.ravel()] - low) / (high - low))
    for region in CENTERS:
        assert np.ptp(colours[regions == region], axis=0).max() < 1e-3
    return {region: colours[regions == region][0] for region in CENTERS}


def test_a_button_leads_to_where_the_surface_still_moves(widget, with_image):
    check, record = widget.running, widget.doc.record
    assert check.moving.isHidden()
    record.reached = replace(record.reached, state=replace(record.state, moving=(2.9, 1.5, 3.2)))
    widget.doc.ended.emit()
    assert not check.moving.isHidden()
    with_image.dims.ndisplay = 2
    check.moving.click()
    world = np.add((2.9, 1.5, 3.2), (1, 2, 3))
    assert with_image.dims.point[0] == pytest.approx(world[0], abs=0.2)
    assert camera_of(with_image).center[-2:] == pytest.approx(world[-2:], abs=0.05)
    record.reached = replace(record.reached, state=replace(record.state, moving=None))
    widget.doc.ended.emit()
    assert check.moving.isHidden()


def test_a_table_of_few_cells_leaves_no_empty_room(widget):
    table, rows = widget.results.table, widget.results.table.rows
    few = table.maximumHeight()
    assert few < 192, "as high as Qt would have it"
    table.show_rows([{**rows[0], "region": k} for k in range(1, 60)])
    assert table.maximumHeight() > 1000


def test_columns_have_titles_in_english():
    names = {column.key: column.name for column in COLUMNS}
    assert names["n_contacts"] == "contacts"
    assert names["gaussian_curvature_integral"] == "Gaussian curvature integral"


@pytest.mark.usefixtures("judged")
def test_that_a_fit_was_stopped_comes_before_its_grade(widget, spin):
    check = widget.running
    spin(lambda: widget.doc.result.judged is not None)
    assert check.grade.text().startswith("Poor: ")
    widget.doc.record.end("stopped", "stopped (3 iterations)")
    widget.doc.ended.emit()
    assert check.grade.text().startswith("Stopped before it converged, so poor: the cells explain")


@pytest.mark.usefixtures("judged")
def test_the_worst_place_is_told_by_where_it_is(widget, with_image, spin):
    check = widget.running
    spin(lambda: widget.doc.result.judged is not None)
    check.go_to_worst()
    worst = widget.doc.result.judged.found.spots[0]
    place = ", ".join(f"{at:.1f}" for at in worst.position)
    assert check.note.text().startswith(f"At ({place}) µm the image is ")
    assert with_image.dims.point[0] == pytest.approx(worst.position[0] + 1, abs=SIZE[0])


def test_what_is_looked_at_and_the_brush_have_units(widget):
    check, scale = widget.running, widget.running.scale
    assert scale.isHidden()
    check.view.setCurrentText("residual")
    assert "in standard deviations of the noise" in scale.text()
    assert not scale.isHidden()
    check.view.setCurrentText("rendered")
    assert scale.isHidden()
    check.edit.use("nudge")
    assert check.edit.unit.text() == "radius, µm"
    assert not check.edit.brush.isHidden()
    check.edit.use(None)
    assert check.edit.brush.isHidden()


def test_what_is_to_be_said_of_the_cell_chosen_is_said(widget):
    results = widget.results
    row = dict(results.table.rows[0]) | {"note": "it is dim (--effects auto)", "grade": "fair"}
    rows = [row, {**results.table.rows[1], "note": ""}]
    results.table.show_rows(rows)
    results.table.choose([3])
    assert results.why.text() == "It is dim (see Corrections)."
    row = {"grade": "fair", "note": "it is dim; no pressure: it touches no other cell"}
    assert why_of(row) == "it is dim. Note: no pressure: it touches no other cell"
    assert why_of({"note": "no pressure: no"}) == "Note: no pressure: no"
    assert why_of({}) == ""
    results.table.choose([7])
    assert results.why.isHidden()
    results.table.choose([3, 7])
    assert results.why.isHidden()
    header = results.table.horizontalHeader()
    shown = [COLUMNS[header.logicalIndex(place)].key for place in range(3)]
    assert shown == ["region", "grade", "explained"], "they are seen in a narrow dock"


def test_a_click_chooses_the_row_and_leaves_the_view(widget, with_image):
    with_image.dims.set_point(0, 1 + CENTER[0])
    scene = getattr(with_image, "scene", with_image)
    scene.camera.zoom, scene.camera.center = 100, (0, 4, 5)
    click(widget, with_image, CENTERS[7])
    assert widget.results.table.chosen_regions() == (7,)
    assert widget.doc.link.contours.chosen == {7}
    assert tuple(scene.camera.center[-2:]) == (4, 5)
    click(widget, with_image, CENTERS[3], "Control")
    assert widget.doc.link.contours.chosen == {3, 7}
    click(widget, with_image, CENTERS[3], "Control")
    assert widget.doc.link.contours.chosen == {7}
    click(widget, with_image, (2.9, 0, 0))
    assert widget.doc.link.contours.chosen == frozenset()


def click(widget, viewer, um, *modifiers):
    event = SimpleNamespace(
        position=tuple(widget.doc.link.frame.to_world(um)),
        pos=np.zeros(2),
        type="mouse_press",
        button=1,
        handled=False,
        modifiers=modifiers,
        dims_displayed=[1, 2],
    )
    steps = [callback(viewer, event) for callback in list(viewer.mouse_drag_callbacks)[-1:]]
    for step in steps:
        next(step, None)
        event.type = "mouse_release"
        next(step, None)


# ---- the command, when the file is no longer what is shown ---------------------------------------


@pytest.fixture
def from_file(make_widget, with_image, pixels, tmp_path, monkeypatch, spin):
    """A widget whose image was opened from a file, with a seed; a click copies the command."""
    write_image(tmp_path / "image.tif", pixels, SIZE)
    del with_image.layers["cell"]
    with layer_source(path=str(tmp_path / "image.tif")):
        layer = with_image.add_image(pixels, scale=SIZE)
    widget = make_widget()
    with_image.add_points([CENTER], name="seeds", ndim=3)
    monkeypatch.setattr(more_actions.QFileDialog, "getExistingDirectory", lambda *a: str(tmp_path))

    def copied():
        widget.commands.copy_action.trigger()
        spin(lambda: not widget.commands.background.busy)
        words = shlex.split(more_actions.QApplication.clipboard().text())
        job = gather(build_parser().parse_args(words[1:]), Notes())
        return words[2], job.as_read

    return layer, copied, tmp_path


def test_the_file_is_used_where_it_holds_what_is_shown(from_file, pixels):
    _, copied, folder = from_file
    path, image = copied()
    assert path == str(folder / "image.tif")
    np.testing.assert_array_equal(image, pixels)


@pytest.mark.filterwarnings("ignore:1 hot voxel")
def test_edited_pixels_are_saved_beside_the_file(from_file, pixels):
    layer, copied, folder = from_file
    edited = pixels.copy()
    edited[3, 4, 5] = 1000
    layer.data = edited
    path, image = copied()
    assert path == str(folder / "image-1.tif"), "the user's file is not touched"
    np.testing.assert_array_equal(image, edited)
    np.testing.assert_array_equal(read_image(folder / "image.tif")[0], pixels)


def test_a_crop_is_saved_too(from_file, pixels):
    layer, copied, folder = from_file
    layer.data = pixels[:, :20]
    path, image = copied()
    assert path != str(folder / "image.tif")
    np.testing.assert_array_equal(image, pixels[:, :20])


def test_a_file_that_is_gone(from_file, pixels):
    _, copied, folder = from_file
    (folder / "image.tif").unlink()
    path, image = copied()
    assert path == str(folder / "image.tif")
    np.testing.assert_array_equal(image, pixels)


def swatch(table):
    """The colour beside the number of the first cell, RGBA up to 1."""
    return table.item(0, 0).data(Qt.ItemDataRole.DecorationRole).getRgbF()


@pytest.mark.usefixtures("judged")
def test_cells_are_coloured_by_a_column_and_described(ended, spin):
    results, link = ended.results, ended.doc.link
    spin(lambda: ended.doc.result.judged is not None, seconds=60)
    own = np.array(link.surface.data[2])
    at = results.colour.findData("volume_um3")
    assert at > 0
    results.colour.setCurrentIndex(at)
    volume = results.table.numbers("volume_um3")[1]
    np.testing.assert_allclose(link.surface.data[2], volume)
    assert "volume" in results.scale.text()
    assert link.surface.features["volume_um3"].to_numpy() == pytest.approx(volume)
    assert len(link.surface.features) == len(link.surface.data[0])
    assert swatch(results.table) == pytest.approx(link.contours.layer.edge_color[0], abs=0.01)
    results.colour.setCurrentIndex(0)
    assert swatch(results.table) == pytest.approx(region_colours(1), abs=0.01)
    np.testing.assert_array_equal(link.surface.data[2], own)
    assert results.scale.text() == ""


@pytest.mark.usefixtures("judged")
def test_columns_are_chosen(ended, spin):
    table = ended.results.table
    spin(lambda: ended.doc.result.judged is not None, seconds=60)
    keys = [column.key for column in COLUMNS]
    assert table.isColumnHidden(keys.index("half_axis_1_um"))
    table.show_column("half_axis_1_um")
    assert not table.isColumnHidden(keys.index("half_axis_1_um"))
    assert "half axis 1, µm" in table.as_text().splitlines()[0]
    menu = ended.results.columns.menu()
    menu.aboutToShow.emit()
    chosen = {action.text(): action for action in menu.actions()}
    assert chosen["half axis 1, µm"].isChecked()
    chosen["half axis 1, µm"].setChecked(False)
    assert table.isColumnHidden(keys.index("half_axis_1_um"))
    assert table.isColumnHidden(keys.index("pressure_per_um"))  # one cell has none
    table.show_column("pressure_per_um")
    assert table.isColumnHidden(keys.index("pressure_per_um"))


@pytest.mark.usefixtures("judged")
def test_the_result_becomes_a_labels_layer_with_measurements(ended, viewer, spin):
    spin(lambda: ended.doc.result.judged is not None, seconds=60)
    ended.results.add_labels()
    layer = viewer.layers["cell: labels"]
    inside = ended.doc.link.frame.voxel_size
    volume = np.count_nonzero(layer.data == 1) * np.prod(inside)
    assert volume == pytest.approx(ended.results.table.numbers("volume_um3")[1], rel=0.1)
    assert layer.features["volume_um3"].iloc[0] == ended.results.table.numbers("volume_um3")[1]
    assert layer.features["index"].tolist() == [1]
