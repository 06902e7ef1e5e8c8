"""Tracks as GEFF: through its validator, and back without a loss."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.results.lineage_graph import write_geff
from napari_deltamic.tracking import Event, FrameResult

needs_geff = pytest.mark.skipif(not find_spec("geff"), reason="geff is not installed")


def cells(**places):
    """Ellipsoids with half axes of 1, 2 and 3 um along Z, Y, X, by number: c1=x, um."""
    parts = [sphere((4, 5, x), (1.0, 2.0, 3.0), edge_length=0.5) for x in places.values()]
    mesh, numbers = Mesh.merge(parts), np.array([0, *(int(name[1:]) for name in places)])
    return Mesh(mesh.vertices, mesh.faces, numbers[mesh.regions])


@pytest.fixture
def results():
    """Two cells; a frame is left out; the second one divides."""
    divided = Event("divided", 3, 2, "divided into 3 and 4", (3, 4))
    return [
        FrameResult(0, 0.0, cells(c1=0.0, c2=10.0)),
        FrameResult(1, 30.0, None, "dark"),
        FrameResult(2, 60.0, cells(c1=1.0, c2=11.0)),
        FrameResult(3, 90.0, cells(c1=2.0, c3=8.0, c4=15.0), events=(divided,)),
    ]


def read(path):
    from geff.core_io import read_to_memory

    return read_to_memory(path)


@pytest.mark.filterwarnings("ignore")
def test_the_graph_is_valid_and_comes_back(results, tmp_path):
    geff = pytest.importorskip("geff")
    from geff.validate.data import ValidationConfig, validate_data

    path = write_geff(tmp_path / "tracks.geff", results)
    geff.validate_structure(path)
    found = read(path)
    validate_data(found, ValidationConfig(graph=True, tracklet=True))
    props = {name: prop["values"] for name, prop in found["node_props"].items()}
    assert props["t"].tolist() == [0, 0, 2, 2, 3, 3, 3]
    assert props["seg_id"].tolist() == [1, 2, 1, 2, 1, 3, 4]
    assert props["time_s"].tolist() == [0, 0, 60, 60, 90, 90, 90]
    np.testing.assert_allclose(props["x"], [0, 10, 1, 11, 2, 8, 15], atol=1e-9)
    np.testing.assert_allclose(props["z"], 4)
    volumes = [v for r in results if r.mesh for v in r.mesh.volumes().values()]
    np.testing.assert_allclose(props["volume_um3"], volumes)
    # Its validator of ellipsoids (1.3.1) takes those of two dimensions only.
    assert props["ellipsoid"].shape == (7, 3, 3)
    for matrix in props["ellipsoid"]:
        np.testing.assert_array_equal(matrix, matrix.T)
        np.testing.assert_allclose(np.sqrt(np.diag(matrix)), [1, 2, 3], rtol=0.03)
    # Nobody is lost: over the frame that was left out, and into both daughters.
    assert found["edge_ids"].tolist() == [[0, 2], [1, 3], [2, 4], [3, 5], [3, 6]]


@pytest.mark.filterwarnings("ignore")
@needs_geff
def test_an_older_graph_is_replaced(results, tmp_path):
    path = write_geff(tmp_path / "tracks.geff", results)
    write_geff(path, results[:1])
    assert len(read(path)["node_ids"]) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["tracks.geff"]


@pytest.mark.filterwarnings("ignore")
@needs_geff
def test_open_cells_are_no_nodes(results, tmp_path):
    whole = sphere((4, 5, 6), 2.0)
    bowl = Mesh(whole.vertices, whole.faces[4:])
    with pytest.raises(InputError, match="no frame has a cell"):
        write_geff(tmp_path / "a.geff", [FrameResult(0, 0.0, bowl)])
    assert list(tmp_path.iterdir()) == []


def test_without_the_package_it_is_said(results, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "geff", None)
    with pytest.raises(InputError, match=r"napari-deltamic\[tracks\]"):
        write_geff(tmp_path / "tracks.geff", results)
