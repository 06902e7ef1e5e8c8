import contextlib
import os
import struct
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_mesh import two_cubes

from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry import Mesh, load_mesh, save_mesh, sphere

KINDS = ["obj", "off", "ply", "stl", "rec", "vtk"]
HARD = [
    "cgal__degtri_sliding.off",
    "igl__truck.obj",
    "manifold__Generic_Twin_7863.1.t0_left.obj",
    "manifold__Offset1.obj",
    "thingi10k__65004.stl",
    "trimesh__bunny.ply",
    "trimesh__empty.obj",
    "trimesh__multibody.stl",
    "trimesh__notenoughindices.obj",
    "trimesh__points_emptyface.ply",
]
REFUSED = {"trimesh__empty.obj", "trimesh__points_emptyface.ply"}


def canonical(mesh: Mesh) -> Mesh:
    """Larger region first, as load_mesh gives it."""
    turned = mesh.regions[:, :1] < mesh.regions[:, 1:]
    return Mesh(
        mesh.vertices,
        np.where(turned, mesh.faces[:, ::-1], mesh.faces),
        np.where(turned, mesh.regions[:, ::-1], mesh.regions),
    )


def corners(mesh):
    """Faces by position and regions, in an order that does not depend on that of the file."""
    points = mesh.vertices[mesh.faces].round(6)
    first = np.lexsort(points.transpose(2, 0, 1), axis=1)[:, 0]
    turned = np.stack([np.roll(p, -k, axis=0) for p, k in zip(points, first, strict=True)])
    table = np.column_stack([turned.reshape(len(turned), -1), mesh.regions])
    return table[np.lexsort(table.T)] + 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_round_trip(kind, tmp_path):
    mesh = sphere((10, 20, 30.123456789012345), (1, 2, 3), subdivisions=2)
    save_mesh(mesh, tmp_path / f"cell.{kind}")
    result = load_mesh(tmp_path / f"cell.{kind}")
    assert result.is_closed()
    assert_allclose(result.region_volume(1), mesh.region_volume(1), rtol=1e-5)
    assert_allclose(result.bounds(), mesh.bounds(), rtol=1e-6)
    if kind != "stl":  # which has no vertex order, and 7 digits
        assert_array_equal(result.vertices, mesh.vertices)
        assert_array_equal(result.faces, mesh.faces)
    assert os.listdir(tmp_path) == [f"cell.{kind}"]


@pytest.mark.parametrize("kind", ["obj", "ply", "rec", "vtk"])
def test_round_trip_of_regions(kind, tmp_path):
    mesh = two_cubes()
    save_mesh(mesh, tmp_path / f"cells.{kind}")
    result = load_mesh(tmp_path / f"cells.{kind}")
    assert_array_equal(corners(result), corners(canonical(mesh)))
    assert result.volumes() == pytest.approx({1: 1.0, 2: 1.0})


@pytest.mark.parametrize("kind", ["stl", "off"])
def test_formats_without_regions_say_so(kind, tmp_path):
    path = tmp_path / f"cells.{kind}"
    with pytest.warns(UserWarning, match="cannot hold regions"):
        save_mesh(two_cubes(), path)
    with pytest.warns(RepairWarning, match="open"):  # three walls of one region meet in an edge
        assert len(load_mesh(path).faces) == 22


@pytest.mark.parametrize("kind", KINDS)
def test_files_hold_x_y_z(kind, tmp_path):
    import trimesh

    mesh = sphere((1, 2, 3), (0.1, 0.2, 0.3), subdivisions=1)
    path = tmp_path / f"cell.{kind}"
    save_mesh(mesh, path)
    if kind == "rec":
        xyz = np.array(path.read_text().split()[1 : 1 + 3 * len(mesh.vertices)], dtype=float)
        assert_allclose(xyz.reshape(-1, 3).mean(axis=0), [3, 2, 1])
        return
    if kind == "vtk":
        data = path.read_bytes()
        xyz = np.frombuffer(data, ">f8", mesh.vertices.size, data.index(b"double\n") + 7)
        assert_allclose(xyz.reshape(-1, 3).mean(axis=0), [3, 2, 1])
        return
    other = trimesh.load(path, process=True)
    assert_allclose(other.vertices.mean(axis=0), [3, 2, 1], rtol=1e-6)
    assert_allclose(other.volume, mesh.region_volume(1), rtol=1e-5)
    assert other.is_watertight


def test_regions_with_outside_first_are_written_outward(tmp_path):
    mesh = sphere((0, 0, 0), 1.0)
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.regions[:, ::-1])
    for kind in KINDS:
        save_mesh(turned, tmp_path / f"cell.{kind}")
        assert load_mesh(tmp_path / f"cell.{kind}").region_volume(1) > 0


def test_binary_rec(tmp_path):
    mesh = two_cubes()
    path = tmp_path / "cells.rec"
    data = struct.pack("<Q", len(mesh.vertices)) + mesh.vertices[:, ::-1].tobytes()
    data += struct.pack("<Q", len(mesh.faces))
    for face, pair in zip(mesh.faces.tolist(), mesh.regions.tolist(), strict=True):
        data += struct.pack("<3Q2i", *face, *pair)
    path.write_bytes(data)
    result = load_mesh(path)
    assert_array_equal(corners(result), corners(canonical(mesh)))
    path.write_bytes(data[:-3])
    with pytest.raises(InputError, match=r"cells\.rec"):
        load_mesh(path)


def test_obj_dialect(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text(
        "# comment\nmtllib a.mtl\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0 # corner\nvn 0 0 1\n"
        "usemtl b\nf 1//1 2//1 \\\n3//1 -1//1\nf 1 2\n"
    )
    with (
        pytest.warns(RepairWarning, match="region 1 is open"),
        pytest.warns(RepairWarning, match="1 face with fewer than three corners"),
    ):
        mesh = load_mesh(path)
    assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])
    assert_allclose(mesh.normals(), [[1, 0, 0]] * 2)  # counter-clockwise seen from +z


def test_repairs_are_warnings(tmp_path):
    mesh = sphere((0, 0, 0), 1.0)
    save_mesh(Mesh(mesh.vertices, mesh.faces[:, ::-1]), tmp_path / "cell.ply")
    with pytest.warns(RepairWarning, match=r"cell\.ply: turned 1 inside-out surface"):
        load_mesh(tmp_path / "cell.ply")


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.xyz", b"1 2 3", "unknown mesh extension"),
        ("a", b"1 2 3", "unknown mesh extension"),
        ("a.obj", b"", "empty"),
        ("a.ply", b" \n", "empty"),
        ("a.obj", b"v 1 2 3\nv 1 2 4\nv 1 3 4\n", "only points"),
        ("a.obj", b"v 1 2\nf 1 1 1\n", "line 1"),
        ("a.obj", b"v 1 2 3\nf 1 2 x\n", "line 2"),
        ("a.obj", b"v 1 2 3\nf 0 1 1\n", "line 2"),
        ("a.obj", b"v 1 2 3\nv 1 2 4\nv 1 3 4\nf 1 2 4\n", "vertex 3"),
        ("a.obj", b"v 1 2 3\nv 1 2 4\nv 1 3 4\nf 1 2 -4\n", "vertex -1"),
        ("a.obj", b"v 1 2 nan\nv 1 2 4\nv 1 3 4\nf 1 2 3\n", "NaN"),
        (
            "a.obj",
            b"v 1 2 3\nv 1 2 4\nv 1 3 4\nf 1 2 3\ng region_1_0\nf 1 2 3\n",
            "no group",
        ),
        ("a.rec", b"hello world", "not a readable"),
        ("a.rec", b"3\n0 0 0\n", "3 vertices"),
        ("a.rec", b"3\n0 0 0\n0 0 1\n0 1 0\n5\n0 1 2 1 0\n", "5 faces"),
        ("a.rec", b"3\n0 0 0\n0 0 1\n0 1 0\n1\n0 1 3 1 0\n", "vertex 3"),
        ("a.rec", b"3\n0 0 0\n0 0 1\n0 1 0\n1\n0 1 2 1 -1\n", "region"),
        ("a.rec", b"-1\n0", "vertices"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n", "a."),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n0 0 1\n0 1 0\n3 0 1 7\n", "a."),
        ("a.off", b"garbage", "a."),
        ("a.ply", b"garbage", "a."),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "a."),
        ("a.stl", b"garbage", "a."),
        ("a.stl", bytes(84), "a."),
    ],
)
def test_bad_files_are_refused_in_one_line(name, data, message, tmp_path):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_round_trips_keep_every_digit_and_the_order_of_faces(tmp_path):
    mesh = canonical(two_cubes())
    mesh = mesh.with_vertices(mesh.vertices_numpy() / 3 + np.pi)
    for kind in ("obj", "ply", "rec", "vtk"):
        save_mesh(mesh, tmp_path / f"cells.{kind}")
        result = load_mesh(tmp_path / f"cells.{kind}")
        assert_array_equal(result.vertices, mesh.vertices)
        assert_array_equal(result.faces, mesh.faces)
        assert_array_equal(result.regions, mesh.regions)


VTK_TEXT = """# vtk DataFile Version 5.1
made elsewhere
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 5 float
0 0 0 1 0 0 1 1 0
0 1 0 0 0 1
METADATA
INFORMATION 0

CELLS 4 9
OFFSETS vtktypeint64
0 4 7 9
CONNECTIVITY vtktypeint64
0 1 2 3 0 1 4 2 3
CELL_TYPES 3
9
5
3
CELL_DATA 3
FIELD FieldData 2
region_a 1 3 int
5 5 0

region_b 1 3 int
0 4 0
POINT_DATA 5
VECTORS speed float
0 0 0 0 0 0 0 0 0 0 0 0 0 0 0
"""


def test_vtk_of_other_software(tmp_path):
    path = tmp_path / "grid.vtk"
    path.write_text(VTK_TEXT)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = load_mesh(path)
    assert any("ignored 1 cell that is no polygon" in str(w.message) for w in caught)
    assert_array_equal(mesh.vertices[4], [1, 0, 0])
    assert len(mesh.faces) == 3  # a quad and a triangle
    assert_array_equal(mesh.regions, [[5, 0], [5, 0], [5, 4]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<VTKFile type='PolyData'>", r"\.vtu and \.vtp are not read"),
        ("# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_GRID\n", "POLYDATA"),
        ("# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 double\n0 1\n", "early"),
        ("# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\nPOINTS 3 double\n0", "early"),
    ],
)
def test_vtk_that_cannot_be_read(text, message, tmp_path):
    (tmp_path / "a.vtk").write_text(text)
    with pytest.raises(InputError, match=message):
        load_mesh(tmp_path / "a.vtk")


def test_what_cannot_be_repaired_is_told(tmp_path):
    cube = two_cubes()
    around = np.concatenate([cube.vertices, cube.vertices * (-1, 1, 1) + (0, 1, 0)])
    opened = Mesh(cube.vertices, cube.faces[1:], cube.regions[1:])
    save_mesh(opened, tmp_path / "open.ply")
    with pytest.warns(RepairWarning, match="is open: it has no volume"):
        load_mesh(tmp_path / "open.ply")
    # Two bodies that touch along an edge.
    faces = np.concatenate([cube.faces, cube.faces[:, ::-1] + len(cube.vertices)])
    regions = np.concatenate([cube.regions, np.where(cube.regions, cube.regions + 2, 0)])
    save_mesh(Mesh(around, faces, regions), tmp_path / "touching.ply")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_mesh(tmp_path / "touching.ply")
    assert any("four walls or more meet in" in str(w.message) for w in caught)


def test_truncated_files_never_crash(tmp_path):
    mesh = sphere((0, 0, 0), 1.0, subdivisions=1)
    for kind in KINDS:
        path = tmp_path / f"cell.{kind}"
        save_mesh(mesh, path)
        data = path.read_bytes()
        for fraction in (0.05, 0.3, 0.6, 0.9):
            path.write_bytes(data[: int(fraction * len(data))])
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RepairWarning)
                with contextlib.suppress(InputError):  # and no other exception
                    assert load_mesh(path).faces.size


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_mesh(tmp_path / "missing.ply")
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(InputError, match=r"folder\.ply"):
        load_mesh(tmp_path / "folder.ply")
    with pytest.raises(InputError, match="cannot be written"):
        save_mesh(sphere((0, 0, 0), 1.0), tmp_path / "nowhere" / "a.ply")
    with pytest.raises(InputError, match="unknown mesh extension"):
        save_mesh(sphere((0, 0, 0), 1.0), tmp_path / "a.msh")


def test_a_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "cell.ply"
    path.write_bytes(b"old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        save_mesh(sphere((0, 0, 0), 1.0), path)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["cell.ply"]


@pytest.mark.parametrize("name", HARD)
def test_hard_files_load_or_are_refused(name, shared_data):
    path = shared_data / "meshes_hard" / name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RepairWarning)
        if name in REFUSED:
            with pytest.raises(InputError, match=name):
                load_mesh(path)
            return
        mesh = load_mesh(path)
    assert len(mesh.faces)
    assert (mesh.areas() > 0).all()
    if not name.startswith(("cgal", "igl", "trimesh__bunny", "trimesh__note")):
        assert mesh.is_closed()
        assert mesh.region_volume(1) > 0


def test_every_other_file_loads(shared_data):
    paths = [p for folder in ("meshes", "multimaterial") for p in (shared_data / folder).iterdir()]
    paths += list((shared_data / "images" / "celegans_meshes_T19").glob("*.ply"))[:5]
    for path in paths:
        if path.suffix == ".txt":
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RepairWarning)
            mesh = load_mesh(path)
        if not path.name.startswith("HGF"):  # its regions are in another file
            assert mesh.is_closed(), path
            assert min(mesh.volumes().values()) > 0, path


def test_several_bodies_without_names_are_told(tmp_path):
    """They are one region: a table of cells would have one row."""
    both = Mesh.merge([sphere((0, 0, 0), 1.0), sphere((0, 0, 3), 1.0)])
    one = Mesh(both.vertices, both.faces)
    save_mesh(one, tmp_path / "two.stl")
    told = r"two\.stl: the file does not name its cells: 2 separate surfaces count as one cell"
    with pytest.warns(RepairWarning, match=told):
        load_mesh(tmp_path / "two.stl")
    for kind in ("ply", "obj", "vtk", "rec"):  # without a word
        save_mesh(both, tmp_path / f"two.{kind}")
        assert load_mesh(tmp_path / f"two.{kind}").region_ids().tolist() == [1, 2]
