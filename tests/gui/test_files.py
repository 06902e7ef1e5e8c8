"""Mesh files in and out of napari, and the samples."""

import numpy as np
import pytest
from napari.layers import Image, Layer, Surface

import napari_deltamic as nd
from napari_deltamic import _reader, _writer
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere
from napari_deltamic.gui.cell_source import mesh_of_surface
from napari_deltamic.gui.image_source import ImageSource
from napari_deltamic.scene import samples as _sample_data


@pytest.fixture
def cells():
    """Two cells with the numbers 2 and 5."""
    parts = []
    for number, x in ((2, 1.0), (5, 4.0)):
        ball = sphere((1, 1, x), 0.8)
        parts.append(nd.Mesh(ball.vertices, ball.faces, np.tile([number, 0], (len(ball.faces), 1))))
    return nd.Mesh.merge(parts)


@pytest.mark.parametrize("extension", [".ply", ".rec", ".obj"])
def test_a_mesh_file_goes_through_napari_and_back(cells, tmp_path, extension):
    first, second = tmp_path / f"a{extension}", tmp_path / f"b{extension}"
    nd.save_mesh(cells, first)
    data, options, kind = _reader.get_reader(str(first))(str(first))[0]
    layer = Surface(data, **options)
    assert (kind, layer.name) == ("surface", "a")
    data, attributes, _ = layer.as_layer_data_tuple()
    assert _writer.write_surface(str(second), data, attributes) == [str(second)]
    mesh = nd.load_mesh(second)
    np.testing.assert_allclose(mesh.vertices_numpy(), cells.vertices_numpy(), atol=1e-6)
    assert mesh.region_ids().tolist() == [2, 5]


def test_each_region_has_its_colour(cells, tmp_path):
    nd.save_mesh(cells, tmp_path / "a.ply")
    layer = Layer.create(*read(tmp_path / "a.ply"))
    low, high = layer.contrast_limits
    colours = layer.colormap.map((np.unique(layer.data[2]) - low) / (high - low))
    assert len(np.unique(colours, axis=0)) == 2


def test_other_files_are_left_to_others(tmp_path):
    assert _reader.get_reader("image.tif") is None
    assert _reader.get_reader(["a.ply", "b.tif"]) is None
    with pytest.raises(InputError, match="no such file"):
        _reader.read_meshes(str(tmp_path / "none.ply"))


def test_scale_translation_and_units_are_honoured(tmp_path):
    ball = sphere((0, 0, 0), 1)
    layer = Surface(
        (ball.vertices, ball.faces),
        scale=(100, 200, 300),
        translate=(0, 0, 1000),
        units=("nm",) * 3,
    )
    data, attributes, _ = layer.as_layer_data_tuple()
    _writer.write_surface(str(tmp_path / "a.stl"), data, attributes)
    low, high = nd.load_mesh(tmp_path / "a.stl").bounds()
    np.testing.assert_allclose(low, (-0.1, -0.2, 0.7), atol=1e-6)
    np.testing.assert_allclose(high, (0.1, 0.2, 1.3), atol=1e-6)


def test_layers_of_a_fit_are_written_from_the_first_voxel(tmp_path):
    ball = sphere((1, 1, 1), 0.5)
    layer = Surface(
        (ball.vertices, ball.faces), translate=(7, 8, 9), metadata={"deltamic": {"fit": True}}
    )
    data, attributes, _ = layer.as_layer_data_tuple()
    _writer.write_surface(str(tmp_path / "a.ply"), data, attributes)
    assert nd.load_mesh(tmp_path / "a.ply").vertices_numpy().mean(axis=0) == pytest.approx(
        (1, 1, 1)
    )


@pytest.mark.parametrize("name", ["vesicle", "two_cells", "dividing_cell", "foam"])
def test_samples_are_images_with_a_voxel_size(name):
    data, options, kind = getattr(_sample_data, name)()[0]
    assert kind == "image"
    layer = Image(data, **options)
    assert layer.ndim == 3
    assert not np.allclose(layer.scale, 1)
    assert str(layer.units[0]) == "micrometer"


@pytest.mark.parametrize(
    "make", ["vesicle_sample", "two_cell_sample", "dividing_cell_sample", "foam_sample"]
)
def test_samples_lie_within_their_image(make):
    sample = getattr(_sample_data, make)()
    low, high = sample.truth.bounds()
    first, last = sample.grid.extent
    room = 3 * np.array(sample.optics.sigma_um)
    assert (low > first + room).all()
    assert (high < last - room).all()
    assert len(sample.centers) == len(sample.truth.region_ids())


def test_cells_of_the_foam_touch_but_each_has_its_own_surface():
    sample = _sample_data.foam_sample()
    assert sample.truth.is_closed()
    assert len(sample.centers) == 8
    volumes = np.array(list(sample.truth.volumes().values()))
    assert volumes.max() < 1.3 * volumes.min()
    nearest = np.sort(np.linalg.norm(sample.centers[:, None] - sample.centers, axis=2), axis=1)
    assert (nearest[:, 3] < 1.2 * np.cbrt(6 / np.pi * volumes)).all()  # three neighbours at least


def test_a_mesh_file_lands_on_an_image_that_lies_elsewhere(cells, viewer, tmp_path):
    """Files count from the first voxel; so do those that are saved again, wherever it lies."""
    nd.save_mesh(cells, tmp_path / "a.ply")
    image = Image(
        np.zeros((4, 5, 6)), scale=(500, 200, 200), translate=(1000, 0, -500), units=("nm",) * 3
    )
    before, after = (Layer.create(*read(tmp_path / "a.ply")) for _ in range(2))
    viewer.add_layer(before)
    viewer.add_layer(image)
    panel = ImageSource(viewer)
    viewer.add_layer(after)
    frame = panel.frame()
    for layer in (before, after):
        mesh = mesh_of_surface(layer, frame)
        np.testing.assert_allclose(mesh.vertices_numpy(), cells.vertices_numpy(), atol=1e-9)
        data, attributes, _ = layer.as_layer_data_tuple()
        _writer.write_surface(str(tmp_path / "b.ply"), data, attributes)
        again = nd.load_mesh(tmp_path / "b.ply")
        np.testing.assert_allclose(again.vertices_numpy(), cells.vertices_numpy(), atol=1e-9)
    panel.close_links()


def test_a_mesh_file_stays_where_the_user_or_another_image_has_it(cells, viewer, tmp_path):
    nd.save_mesh(cells, tmp_path / "a.ply")
    viewer.add_image(np.zeros((4, 5, 6)), name="at zero")
    panel = ImageSource(viewer)
    placed, moved = (Layer.create(*read(tmp_path / "a.ply")) for _ in range(2))
    viewer.add_layer(placed)
    moved.translate = (0, 0, 7)
    viewer.add_image(np.zeros((4, 5, 6)), translate=(3, 3, 3), name="elsewhere")
    panel.choose(viewer.layers["elsewhere"])
    viewer.add_layer(moved)
    assert tuple(placed.translate) == (0, 0, 0)
    assert tuple(moved.translate) == (0, 0, 7)
    panel.close_links()


def read(path):
    return _reader.read_meshes(str(path))[0]
