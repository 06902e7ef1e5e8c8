"""Rows of the table and cells in the viewer: choosing one chooses the other."""

from types import SimpleNamespace

import numpy as np
import pytest
from napari.layers import Image
from qtpy.QtCore import QEvent, Qt
from qtpy.QtGui import QKeyEvent
from qtpy.QtWidgets import QApplication

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.gui.cell_table import CellTable
from napari_deltamic.gui.results.results_panel import ClickSelection, region_at
from napari_deltamic.gui.viewing.colours import (
    LIMITS,
    region_colormap,
    region_colours,
    side_values,
)
from napari_deltamic.gui.viewing.frame import Frame
from napari_deltamic.gui.viewing.viewer_link import ViewerLink
from napari_deltamic.measure import measure_cells
from napari_deltamic.measure.picking import region_in_slice

CENTERS = {2: (2.0, 2.0, 2.0), 5: (2.0, 2.0, 5.0), 9: (2.0, 5.5, 2.0)}
RADII = {2: 0.8, 5: 1.2, 9: 1.0}


def cells():
    """Three cells, numbered anyhow; the last lies across."""
    parts = []
    for number, center in CENTERS.items():
        ball = sphere(center, RADII[number], edge_length=0.4)
        parts.append(nd.Mesh(ball.vertices, ball.faces, np.tile([number, 0], (len(ball.faces), 1))))
    return nd.Mesh.merge(parts)


@pytest.fixture
def link(viewer):
    """The cells shown in a frame whose axes have different units, and an origin."""
    layer = Image(
        np.zeros((20, 40, 40), np.float32),
        scale=(200, 0.2, 0.2),
        translate=(1000, -3, 7),
        units=("nm", "um", "um"),
    )
    viewer.add_layer(layer)
    getattr(viewer, "scene", viewer).camera.zoom = 100  # px in a um
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.show_mesh(cells())
    yield link
    link.close()


def at(link, um, **more):
    """A click at a place (um), as napari tells of it."""
    return SimpleNamespace(
        position=tuple(link.frame.to_world(um)), dims_displayed=[0, 1, 2], modifiers=[], **more
    )


@pytest.mark.parametrize("region", CENTERS)
def test_a_click_in_a_contour_finds_its_cell(viewer, link, region):
    center = np.array(CENTERS[region])
    viewer.dims.set_point(0, float(link.frame.to_world(center)[0]))
    assert region_at(link, at(link, np.add(center, (0, 0.3, -0.4)))) == region


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_inside_near_and_far_in_slices_across_any_axis(axis):
    mesh = cells()
    center = np.array(CENTERS[5])
    along = np.eye(3)[(axis + 1) % 3]
    assert region_in_slice(mesh, axis, center, 0.1) == 5
    assert region_in_slice(mesh, axis, center + 0.99 * 1.2 * along, 0.1) == 5
    assert region_in_slice(mesh, axis, center + (1.2 + 0.05) * along, 0.1) == 5
    assert region_in_slice(mesh, axis, center + (1.2 + 0.15) * along, 0.1) == 0
    assert region_in_slice(mesh, axis, center + 20 * np.eye(3)[axis], 0.1) == 0


def test_of_cells_within_one_another_the_inner_one_is_found():
    outer, inner = sphere((0, 0, 0), 2, edge_length=0.4), sphere((0, 0, 0), 1, edge_length=0.4)
    mesh = nd.Mesh.merge([outer, inner])
    assert region_in_slice(mesh, 0, np.array([0, 0.2, 0.1]), 0.1) == 2
    assert region_in_slice(mesh, 0, np.array([0, 1.7, 0.1]), 0.1) == 1


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0)])
def test_a_click_in_3d_finds_the_cell_in_front(viewer, link, direction):
    """Along X, cells 2 and 5 lie behind one another; along Y, 2 and 9."""
    viewer.dims.ndisplay = 3
    direction = np.array(direction, float)
    target = np.array(CENTERS[2])
    first = {(0, 0, 1): 2, (0, 0, -1): 5, (0, 1, 0): 2, (0, -1, 0): 9}[tuple(direction)]
    event = at(link, target - 20 * direction, view_direction=direction)
    assert region_at(link, event) == first
    beside = at(link, target - 20 * direction + (1.5, 0, 0), view_direction=direction)
    assert region_at(link, beside) == 0


def test_of_a_wall_the_cell_behind_it_is_meant():
    from napari_deltamic.measure.picking import region_behind

    ball = sphere((0, 0, 0), 1, edge_length=0.5)
    wall = nd.Mesh(ball.vertices, ball.faces, np.tile([3, 4], (len(ball.faces), 1)))
    face = int(np.argmax(wall.normals()[:, 2]))  # normals point out of region 3 into region 4
    assert region_behind(wall, face, np.array([0, 0, -1.0])) == 3
    assert region_behind(wall, face, np.array([0, 0, 1.0])) == 4


# ---- what is chosen is seen ----------------------------------------------------------------------


def colours(layer):
    low, high = LIMITS
    return region_colormap().map((np.asarray(layer.data[2]) - low) / (high - low))


def of_region(mesh, region):
    return np.unique(mesh.faces[(mesh.regions == region).any(axis=1)])


def test_cells_that_are_not_chosen_are_dimmed_through_live_updates(link):
    mesh = link.mesh
    before = np.array(link.surface.data[2])
    link.highlight(frozenset({2, 9}))
    link.show_mesh(mesh.with_vertices(mesh.vertices_numpy() + 0.01))
    shown = colours(link.surface)
    for region in CENTERS:
        chosen = region in (2, 9)
        expected = region_colours(region) if chosen else region_colours(region, {2, 9})
        found = shown[of_region(mesh, region)]
        assert np.abs(found - expected)[:, :3].max() < 1e-6
        assert (found[:, 3] == 1).all() == chosen  # one looks through the others
    assert np.ptp(region_colours(5, {2})[:3]) < 0.4 * np.ptp(region_colours(5)[:3])
    link.show_mesh(cells())  # other faces
    assert np.ptp(colours(link.surface)[of_region(mesh, 5)][0, :3]) < 0.3
    link.highlight(frozenset())
    np.testing.assert_array_equal(link.surface.data[2], before)


def test_contours_are_dimmed_too(viewer, link):
    viewer.dims.set_point(0, float(link.frame.to_world(CENTERS[2])[0]))
    link.highlight(frozenset({5}))
    shown = np.unique(link.contours.layer.edge_color, axis=0)
    expected = np.unique([region_colours(r, {5}) for r in CENTERS], axis=0)
    np.testing.assert_allclose(shown, expected, atol=1e-6)


def test_nothing_chosen_costs_nothing(link, monkeypatch):
    """Values are neither computed nor changed by updates of the same mesh."""
    values = link.surface.data[2]
    monkeypatch.setattr("napari_deltamic.gui.viewing.mesh_layers.side_values", None)
    link.show_mesh(link.mesh.with_vertices(link.mesh.vertices_numpy() + 0.01))
    link.highlight(frozenset())
    np.testing.assert_array_equal(link.surface.data[2], values)


def test_a_wall_is_bright_where_either_cell_is_chosen():
    wall = np.tile([3, 4], (9, 1))
    for region in (3, 4):
        assert (side_values(wall, {region}) == region - 0.5).all()
    assert (side_values(wall, {1}) > LIMITS[1] / 2).all()


# ---- clicks --------------------------------------------------------------------------------------


@pytest.fixture
def clicked(viewer, link):
    """Clicks that were told, and a way to click."""
    told = []
    selection = ClickSelection(viewer, lambda: link, lambda region, add: told.append((region, add)))

    def click(um, *, modifiers=(), moved=0, button=1, handled=False):
        event = at(link, um, pos=np.zeros(2), type="mouse_press", button=button)
        event.handled = handled
        event.modifiers = list(modifiers)
        for callback in list(viewer.mouse_drag_callbacks):
            if callback != selection.presses.callback:
                continue
            steps = callback(viewer, event)
            next(steps, None)
            event.type, event.pos = "mouse_move", np.array([moved, 0])
            next(steps, None)
            event.type = "mouse_release"
            next(steps, None)

    click.told, click.selection = told, selection
    return click


def test_clicks_choose_and_drags_do_not(viewer, link, clicked):
    viewer.dims.set_point(0, float(link.frame.to_world(CENTERS[2])[0]))
    clicked(CENTERS[2])
    clicked(CENTERS[5], modifiers=["Control"])
    clicked(CENTERS[5], modifiers=["Shift"], moved=2)
    clicked((2, 2, 8), modifiers=[])
    clicked(CENTERS[2], moved=30)
    clicked(CENTERS[2], button=2)
    clicked(CENTERS[2], handled=True)
    assert clicked.told == [(2, False), (5, True), (5, True), (0, False)]


def test_clicks_that_place_points_choose_nothing(viewer, link, clicked):
    points = viewer.add_points(ndim=3)
    points.mode = "add"
    clicked(CENTERS[2])
    assert clicked.told == []
    points.mode = "pan_zoom"
    clicked(CENTERS[2])
    assert len(clicked.told) == 1


def test_after_closing_the_viewer_has_no_callback(viewer, clicked):
    assert clicked.selection.presses.callback in viewer.mouse_drag_callbacks
    clicked.selection.presses.listen(False)
    assert clicked.selection.presses.callback not in viewer.mouse_drag_callbacks
    clicked.selection.presses.listen(False)


# ---- the table -----------------------------------------------------------------------------------


@pytest.fixture
def table(app):
    table = CellTable()
    table.told = []
    table.chosen.connect(lambda regions, by_hand: table.told.append((regions, by_hand)))
    table.show_rows(measure_cells(cells()))
    return table


def column(table, number):
    return [table.item(row, number).text() for row in range(table.rowCount())]


def test_sorting_is_by_number_and_keeps_what_is_chosen(table):
    assert column(table, 0) == ["2", "5", "9"]
    table.choose([9])
    table.sortByColumn(1, Qt.SortOrder.DescendingOrder)
    assert column(table, 0) == ["5", "9", "2"]  # by volume
    assert table.chosen_regions() == (9,)
    rows = measure_cells(cells())
    rows[0]["volume_um3"] = float("nan")  # of cell 2: an open surface
    rows[1]["volume_um3"] = 1000.0
    table.show_rows(rows)
    table.sortByColumn(1, Qt.SortOrder.AscendingOrder)
    assert column(table, 0) == ["9", "5", "2"]
    assert column(table, 1)[-1] == "-"
    assert table.chosen_regions() == (9,)


def test_titles_are_in_voxels_where_nobody_knows_their_size(table):
    assert table.horizontalHeaderItem(1).text() == "volume\nµm³"
    table.show_rows(measure_cells(cells()), length="voxels")
    assert table.horizontalHeaderItem(1).text() == "volume\nvoxels³"
    assert "area, voxels²" in table.as_text().splitlines()[0]
    assert not any("µm" in column.name for column in table.known_columns())


def test_rows_chosen_by_hand_are_told_in_order(table):
    table.selectRow(1)
    assert table.told == [((5,), True)]
    assert table.center(5) == pytest.approx(CENTERS[5], abs=0.02)
    table.choose({2, 9})
    assert table.told[-1] == ((2, 9), False)
    table.setSelectionMode(table.SelectionMode.MultiSelection)
    table.selectRow(1)
    assert table.told[-1] == ((2, 9, 5), True), "the newest comes last"
    table.clearSelection()
    assert table.told[-1] == ((), True)


def test_cells_that_are_gone_are_not_chosen_any_more(table):
    table.choose({2, 9})
    table.show_rows(measure_cells(cells())[:2])
    assert table.chosen_regions() == (2,)
    assert table.told[-1] == ((2,), False)


def test_copying_gives_numbers_for_a_spreadsheet(table, app):
    table.sortByColumn(1, Qt.SortOrder.DescendingOrder)
    lines = table.as_text().splitlines()
    assert lines[0].split("\t") == ["cell", "volume, µm³", "area, µm²", "sphericity"]
    assert [line.split("\t")[0] for line in lines[1:]] == ["5", "9", "2"]
    assert float(lines[1].split("\t")[1]) == pytest.approx(4 / 3 * np.pi * 1.2**3, rel=0.05)
    table.choose({9})
    copy = QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    QApplication.sendEvent(table, copy)
    text = QApplication.clipboard().text()
    assert [line.split("\t")[0] for line in text.splitlines()] == ["cell", "9"]
