"""One table of mesh formats, and meshes from and to trimesh."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.formats import MESH_FILTERS, MESH_FORMATS, mesh_format

PACKAGE = Path(nd.__file__).parent


@pytest.fixture(scope="module")
def pair():
    """Two cells that share a wall."""
    return foam(np.array([[2.0, 2.0, 1.4], [2.0, 2.0, 2.6]]), np.full(2, 1.0), 0.3)


@pytest.mark.parametrize("one", MESH_FORMATS, ids=lambda one: one.name)
@pytest.mark.filterwarnings("ignore")
def test_every_format_is_written_and_read(one, tmp_path, pair):
    path = tmp_path / f"mesh{one.suffix.upper()}"
    nd.save_mesh(pair, path)
    back = nd.load_mesh(path)
    assert len(back.faces) == len(pair.faces)
    assert (back.interfaces()[0].tolist() == pair.interfaces()[0].tolist()) == one.regions


@pytest.mark.parametrize("one", MESH_FORMATS, ids=lambda one: one.name)
def test_attributes_are_written_or_refused(one, tmp_path):
    ball = sphere((1, 1, 1), 0.5)
    path, numbers = tmp_path / f"mesh{one.suffix}", {"height": np.arange(len(ball.faces)) * 1.0}
    if one.attributes:
        nd.save_mesh(ball, path, numbers)
        assert b"height" in path.read_bytes()
    else:
        with pytest.raises(InputError, match="hold attributes"):
            nd.save_mesh(ball, path, numbers)


def test_no_other_place_lists_the_suffixes():
    """Three on a line are a list; a test of the manifest compares it with the table."""
    known = re.compile(r"\.(" + "|".join(one.name for one in MESH_FORMATS) + r")\b")
    found = [
        f"{path.name}: {line.strip()}"
        for path in PACKAGE.rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if len(set(known.findall(line))) > 2
    ]
    # What load_mesh and save_mesh say of each format.
    assert [line for line in found if not line.startswith("__init__.py: ")] == []


def test_dialogs_offer_every_format():
    assert MESH_FILTERS.count("*.") == len(MESH_FORMATS)
    assert mesh_format("a.PLY") is MESH_FORMATS[0]
    assert mesh_format("a.tif") is None


def test_trimesh_gets_cells_that_are_closed_and_right_side_out(pair):
    for region in (1, 2):
        cell = pair.region_surface(region).to_trimesh()
        assert cell.is_watertight
        assert cell.volume == pytest.approx(pair.volumes()[region])
    low, high = pair.bounds()
    np.testing.assert_array_equal(pair.to_trimesh().bounds, [low[::-1], high[::-1]])


def test_trimesh_and_back_is_the_same_mesh(pair):
    back = nd.Mesh.from_trimesh(pair.to_trimesh())
    np.testing.assert_array_equal(back.vertices_numpy(), pair.vertices_numpy())
    assert back.volumes() == pytest.approx(pair.volumes())
    assert back.interfaces()[0].tolist() == pair.interfaces()[0].tolist()


def test_a_mesh_of_trimesh_alone_is_one_region():
    box = nd.Mesh.from_trimesh(trimesh.creation.box((1.0, 2.0, 3.0)))
    assert box.volumes() == {1: pytest.approx(6.0)}
    np.testing.assert_allclose(np.ptp(box.bounds(), axis=0), [3, 2, 1])


@pytest.mark.parametrize("other", [trimesh.PointCloud(np.eye(3)), np.eye(3)])
def test_what_is_no_surface_is_refused(other):
    with pytest.raises(InputError, match="Trimesh is needed"):
        nd.Mesh.from_trimesh(other)
