"""Measured meshes in the files of other tools, and back."""

import csv

import numpy as np
import pytest
import tifffile
from benchmarks.double_bubble import DoubleBubble
from skimage.measure import regionprops

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.geometry.files.vtk import _Reader
from napari_deltamic.images.stacks import read_image
from napari_deltamic.measure import measure
from napari_deltamic.results.measured_files import MEASURED, write_measurements
from napari_deltamic.results.mesh_exchange import cells_apart, labels_grid, labels_of
from napari_deltamic.scene import Grid

CENTER = (6.0, 7.0, 8.0)


@pytest.fixture(scope="module")
def mesh():
    return DoubleBubble(3.0, (1.0, 0.9, 1.2), 0.1).mesh(0.5).translated(CENTER)


@pytest.fixture(scope="module")
def measured(mesh):
    return measure(mesh)


@pytest.fixture(scope="module")
def folder(mesh, measured, tmp_path_factory):
    place = tmp_path_factory.mktemp("out") / "new" / "measured"
    paths = write_measurements(place, mesh, measured, voxel_size=(0.2, 0.1, 0.1))
    names = [name for name in MEASURED if name != "measurements.html"]  # nobody asked for a page
    assert [p.name for p in paths] == names
    assert sorted(p.name for p in place.iterdir()) == sorted(names)
    return place


def test_tables(folder, measured):
    for table in measured.tables:
        text = (folder / f"{table.name}.csv").read_text()
        assert text == table.to_csv()
        assert len(list(csv.reader(text.splitlines()))) == 1 + len(table.rows)


@pytest.mark.parametrize("suffix", [".vtk", ".ply"])
def test_walls_are_the_mesh_itself(folder, mesh, suffix):
    again = nd.load_mesh(folder / f"walls{suffix}")
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    np.testing.assert_array_equal(again.regions, mesh.regions)


def vtk_numbers(path):
    reader = _Reader(path.read_bytes())
    reader.mesh()
    return reader.cell_data


def ply_numbers(path):
    import trimesh

    loaded = trimesh.load(path, process=False)
    data = loaded.metadata["_ply_raw"]["face"]["data"]
    return {name: np.asarray(data[name]).reshape(-1) for name in data.dtype.names[1:]}


@pytest.mark.parametrize(("suffix", "read"), [(".vtk", vtk_numbers), (".ply", ply_numbers)])
def test_faces_carry_the_numbers_of_their_wall_and_cell(folder, mesh, measured, suffix, read):
    walls = read(folder / f"walls{suffix}")
    _, wall = mesh.interfaces()
    for name in ("area_um2", "tension", "mean_curvature_per_um"):
        expected = np.array(measured.walls.values(name), float)[wall]
        np.testing.assert_array_equal(walls[name], expected)
    cells = read(folder / f"cells{suffix}")
    own = cells["region_a"].astype(int) - 1
    assert set(own) == {0, 1}
    for name in ("volume_um3", "sphericity", "n_contacts"):
        np.testing.assert_array_equal(cells[name], np.array(measured.cells.values(name))[own])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["walls", "cells"])
def test_vtk_through_pyvista_loses_nothing(folder, mesh, measured, name):
    pyvista = pytest.importorskip("pyvista")
    read = pyvista.read(folder / f"{name}.vtk")
    table = measured.walls if name == "walls" else measured.cells
    if name == "walls":
        expected, row = mesh, mesh.interfaces()[1]
    else:
        expected, _ = cells_apart(mesh, measured)
        row = expected.regions.max(axis=1) - 1
    # Files hold x, y, z.
    np.testing.assert_array_equal(np.asarray(read.points)[:, ::-1], expected.vertices)
    corners = np.asarray(read.faces).reshape(-1, 4)
    assert (corners[:, 0] == 3).all()
    sets = [np.sort(faces, axis=1) for faces in (corners[:, 1:], expected.faces)]
    np.testing.assert_array_equal(*sets)
    numbers = [c.name for c in table.columns if c.name in read.cell_data]
    assert len(numbers) >= 9
    for column in numbers:
        values = [np.nan if v is None else v for v in table.values(column)]
        np.testing.assert_array_equal(read.cell_data[column], np.array(values, float)[row])
    for region in (0, 1):
        side = f"region_{'ab'[region]}"
        np.testing.assert_array_equal(read.cell_data[side], expected.regions[:, region])


def test_cells_apart_are_closed_and_share_nothing(mesh, measured):
    apart, numbers = cells_apart(mesh, measured)
    assert apart.is_closed()
    assert apart.volumes() == pytest.approx(mesh.volumes())
    first = set(apart.faces[apart.regions[:, 0] == 1].ravel())
    assert not first & set(apart.faces[apart.regions[:, 0] == 2].ravel())
    assert all(len(values) == len(apart.faces) for values in numbers.values())
    assert "note" not in numbers
    assert "density" not in numbers  # nothing is known of it


def test_labels_have_the_volumes_of_the_cells(folder, mesh):
    labels, size = read_image(folder / "labels.ome.tif")
    assert size == pytest.approx((0.2, 0.1, 0.1))
    with tifffile.TiffFile(folder / "labels.ome.tif") as file:
        assert file.is_ome
        assert 'PhysicalSizeZUnit="µm"' in file.ome_metadata
    volumes = mesh.volumes()
    for found in regionprops(labels, spacing=size):
        assert found.area == pytest.approx(volumes[found.label], rel=0.01)
        (row,) = [r for r in measure(mesh).cells.rows if r["region"] == found.label]
        place = [row[f"centroid_{x}_um"] for x in "zyx"]
        assert found.centroid == pytest.approx(place, abs=0.03)  # the first voxel lies at 0


def test_labels_fill_the_block_of_the_image(mesh):
    image = Grid((20, 40, 44), (0.6, 0.4, 0.4), (1.0, 0.5, 2.0))
    fine = labels_grid(mesh, (0.3, 0.2, 0.1), image)
    assert fine.shape == (40, 80, 176)
    low, high = (np.asarray(e) for e in fine.extent)
    half = np.asarray(fine.voxel_size) / 2
    begin = np.asarray(image.origin) - np.asarray(image.voxel_size) / 2
    np.testing.assert_allclose(low - half, begin)
    np.testing.assert_allclose(high + half - begin, np.array(image.shape) * image.voxel_size)


def test_labels_of_a_mesh_below_zero_begin_there():
    mesh = sphere((-3, 0, 3), 1.0)
    grid = labels_grid(mesh, (0.5, 0.5, 0.5), None)
    assert np.all(np.asarray(grid.extent[0]) < mesh.bounds()[0])
    assert np.all(np.asarray(grid.extent[1]) > mesh.bounds()[1])
    np.testing.assert_allclose(np.mod(grid.origin, 0.5), 0)
    assert labels_of(mesh, grid).sum() > 0


def test_open_cells_are_not_in_the_labels():
    ball, bowl = sphere((3, 3, 3), 2.0), sphere((3, 3, 9), 2.0)
    both = Mesh.merge([ball, Mesh(bowl.vertices, bowl.faces[9:])])
    grid = labels_grid(both, (0.5, 0.5, 0.5), None)
    assert set(np.unique(labels_of(both, grid))) == {0, 1}
    alone = Mesh(bowl.vertices, bowl.faces[9:])
    assert labels_of(alone, grid).max() == 0


def test_without_a_voxel_size_there_are_no_labels(mesh, measured, tmp_path):
    paths = write_measurements(tmp_path, mesh, measured)
    assert "labels.ome.tif" not in [p.name for p in paths]


@pytest.mark.parametrize(
    ("size", "says"), [((0, 1, 1), "positive"), ((1e-6, 1e-6, 1e-6), "too small")]
)
def test_voxels_that_cannot_be(mesh, measured, tmp_path, size, says):
    with pytest.raises(InputError, match=says):
        write_measurements(tmp_path / "x", mesh, measured, voxel_size=size)
    assert not (tmp_path / "x").exists()


def test_attributes_have_no_place_in_other_files(mesh, tmp_path):
    with pytest.raises(InputError, match=r"only \.ply and \.vtk"):
        nd.save_mesh(mesh, tmp_path / "a.obj", {"x": np.ones(len(mesh.faces))})
