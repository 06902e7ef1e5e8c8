import numpy as np
import pytest
import torch
from benchmarks.shapes import box, scaled
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from napari_deltamic.errors import InputError
from napari_deltamic.geometry import Mesh, sphere

# A tetrahedron in x, y, z with the usual outward winding, volume 1/6.
TETRA_XYZ = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
TETRA_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def tetrahedron() -> Mesh:
    return Mesh(TETRA_XYZ[:, ::-1], TETRA_FACES)


def two_cubes() -> Mesh:
    """Unit cubes 1 and 2 side by side along X; the wall between them is stored once."""
    z, y, x = np.meshgrid([0, 1], [0, 1], [0, 1, 2], indexing="ij")
    vertices = np.stack([z, y, x], axis=-1).reshape(-1, 3)
    index = np.arange(12).reshape(2, 2, 3)
    quads, regions = [], []
    for cell in (0, 1):
        cube = index[:, :, cell : cell + 2]
        for axis in range(3):
            for end in (0, 1):
                if axis == 2 and end == 1 - cell and cell == 1:
                    continue
                a, b, c, d = np.take(cube, end, axis=axis).reshape(-1)[[0, 1, 3, 2]]
                wall = axis == 2 and end == 1 - cell
                quads.append([a, b, c, d])
                regions.append((1, 2) if wall else (cell + 1, 0))
    faces, pairs = [], []
    for (a, b, c, d), pair in zip(quads, regions, strict=True):
        middle = np.array([0.5, 0.5, pair[0] - 0.5])
        corners = vertices[[a, b, c]]
        # Minus the cross product: Z, Y, X is left-handed.
        normal = -np.cross(corners[1] - corners[0], corners[2] - corners[0])
        if normal @ (corners[0] - middle) < 0:
            b, d = d, b
        faces += [[a, b, c], [a, c, d]]
        pairs += [pair, pair]
    return Mesh(vertices, faces, pairs)


def test_default_regions_and_types():
    mesh = tetrahedron()
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    assert_array_equal(mesh.regions, [[1, 0]] * 4)
    assert_array_equal(mesh.region_ids(), [1])
    assert "4 faces" in repr(mesh)


def test_outward_in_xyz_gives_positive_volume_and_outward_normals():
    mesh = tetrahedron()
    assert_allclose(mesh.region_volume(1), 1 / 6)
    normals = mesh.normals()
    assert_allclose(normals[0], [-1, 0, 0], atol=1e-15)  # the face z = 0 looks to -z
    assert_allclose(normals[3], np.ones(3) / np.sqrt(3))
    assert_allclose(mesh.areas(), [0.5, 0.5, 0.5, np.sqrt(3) / 2])


def test_normals_of_a_sphere_point_away_from_its_center():
    mesh = sphere((1, 2, 3), 2.0)
    centers = mesh.vertices[mesh.faces].mean(axis=1) - [1, 2, 3]
    assert (np.einsum("fi,fi->f", mesh.normals(), centers) > 1.9).all()


def test_area_of_a_needle():
    # Heron's formula loses most digits here.
    mesh = Mesh([[0, 0, 0], [0, 0, 1], [0, 1e-9, 0.5]], [[0, 1, 2]])
    assert_allclose(mesh.areas(), [0.5e-9], rtol=1e-12)


def test_zero_area_has_zero_normal():
    mesh = Mesh([[0, 0, 0], [0, 0, 1], [0, 0, 2]], [[0, 1, 2]])
    assert_array_equal(mesh.areas(), [0])
    assert_array_equal(mesh.normals(), [[0, 0, 0]])


def test_shared_wall():
    mesh = two_cubes()
    assert_allclose(list(mesh.volumes().values()), [1, 1])
    pairs, index = mesh.interfaces()
    assert_array_equal(pairs, [[1, 0], [2, 0], [2, 1]])
    assert_array_equal(np.bincount(index), [10, 10, 2])
    assert_array_equal(mesh.membranes(), np.where(index == 2, 2, 1))
    assert_allclose((mesh.areas() * mesh.membranes()).sum(), 12)
    assert mesh.is_closed()
    assert mesh.is_closed(1)


@pytest.mark.parametrize("region", [1, 2])
def test_region_surface(region):
    surface = two_cubes().region_surface(region)
    assert len(surface.vertices) == 8
    assert_array_equal(np.unique(surface.regions, axis=0), [[region, 0]])
    assert_allclose(surface.region_volume(region), 1)
    assert_allclose(surface.areas().sum(), 6)
    assert surface.is_closed()


def test_open_surface():
    mesh = tetrahedron()
    assert mesh.is_closed()
    assert not Mesh(mesh.vertices, mesh.faces[1:]).is_closed()
    cubes = two_cubes()
    one_less = Mesh(cubes.vertices, cubes.faces[1:], cubes.regions[1:])
    assert not one_less.is_closed(1)
    assert one_less.is_closed(2)


def test_edges():
    mesh = tetrahedron()
    assert_array_equal(mesh.edges(), [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
    opposite = mesh.edges()[mesh.face_edges()]
    assert opposite.shape == (4, 3, 2)
    for corner in range(3):
        assert not (opposite[:, corner] == mesh.faces[:, corner, None]).any()
    assert mesh.edge_uses().tolist() == 6 * [2]
    start, end = mesh.vertices[mesh.edges()].transpose(1, 0, 2)
    assert_allclose(mesh.edge_lengths() ** 2, ((end - start) ** 2).sum(1))
    cubes = two_cubes()
    rim = cubes.edges()[cubes.edge_uses() == 3]
    assert len(rim) == 4
    assert len(np.unique(cubes.vertices[rim].reshape(-1, 3), axis=0)) == 4
    assert_allclose(cubes.edge_lengths()[cubes.edge_uses() == 3], 1)


def test_bounds():
    assert_allclose(box((1, 2, 3), (2, 4, 6)).bounds(), [[0, 0, 0], [2, 4, 6]])


def test_with_vertices_shares_connectivity():
    mesh = tetrahedron()
    moved = mesh.with_vertices(mesh.vertices + 1)
    assert moved.faces is mesh.faces
    assert_allclose(moved.region_volume(1), 1 / 6)
    with pytest.raises(InputError, match="expected 4 vertices, got 3"):
        mesh.with_vertices(mesh.vertices[:3])


def test_vertices_are_copied():
    vertices = TETRA_XYZ.copy()
    mesh = Mesh(vertices, TETRA_FACES)
    vertices[:] = 0
    assert_array_equal(mesh.vertices, TETRA_XYZ)


@settings(deadline=None, max_examples=50)
@given(
    offset=st.tuples(*[st.floats(-1e4, 1e4)] * 3),
    factors=st.tuples(*[st.floats(1e-2, 1e2)] * 3),
)
def test_volume_under_translation_and_scaling(offset, factors):
    mesh = scaled(two_cubes(), factors).translated(offset)
    assert_allclose(list(mesh.volumes().values()), np.prod(factors), rtol=1e-5)
    assert mesh.is_closed()


@settings(deadline=None, max_examples=30)
@given(axis=st.tuples(*[st.floats(-1, 1)] * 3), angle=st.floats(-3, 3))
def test_volume_and_area_under_rotation(axis, angle):
    from scipy.spatial.transform import Rotation

    mesh = two_cubes()
    turn = Rotation.from_rotvec(np.array(axis) * angle).as_matrix()
    turned = mesh.with_vertices(mesh.vertices @ turn.T)
    assert_allclose(list(turned.volumes().values()), [1, 1], rtol=1e-12)
    assert_allclose(turned.areas(), mesh.areas(), rtol=1e-12)
    assert_allclose(turned.normals(), mesh.normals() @ turn.T, atol=1e-12)


def test_volume_far_from_the_origin():
    mesh = sphere((0, 0, 0), 1.0)
    far = mesh.translated((1e6, -1e6, 1e6))
    assert_allclose(far.region_volume(1), mesh.region_volume(1), rtol=1e-8)


def test_merge_keeps_numbers_where_it_can():
    first, second = two_cubes(), tetrahedron()
    other = Mesh(second.vertices, second.faces, [[7, 0]] * 4)
    merged = Mesh.merge([first, other, second])
    assert_array_equal(merged.region_ids(), [1, 2, 7, 8])
    assert_allclose(list(merged.volumes().values()), [1, 1, 1 / 6, 1 / 6])
    assert merged.is_closed()
    with pytest.raises(InputError):
        Mesh.merge([])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_tensor_vertices_are_kept_and_stay_differentiable(dtype):
    vertices = torch.tensor(TETRA_XYZ[:, ::-1].copy(), dtype=dtype, requires_grad=True)
    mesh = Mesh(vertices, torch.tensor(TETRA_FACES))
    assert mesh.vertices is vertices
    assert mesh.vertices_numpy().dtype == np.float64
    assert_allclose(mesh.region_volume(1), 1 / 6, rtol=1e-6)
    merged = Mesh.merge(
        [mesh.with_vertices(2 * mesh.vertices).translated((1, 2, 3)), tetrahedron()]
    )
    derived = merged.region_surface(1).vertices
    assert derived.dtype == dtype
    derived.sum().backward()
    assert_allclose(vertices.grad.numpy(), 2)


@pytest.mark.parametrize(
    ("vertices", "faces", "regions", "message"),
    [
        (np.zeros((4, 2)), [[0, 1, 2]], None, "shape"),
        (np.zeros(3), [[0, 1, 2]], None, "shape"),
        ("abc", [[0, 1, 2]], None, "numbers"),
        (np.zeros((3, 3)), [[0, 1, 2, 3]], None, "shape"),
        (np.zeros((3, 3)), [[0, 1, 1.5]], None, "whole"),
        (np.zeros((3, 3)), [["a", "b", "c"]], None, "whole"),
        (np.zeros((3, 3)), np.zeros((0, 3)), None, "no faces"),
        (np.zeros((3, 3)), [[0, 1, 3]], None, "vertex 3"),
        (np.zeros((3, 3)), [[0, 1, -1]], None, "vertex -1"),
        ([[0, 0, 0], [np.nan, 0, 0], [0, np.inf, 0]], [[0, 1, 2]], None, "2 of 3"),
        (np.zeros((3, 3)), [[0, 1, 2]], [[1, 0], [1, 0]], "one row per face"),
        (np.zeros((3, 3)), [[0, 1, 2]], [[1, 0, 0]], "shape"),
        (np.zeros((3, 3)), [[0, 1, 2]], [[1, -1]], "positive"),
        (np.zeros((3, 3)), [[0, 1, 2]], [[1, 1]], "both sides"),
        (torch.zeros((3, 3), dtype=torch.int64), [[0, 1, 2]], None, "floating"),
    ],
)
def test_bad_input_is_refused_in_one_line(vertices, faces, regions, message):
    with pytest.raises(InputError, match=message) as caught:
        Mesh(vertices, faces, regions)
    assert "\n" not in str(caught.value)


def test_bad_arguments_are_refused():
    mesh = tetrahedron()
    with pytest.raises(InputError):
        mesh.translated((1, 2))
    for query in (mesh.region_volume, mesh.region_surface, mesh.is_closed):
        with pytest.raises(InputError, match="no region 5"):
            query(5)
