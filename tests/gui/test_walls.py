"""Walls between cells: each cell has its own colour in the viewer, and layers stay meshes."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic import _writer
from napari_deltamic.geometry import load_mesh, mesh_from_labels
from napari_deltamic.gui.cell_source import mesh_of_surface
from napari_deltamic.gui.results.session_layers import mesh_layer, save_layer
from napari_deltamic.gui.viewing.colours import LIMITS, region_colormap, region_colours, side_values
from napari_deltamic.gui.viewing.frame import Frame
from napari_deltamic.gui.viewing.viewer_link import ViewerLink
from napari_deltamic.gui.viewing.walls import Apart, joined
from napari_deltamic.measure import section

SIZE = (1.0, 0.5, 0.5)


@pytest.fixture
def pair():
    """Two boxes that share a wall at X = 3, as regions 1 and 2."""
    labels = np.zeros((6, 12, 14), int)
    labels[1:5, 2:10, 1:7] = 1
    labels[1:5, 2:10, 7:13] = 2
    mesh = mesh_from_labels(labels, SIZE)
    assert (mesh.regions > 0).all(axis=1).any()
    return mesh


@pytest.fixture
def shown(viewer, pair):
    layer = viewer.add_image(np.zeros((6, 12, 14)), scale=SIZE, name="cell", units=("um",) * 3)
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.show_mesh(pair)
    return link


def test_colours_do_not_run_into_one_another(pair):
    apart = Apart.of(pair)
    assert 0 < len(apart.copies) < len(pair.vertices) / 2
    # All corners of a triangle lie between its two regions.
    sides = apart.sides[apart.faces]
    np.testing.assert_array_equal(sides, np.sort(pair.regions, axis=1)[:, None].repeat(3, axis=1))
    np.testing.assert_array_equal(
        apart.vertices(pair)[apart.faces], pair.vertices_numpy().astype(np.float32)[pair.faces]
    )


def test_cells_that_do_not_touch_are_drawn_as_they_are():
    ball = nd.geometry.sphere((0, 0, 0), 1, edge_length=0.5)
    two = nd.Mesh.merge([ball, ball.translated((3, 0, 0))])
    apart = Apart.of(two)
    assert apart.faces is two.faces
    assert not len(apart.copies)


def test_the_layer_is_the_mesh_again(shown, pair, tmp_path):
    layer, frame = shown.surface, shown.frame
    assert len(layer.data[0]) > len(pair.vertices)
    for found in (
        mesh_of_surface(layer, frame),
        mesh_of_surface(mesh_layer(pair, "m", frame), frame),
    ):
        np.testing.assert_array_equal(found.faces, pair.faces)
        np.testing.assert_array_equal(found.regions, pair.regions)
        np.testing.assert_allclose(found.vertices_numpy(), pair.vertices_numpy(), atol=1e-5)
    state = {"scale": layer.scale, "translate": layer.translate, "metadata": layer.metadata}
    _writer.write_surface(str(tmp_path / "a.rec"), layer.data, state)
    np.testing.assert_array_equal(load_mesh(tmp_path / "a.rec").faces, pair.faces)
    saved = save_layer(layer, (0, 0, 0), (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(saved.arrays["faces"], pair.faces)
    # A layer that was edited is taken as it is.
    moved = np.array(layer.data[0])
    moved[-1] += 0.1
    assert joined(moved, layer.data[1], layer.metadata)[0] is moved


def test_a_wall_has_the_colour_of_the_cell_that_is_chosen(shown, pair):
    low, high = LIMITS
    wall = (pair.regions > 0).all(axis=1)
    for region in (1, 2):
        shown.highlight(frozenset({region}))
        drawn = [k for k in range(len(wall)) if wall[shown.face_of(k)]]
        assert shown.face_of(len(wall)) is None
        values = np.asarray(shown.surface.data[2])[shown.surface.data[1][drawn]]
        colours = region_colormap().map((values.ravel() - low) / (high - low))
        assert np.abs(colours - region_colours(region)).max() < 1e-6
    assert (side_values(np.array([[1, 2]]), {3}) > high / 2).all()


def test_a_wall_is_drawn_on_both_sides_in_both_colours(viewer, shown, pair):
    layer = shown.contours.layer
    viewer.dims.set_point(0, 2.0)
    segments, faces = section(pair, 0, 2.0)
    walls = np.flatnonzero((pair.regions[faces] > 0).all(axis=1))
    n = len(segments)
    starts, colours = np.asarray(layer.data)[:, 0], np.asarray(layer.edge_color)
    assert len(walls) > 3
    assert len(starts) == n + len(walls)
    own = [np.abs(colours - region_colours(region)).max(axis=1) < 1e-6 for region in (1, 2)]
    assert (own[0] ^ own[1]).all()
    # The second copies of the wall are at the end; the first are beside them.
    first, second = starts[walls], starts[n:]
    region = 2 if own[1][-1] else 1
    distance = np.linalg.norm(first - second, axis=1)
    np.testing.assert_allclose(distance, layer.edge_width, rtol=0.02)
    assert own[region - 1][n:].all()
    assert not own[region - 1][walls].any()
    # Cell 2 lies at larger X.
    assert np.sign(np.median(second[:, 2] - first[:, 2])) == (1 if region == 2 else -1)


def test_contours_are_those_of_the_time_that_was_fitted(viewer, pair):
    layer = viewer.add_image(np.zeros((2, 6, 12, 14)), scale=(1, *SIZE), name="series")
    viewer.dims.set_point(0, 1)
    viewer.dims.set_point(1, 2.0)
    link = ViewerLink(viewer, layer, Frame.of(layer))
    link.show_mesh(pair)
    assert len(link.contours.layer.data)
    viewer.dims.set_point(0, 0)
    assert not len(link.contours.layer.data)
    link.take_time()  # a fit of this one
    link.show_mesh(pair)
    assert len(link.contours.layer.data)


def test_what_is_chosen_is_drawn_before_what_one_looks_through(shown, pair):
    shown.highlight(frozenset({2}))
    own = (pair.regions == 2).any(axis=1)
    order = [shown.face_of(k) for k in range(len(own))]
    assert sorted(order) == list(range(len(own)))
    assert own[order][: own.sum()].all()
    # The layer still is the mesh.
    found = mesh_of_surface(shown.surface, shown.frame)
    np.testing.assert_array_equal(found.faces, pair.faces[order])
    np.testing.assert_array_equal(found.regions, pair.regions[order])
    shown.highlight(frozenset())
    np.testing.assert_array_equal(mesh_of_surface(shown.surface, shown.frame).faces, pair.faces)


def test_in_3d_the_nearest_faces_of_cells_that_are_not_chosen_are_drawn_first(viewer, shown, spin):
    viewer.dims.ndisplay = 3
    shown.highlight(frozenset({2}))
    camera, layer = getattr(viewer, "scene", viewer).camera, shown.surface

    def in_order(axes=(0, 1, 2)):
        vertices, faces = layer.data[:2]
        chosen = (layer.metadata["deltamic"]["regions"] == 2).any(axis=1)
        assert 0 < chosen.sum() < len(chosen)
        assert (np.diff(chosen.astype(int)) <= 0).all(), "what is chosen comes first"
        depth = vertices[faces].mean(axis=1)[:, axes] @ np.array(camera.view_direction)
        return (np.diff(depth[~chosen]) >= -1e-5).all()

    assert in_order()
    camera.angles = (20, -70, 110)
    assert not in_order()
    spin(in_order)
    viewer.dims.order = (2, 0, 1)
    assert not in_order((2, 0, 1))
    spin(lambda: in_order((2, 0, 1)))
    changed = []
    layer.events.data.connect(changed.append)
    camera.angles = (0, 0, 90)
    spin(lambda: in_order((2, 0, 1)))
    assert not changed, "it is the same surface, which may be what a fit starts from"
    depth, *rest = map(str, camera.orientation)
    camera.orientation = ("away" if depth == "towards" else "towards", *rest)
    assert not in_order((2, 0, 1))
    spin(lambda: in_order((2, 0, 1)))
    viewer.dims.ndisplay = 2
    shown.highlight(frozenset({1}))
    shown.highlight(frozenset({2}))
    viewer.dims.ndisplay = 3
    spin(lambda: in_order((2, 0, 1)))
