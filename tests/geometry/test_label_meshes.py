"""Meshes of label images whose labels touch."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry import mesh_from_labels
from napari_deltamic.geometry.labels import meshes as label_meshes
from napari_deltamic.geometry.labels.dark_gaps import with_dark_gaps
from napari_deltamic.geometry.remeshing import can_remesh, smallest_angles
from napari_deltamic.geometry.topology.crossings import crosses

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
SIZE = (0.4, 0.2, 0.2)


def halves(line=0):
    """A ball cut in two, with a line of some voxels of ground between the halves."""
    z, y, x = np.indices((26, 52, 52)) * np.reshape(SIZE, (3, 1, 1, 1)) - 5.1
    labels = np.where(x < 0, 4, 9) * (z**2 + y**2 + x**2 < 16)
    if line:
        labels[:, :, 26 - line // 2 : 26 + (line + 1) // 2] = 0
    return labels


def test_touching_labels_share_their_wall():
    labels = halves()
    mesh = mesh_from_labels(labels, SIZE)
    assert mesh.is_closed()
    assert {tuple(p) for p in mesh.interfaces()[0]} == {(4, 0), (9, 0), (9, 4)}
    assert set(np.unique(mesh.edge_uses())) == {2, 3}
    for k in (4, 9):
        assert_allclose(mesh.region_volume(k), (labels == k).sum() * 0.016, rtol=3e-3)
    assert np.percentile(smallest_angles(mesh), 1) > 25
    wall = (mesh.regions > 0).all(1)
    assert_allclose(mesh.areas()[wall].sum(), np.pi * 16, rtol=0.1)
    assert np.abs(mesh.vertices_numpy()[mesh.faces[wall]][:, :, 2] - 5.0).max() < 0.2


def test_a_line_of_one_voxel_is_no_gap():
    pairs = mesh_from_labels(halves(1), SIZE).interfaces()[0]
    assert (9, 4) in {tuple(p) for p in pairs}


@pytest.mark.parametrize(
    ("in_the_gap", "shared"), [(0.5, False), (0.9, True), (1.0, True), (3.0, True)]
)
def test_the_image_tells_whether_a_line_is_a_gap(in_the_gap, shared):
    labels = halves(1)
    image = np.where(halves() > 0, np.where(labels > 0, 1.0, in_the_gap), 0.0) + 7.0
    pairs = mesh_from_labels(labels, SIZE, image=image).interfaces()[0]
    assert ((9, 4) in {tuple(p) for p in pairs}) == shared


@pytest.mark.parametrize(("between", "shared"), [(0.5, False), (0.95, True), (3.0, True)])
def test_labels_that_touch_are_parted_where_the_image_is_dark(between, shared):
    labels = halves()
    image = np.where(labels > 0, 1.0, 0.0)
    image[:, :, 25:27] *= between
    mesh = mesh_from_labels(labels, SIZE, image=image)
    assert ((9, 4) in {tuple(p) for p in mesh.interfaces()[0]}) == shared
    lost = 1 - sum(mesh.volumes().values()) / ((labels > 0).sum() * 0.016)
    assert lost == pytest.approx(0 if shared else 0.075, abs=0.01)


def test_noise_parts_no_labels():
    labels = np.zeros((16, 24, 24), int)
    labels[4:12, 6:18, 4:12] = 1
    labels[4:12, 6:18, 12:20] = 2
    labels[:, :, 11:13] = 0
    labels[7:10, 10:13, 11:13] = [1, 2]  # nine faces where they touch
    rng = np.random.default_rng(1)
    parted = 0
    for _ in range(50):
        image = np.where(labels > 0, rng.poisson(1.0, labels.shape), 0.0)
        parted += not np.array_equal(with_dark_gaps(labels, labels, image), labels)
    assert parted <= 3
    image[7:10, 10:13, 11:13] = 0
    assert not np.array_equal(with_dark_gaps(labels, labels, image), labels)


def test_a_dark_line_stays_beside_cells_unequally_bright():
    labels = halves(2)
    image = np.select([labels == 4, labels == 9, halves() > 0], [1.0, 0.3, 0.4], 0.0)
    pairs = mesh_from_labels(labels, SIZE, image=image).interfaces()[0]
    assert (9, 4) not in {tuple(p) for p in pairs}
    image = np.select([labels == 4, labels == 9, halves() > 0], [1.0, 0.3, 0.65], 0.0)
    pairs = mesh_from_labels(labels, SIZE, image=image).interfaces()[0]
    assert (9, 4) in {tuple(p) for p in pairs}


def test_wider_gaps_stay_unless_they_are_closed():
    apart = mesh_from_labels(halves(4), SIZE)
    assert {tuple(p) for p in apart.interfaces()[0]} == {(4, 0), (9, 0)}
    joined = mesh_from_labels(halves(4), SIZE, gap=1.0)
    assert (9, 4) in {tuple(p) for p in joined.interfaces()[0]}
    total = sum(joined.volumes().values())
    assert_allclose(total, (halves() > 0).sum() * 0.016, rtol=0.05)


def test_labels_apart_are_not_joined_with_the_others():
    labels = np.pad(halves(), ((0, 0), (0, 0), (0, 30)))
    labels[8:18, 20:36, 60:76] = 2
    mesh = mesh_from_labels(labels, SIZE)
    assert set(mesh.region_ids()) == {2, 4, 9}
    assert not {(4, 2), (9, 2)} & {tuple(p) for p in mesh.interfaces()[0]}


def test_crumbs_and_holes_of_a_cluster():
    labels = halves()
    labels[1:3, 1:3, 1:3] = 4
    labels[12:14, 24:27, 12:15] = 0
    with pytest.warns(RepairWarning) as told:
        mesh = mesh_from_labels(labels, SIZE)
    assert [str(w.message) for w in told] == [
        "label 4: in several parts; the largest was kept",
        "label 4: holes were filled",
    ]
    assert mesh.bounds()[0].min() > 0.5
    assert_allclose(mesh.region_volume(4), (halves() == 4).sum() * 0.016, rtol=5e-3)


def test_without_the_extension_each_label_has_its_own_surface(monkeypatch):
    monkeypatch.setattr(label_meshes, "can_remesh", lambda: False)
    mesh = mesh_from_labels(halves(), SIZE)
    assert (mesh.regions[:, 1] == 0).all()


@pytest.mark.parametrize("across", [6, 9, 14])
def test_small_labels_keep_their_volume(across):
    z, y, x = np.indices((24, 24, 24)) - 11.5
    labels = (z**2 + y**2 + x**2 < (across / 2) ** 2).astype(int)
    mesh = mesh_from_labels(labels, (0.1, 0.1, 0.1))
    assert_allclose(mesh.region_volume(1), labels.sum() * 1e-3, rtol=0.01)
    assert smallest_angles(mesh).min() > 15


@pytest.mark.parametrize(("radius", "voxels"), [(3.5, 2.0), (5.0, 2.25), (8.0, 3.0)])
def test_edges_of_small_labels_are_shorter(radius, voxels):
    z, y, x = np.indices((20, 20, 40)) - 9.5
    labels = 1 * (z**2 + y**2 + x**2 < radius**2) + 2 * (z**2 + y**2 + (x - 20) ** 2 < radius**2)
    assert edge_of(labels, (0.2, 0.2, 0.2)) == pytest.approx(0.2 * voxels, rel=0.02)


def edge_of(labels, size):
    return label_meshes.surfaces_of_labels(labels, size, (0, 0, 0)).edge


def test_the_default_edge_is_three_voxels_unless_that_makes_too_many_faces(monkeypatch):
    assert edge_of(halves(), SIZE) == pytest.approx(0.6)
    monkeypatch.setattr(label_meshes, "MOST_FACES", 400)
    monkeypatch.setattr(label_meshes, "MOST_FACES_EACH", 200)
    assert edge_of(halves(), SIZE) > 0.8
    faces = len(mesh_from_labels(halves(), SIZE).faces)
    assert 250 < faces < 600


def test_many_cells_have_edges_as_long_as_few(monkeypatch):
    """A budget for all together had given each of a thousand cells 60 faces."""
    monkeypatch.setattr(label_meshes, "MOST_FACES", 2000)
    few = np.kron(np.arange(1, 9).reshape(2, 2, 2), np.ones((12, 12, 12), int))
    many = np.kron(np.arange(1, 65).reshape(4, 4, 4), np.ones((12, 12, 12), int))
    each = [edge_of(labels, (1.0, 1.0, 1.0)) for labels in (few, many)]
    assert each == pytest.approx([3.0, 3.0])


def test_labels_of_hardly_an_edge_stay_where_they_are():
    """One of them had become inside out, and grown to twenty images."""
    labels = np.zeros((20, 20, 20), np.int32)
    rng = np.random.default_rng(0)
    for k, (z, y, x) in enumerate(np.argwhere(np.ones((3, 3, 3))) * 6 + 3, 1):
        labels[z - 1 : z + rng.integers(1, 3), y - 1 : y + 2, x - 1 : x + rng.integers(1, 4)] = k
    for edge in (2.0, 2.5, 3.0, 3.5):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                mesh = mesh_from_labels(labels, (1.0, 1.0, 1.0), edge_length=edge)
            except InputError:
                continue  # all are too small
        assert np.abs(mesh.vertices_numpy() - 9.5).max() < 14
        assert min(mesh.volumes().values()) > 0


@pytest.mark.parametrize("seed", [2, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 9))])
@pytest.mark.filterwarnings("ignore::napari_deltamic.errors.RepairWarning")  # crumbs of some cells
def test_crowds_of_small_cells_keep_their_volumes_and_do_not_cross(seed):
    """Four nodes across a cell were too few: cells grew to 30 times their volume."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform(3, 29, (40, 3))
    away = np.linalg.norm(np.indices((32, 32, 32))[None] - centers[:, :, None, None, None], axis=1)
    labels = np.where(away.min(0) < 8.4, away.argmin(0) + 1, 0)
    mesh = mesh_from_labels(labels, (1.0, 1.0, 1.0))
    voxels = np.bincount(labels.ravel())
    volumes = {k: v / voxels[k] for k, v in mesh.volumes().items()}
    assert sorted(volumes) == list(range(1, 41))
    assert min(volumes.values()) > 0.9
    assert max(volumes.values()) < 1.1
    assert not crosses(mesh)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("touching", [pytest.param(False, marks=pytest.mark.slow), True])
def test_no_small_cell_is_lost(touching):
    """Balls 5 voxels across, beside larger ones or alone: 20 of each."""
    middle = 10 + np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    z, y, x = np.indices((21, 21, 31))
    for a, b, c in middle:
        labels = ((z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2 < 2.5**2).astype(int)
        near = (z - a) ** 2 + (y - b) ** 2 + (x - c - (6.5 if touching else 8)) ** 2 < 16
        labels[near & (labels == 0)] = 2
        mesh = mesh_from_labels(labels, (1, 1, 1))
        assert mesh.region_ids().tolist() == [1, 2]
        assert mesh.region_volume(1) > 0.5 * (labels == 1).sum()


def test_crumbs_are_still_left_out():
    """And edges that are asked for stay as they are."""
    labels = halves()
    labels[:1, :2, :3] = 7
    with pytest.warns(RepairWarning, match=r"^1 of 3 labels is left out: label 7 is too small"):
        assert mesh_from_labels(labels, SIZE).region_ids().tolist() == [4, 9]
    z, y, x = np.indices((11, 11, 11)) - 5.2
    with pytest.raises(InputError, match="too small for edges of 3 um"):
        mesh_from_labels((z**2 + y**2 + x**2 < 2.5**2).astype(int), (1, 1, 1), edge_length=3.0)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("height", "aspect"), [(2, 1), (2, 6), (3, 6)])
def test_flat_labels_that_touch_keep_their_cells(height, aspect):
    """Smoothing takes all of what is two slices high; no edge length brings it back."""
    z, y, x = np.indices((8, 30, 30))
    labels = np.zeros(z.shape, int)
    for name, (row, column) in enumerate([(9, 9), (9, 18)], 1):
        disk = (y - row) ** 2 + (x - column) ** 2 < 25
        labels[(z >= 3) & (z < 3 + height) & disk & (labels == 0)] = name
    mesh = mesh_from_labels(labels, (0.2 * aspect, 0.2, 0.2))
    volumes = np.array([mesh.volumes()[name] for name in (1, 2)])
    wanted = np.bincount(labels.ravel())[1:] * 0.2**3 * aspect
    np.testing.assert_allclose(volumes, wanted, rtol=0.15)
    assert mesh.is_closed()
