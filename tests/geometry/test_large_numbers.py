"""Numbers of labels and regions may be large; what they cost is what there is of them."""

import tracemalloc

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.evidence.outgrowths import outgrowths
from napari_deltamic.fourier.solid import contrasts
from napari_deltamic.geometry import mesh_from_labels, sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.labels.label_repair import label_boxes, repair_labels
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.geometry.mesh import OUTSIDE
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.geometry.topology.rearranging import give_way
from napari_deltamic.geometry.topology.small_pieces import small_pieces
from napari_deltamic.geometry.topology.thin_places import short_junctions, small_walls
from napari_deltamic.geometry.windings import fix_windings
from napari_deltamic.scene.structures import Points, Solid

LARGE = 2**35 + 3


def blocks(*names):
    labels = np.zeros((12, 12, 12 * len(names)), np.int64)
    for k, name in enumerate(names):
        labels[2:10, 2:10, 12 * k + 2 : 12 * k + 10] = name
    return labels


def peak(work):
    """Bytes that some work takes at most."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_labels_cost_what_there_is_of_them():
    low, high = blocks(1, 2), blocks(7, 2**31 - 1)
    assert [name for name, _ in label_boxes(high)] == [7, 2**31 - 1]
    assert [box for _, box in label_boxes(high)] == [box for _, box in label_boxes(low)]
    size = (1.0, 1.0, 1.0)
    limit = 2 * peak(lambda: mesh_from_labels(low, size)) + 2**20
    assert peak(lambda: mesh_from_labels(high, size)) < limit
    mesh = mesh_from_labels(high, size)
    assert mesh.region_ids().tolist() == [7, 2**31 - 1]
    assert repair_labels([high > 7, high == 7]).labels.max() == 2


def two_balls():
    one, other = sphere((0, 0, 0), 1.0, edge_length=0.6), sphere((0, 0, 5), 1.0, edge_length=0.6)
    return nd.Mesh.merge(
        [one, nd.Mesh(other.vertices, other.faces, np.where(other.regions == 1, LARGE, 0))]
    )


def test_regions_cost_what_there_is_of_them():
    mesh = two_balls()
    assert peak(mesh.volumes) < 2**22
    volumes = mesh.volumes()
    assert volumes[LARGE] == pytest.approx(volumes[1])
    assert nd.Mesh.merge([mesh, mesh]).region_ids().tolist() == [1, LARGE, LARGE + 1, LARGE + 2]
    assert fix_windings(mesh)[0] is mesh
    faces = np.where(mesh.regions[:, :1] == LARGE, mesh.faces[:, ::-1], mesh.faces)
    fixed, messages = fix_windings(nd.Mesh(mesh.vertices, faces, mesh.regions))
    assert fixed.volumes() == pytest.approx(volumes)
    assert len(messages) == 1
    labels = voxel_labels(mesh, (4, 4, 12), (0.5, 0.5, 0.5))
    assert set(np.unique(labels)) == {0, 1, LARGE}


@pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
def test_remeshing_keeps_large_regions():
    from napari_deltamic.geometry.remeshing import remesh

    found = remesh(two_balls(), 0.5).mesh
    assert found.region_ids().tolist() == [1, LARGE]


def test_places_where_regions_meet_cost_what_there_is_of_them():
    """A table with a column for each cell took gigabytes with 1000 cells."""
    mesh = foam(np.array([[0, 0, 0], [0, 0, 1.5]]), np.full(2, 1.0), 0.3)
    large = nd.Mesh(mesh.vertices, mesh.faces, np.where(mesh.regions == 2, LARGE, mesh.regions))
    assert peak(lambda: small_walls(large, 100.0)) < 2**22
    assert peak(lambda: short_junctions(large, 100.0)) < 2**22
    (wall,) = small_walls(large, 100.0)
    assert (wall.regions, wall.sides) == ((1, LARGE), (OUTSIDE,))


def test_light_inside_and_outgrowths_cost_what_there_is_of_regions():
    mesh = two_balls()
    ids, weights = mesh.region_ids(), torch.tensor([1.0, 3.0])
    assert peak(lambda: contrasts(mesh.regions, ids, weights)) < 2**22
    assert set(contrasts(mesh.regions, ids, weights).tolist()) == {1.0, 3.0}
    grid = nd.Grid((12, 12, 40), (0.2, 0.2, 0.2), (-1.2, -1.2, -1.2))
    assert outgrowths(mesh, grid, nd.GaussianPSF(0.1)) == {}


@pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
def test_a_small_piece_goes_to_a_large_number():
    ball = sphere((0, 0, 0), 0.2, edge_length=0.2)
    shell = sphere((0, 0, 0), 1.0, edge_length=0.3)
    mesh = nd.Mesh.merge([shell, ball])
    # A pocket of the outside within a cell.
    regions = np.where(mesh.regions == 1, LARGE, 0)
    regions[len(shell.faces) :] = OUTSIDE, LARGE
    mesh = nd.Mesh(mesh.vertices, mesh.faces, regions)
    (place,) = small_pieces(mesh, 0.1)
    found = []
    used = peak(lambda: found.append(give_way(mesh, [place], 0.3)))
    assert used < 2**24
    assert len(found[0].mesh.faces) == len(shell.faces)


@pytest.mark.parametrize("kind", ["ply", "vtk", "rec", "obj"])
def test_files_keep_large_regions(tmp_path, kind):
    mesh = two_balls()
    nd.save_mesh(mesh, tmp_path / f"mesh.{kind}")
    assert np.array_equal(nd.load_mesh(tmp_path / f"mesh.{kind}").regions, mesh.regions)


def test_what_cannot_be_computed_with_is_refused():
    mesh = sphere((0, 0, 0), 1.0, edge_length=0.6)
    far = np.array(mesh.vertices)
    far[3, 1] = 1e308
    with pytest.raises(InputError, match=r"vertices are 1e\+12 um away"):
        nd.Mesh(far, mesh.faces)
    with pytest.raises(InputError, match="too large a number"):
        nd.Mesh(mesh.vertices, mesh.faces, np.where(mesh.regions == 1, 2**62, 0))
    with pytest.raises(InputError, match="cannot be computed with"):
        nd.Grid((3, 3, 3), (1e-320, 1, 1))
    with pytest.raises(InputError, match="origin"):
        nd.Grid((3, 3, 3), (1, 1, 1), (1e300, 0, 0))


def test_scenes_that_cannot_be_computed_with_are_refused():
    mesh = sphere((0, 0, 0), 1.0, edge_length=0.6)
    with pytest.raises(InputError, match="finite"):
        Solid(mesh, 1e308)
    with pytest.raises(InputError, match="finite"):
        Points(np.array([[0, 1e300, 0]]))
    with pytest.raises(InputError, match="sigma must be positive"):
        nd.GaussianPSF(1e300)
    with pytest.raises(InputError, match="numbers of shape"):
        nd.Mesh(np.array(mesh.vertices, complex), mesh.faces)
    turned = nd.Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.regions)
    with pytest.warns(RepairWarning, match="inside-out"):
        assert Solid(turned).mesh.region_volume(1) > 0
