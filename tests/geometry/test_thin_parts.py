"""Meshes of labels with parts thinner than the usual edges."""

import numpy as np
import pytest
from scipy import ndimage

from napari_deltamic.errors import RepairWarning
from napari_deltamic.geometry import mesh_from_labels
from napari_deltamic.geometry.labels import meshes as label_meshes
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.geometry.remeshing import can_remesh

SIZE = (0.2, 0.2, 0.2)
native = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")


def ball(shape, center, radius):
    return sum((x - c) ** 2 for x, c in zip(np.indices(shape), center, strict=True)) < radius**2


def with_arm(radius, across=7.0, shape=(20, 24, 48)):
    """A ball and a rod along X that reaches 23 voxels out of it."""
    z, y, x = np.indices(shape)
    rod = ((z - 9.5) ** 2 + (y - 11.4) ** 2 < radius**2) & (x > 10) & (x < 40)
    return (ball(shape, (9.5, 11.4, 10), across) | rod).astype(int)


def held(mesh, labels):
    """Share of the arm of label 1 that the mesh passes through, or within 1.5 voxels."""
    away = ndimage.distance_transform_edt(voxel_labels(mesh, labels.shape, SIZE) != 1)
    arm = (labels == 1) & (np.indices(labels.shape)[2] > 18)
    return np.count_nonzero(arm & (away < 1.6)) / np.count_nonzero(arm)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("radius", [1.6, 2.0, 2.5])
def test_thin_arms_are_in_the_mesh(radius):
    """They had been cut off, and the body blown up in their place."""
    labels = with_arm(radius)
    mesh = mesh_from_labels(labels, SIZE)
    assert held(mesh, labels) > 0.85
    assert mesh.is_closed()
    # No finer than needed: thick arms take edges of two voxels.
    assert mesh.median_edge() > (0.36 if radius > 1.8 else 0.22)


@pytest.mark.filterwarnings("error")
def test_slices_far_apart_leave_arms_within_them():
    """All axes had been smoothed as much as slices ask for."""
    labels = with_arm(2.5)[1::3]
    mesh = mesh_from_labels(labels, (0.6, 0.2, 0.2))
    assert mesh.bounds()[1][2] > 37 * 0.2


@native
@pytest.mark.filterwarnings("error")
def test_beside_a_label_with_an_arm_the_others_keep_their_edges():
    labels = with_arm(1.8, shape=(20, 40, 48))
    labels[ball(labels.shape, (9.5, 25, 10), 8) & (labels == 0)] = 2
    mesh = mesh_from_labels(labels, SIZE)
    assert held(mesh, labels) > 0.85
    both = (2, 1) in {tuple(pair) for pair in mesh.interfaces()[0]}
    own, other = (mesh.region_surface(k).median_edge() for k in (1, 2))
    assert both
    assert own < 0.45
    assert other > 0.5


@pytest.mark.filterwarnings("error")
def test_without_arms_the_mesh_is_made_once(monkeypatch):
    """Also of noisy, flat and touching labels."""
    rng = np.random.default_rng(0)
    noisy = ball((24, 24, 24), (11.5, 11.5, 11.5), 9 + rng.normal(0, 0.5, (24, 24, 24)))
    places = rng.uniform(4, 20, (6, 3))
    away = [np.sum((np.indices((24, 24, 24)).T - p) ** 2, axis=-1).T for p in places]
    crowd = np.where(np.min(away, axis=0) < 81, np.argmin(away, axis=0) + 1, 0)
    flat = ball((8, 24, 24), (3.5, 11.5, 11.5), 9).astype(int)
    made = []
    monkeypatch.setattr(label_meshes, "_cut", lambda *a: made.append(found := cut(*a)) or found)
    for labels, size in ((crowd, SIZE), (flat, (0.8, 0.2, 0.2)), (with_arm(4.0), SIZE)):
        mesh_from_labels(labels, size)
    with pytest.warns(RepairWarning):  # voxels apart from it
        mesh_from_labels(noisy.astype(int), SIZE)
    assert made
    assert not any(made)


cut = label_meshes._cut


def test_what_is_still_cut_off_is_told():
    """By edges that are asked for, or where nothing shorter is left to try."""
    labels = with_arm(1.6)
    with pytest.warns(
        RepairWarning, match=r"^label 1: parts too thin for a mesh were cut off, 1.%"
    ):
        mesh = mesh_from_labels(labels, SIZE, edge_length=0.6)
    assert held(mesh, labels) < 0.4
    two = np.concatenate([labels, np.where(labels, 3, 0)])
    with pytest.warns(RepairWarning, match=r"^labels 1 and 3: .*, up to 1.% of one$"):
        mesh_from_labels(two, SIZE, edge_length=0.6)


def test_shorter_edges_do_not_make_more_faces_than_a_fit_takes(monkeypatch):
    monkeypatch.setattr(label_meshes, "MOST_FACES", 250)
    monkeypatch.setattr(label_meshes, "MOST_FACES_EACH", 250)
    labels = with_arm(1.6)
    with pytest.warns(RepairWarning, match="too thin"):
        assert len(mesh_from_labels(labels, SIZE).faces) < 350
