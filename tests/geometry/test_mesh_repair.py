import numpy as np
import pytest
from benchmarks.shapes import box, torus
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry import Mesh, load_mesh, repair, sphere


def parts(mesh):
    return mesh.vertices, mesh.faces, mesh.regions


def flipped(faces, rows):
    faces = faces.copy()
    faces[rows] = faces[rows][:, ::-1]
    return faces


@pytest.mark.parametrize(
    "mesh", [sphere((1, 2, 3), 2.0), torus((0, 0, 0), 3, 1), box((0, 0, 0), 1)]
)
def test_a_good_mesh_is_left_alone(mesh):
    result, messages = repair(*parts(mesh))
    assert messages == []
    assert_array_equal(result.vertices, mesh.vertices)
    assert_array_equal(result.faces, mesh.faces)
    assert_array_equal(result.regions, mesh.regions)


def test_triangle_soup_is_joined():
    mesh = box((0, 0, 0), 1)
    soup = mesh.vertices[mesh.faces].reshape(-1, 3)
    soup += np.random.default_rng(0).uniform(-1e-12, 1e-12, soup.shape)
    result, messages = repair(soup, np.arange(36).reshape(-1, 3))
    assert messages == ["merged 28 duplicate vertices into others"]
    assert len(result.vertices) == 8
    assert result.is_closed()
    assert_allclose(result.region_volume(1), 1)


def test_faces_that_use_a_vertex_twice_and_unused_vertices():
    mesh = box((0, 0, 0), 1)
    faces = np.concatenate([mesh.faces, [[0, 0, 1]]])
    vertices = np.concatenate([mesh.vertices, [[9, 9, 9]], [[np.nan] * 3]])
    result, messages = repair(vertices, faces)
    assert messages == ["removed 2 unused vertices", "removed 1 face that used a vertex twice"]
    assert_array_equal(result.faces, mesh.faces)


@pytest.mark.parametrize("winding", [1, -1])
def test_duplicate_faces(winding):
    mesh = sphere((0, 0, 0), 1.0)
    result, messages = repair(
        mesh.vertices, np.concatenate([mesh.faces, mesh.faces[5:7, ::winding]])
    )
    assert messages == ["removed 2 duplicate faces"]
    assert_array_equal(result.faces, mesh.faces)


def test_a_surface_that_is_there_twice():
    mesh = sphere((0, 0, 0), 1.0)
    result, messages = repair(mesh.vertices, np.concatenate([mesh.faces, mesh.faces]))
    assert messages == [f"removed {len(mesh.faces)} duplicate faces"]
    assert_array_equal(result.faces, mesh.faces)


def test_an_open_sheet_that_is_there_twice():
    vertices = [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1]]
    faces = [[0, 1, 2], [2, 1, 3]]
    result, messages = repair(vertices, faces + faces)
    assert messages == ["removed 2 duplicate faces"]
    assert len(result.faces) == 2


def test_touching_boxes_keep_both_walls():
    both = Mesh.merge([box((0, 0, 0), 1), box((0, 0, 1), 1)])
    result, messages = repair(both.vertices, both.faces)  # one region
    assert messages == ["merged 4 duplicate vertices into others"]
    assert result.is_closed()
    assert_allclose(result.region_volume(1), 2)


def test_boxes_that_share_an_edge():
    both = Mesh.merge([box((0, 0, 0), 1), box((0, 1, 1), 1)])
    faces = flipped(both.faces, np.arange(12, 24))  # the second one inside out
    result, messages = repair(both.vertices, faces)
    assert "merged 2 duplicate vertices" in messages[0]
    assert messages[1].startswith("turned 1 inside-out surface (12 faces)")
    assert result.is_closed()
    assert_allclose(result.region_volume(1), 2)


def split_with_flat_face(mesh, edge_row):
    """Cut a closed mesh along an edge by a face of zero area, as decimation tools leave them."""
    a, b = mesh.edges()[edge_row]
    rows = np.nonzero((mesh.face_edges() == edge_row).any(axis=1))[0]
    middle = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[[a, b]].mean(axis=0)[None]])
    split = mesh.faces[rows[0]]
    halves = [np.where(split == end, middle, split) for end in (a, b)]
    along = np.roll(split, -int(np.nonzero(split == a)[0][0]))[1] == b
    flat = [a, b, middle] if along else [b, a, middle]
    faces = np.concatenate([np.delete(mesh.faces, rows[0], axis=0), halves, [flat]])
    return Mesh(vertices, faces)


@pytest.mark.parametrize("edge_row", [0, 7, 100])
def test_zero_area_faces_go_and_the_surface_stays_closed(edge_row):
    mesh = split_with_flat_face(sphere((5, 6, 7), 1.0, subdivisions=2), edge_row)
    assert mesh.is_closed()
    result, messages = repair(*parts(mesh))
    assert messages == ["removed 1 face of zero area"]
    assert result.is_closed()
    assert (result.areas() > 1e-6).all()
    assert_allclose(result.region_volume(1), mesh.region_volume(1))
    assert_allclose(result.areas().sum(), mesh.areas().sum())


def test_small_and_thin_faces_are_kept():
    mesh = box((0, 0, 0), (1, 1, 1e-6)).translated((100, 100, 100))
    result, messages = repair(*parts(mesh))
    assert messages == []
    assert len(result.faces) == 12


def test_label_order_is_made_uniform():
    mesh = sphere((0, 0, 0), 1.0)
    regions = mesh.regions.copy()
    regions[:7] = [0, 1]
    result, messages = repair(mesh.vertices, flipped(mesh.faces, slice(7)), regions)
    assert messages == ["put the regions of 7 faces in the order of the rest of the wall"]
    assert_array_equal(np.unique(result.regions, axis=0), [[1, 0]])
    assert_allclose(result.region_volume(1), mesh.region_volume(1))
    # The same order everywhere is a custom, not a flaw.
    result, messages = repair(mesh.vertices, mesh.faces[:, ::-1], mesh.regions[:, ::-1])
    assert messages == []
    assert_allclose(result.region_volume(1), mesh.region_volume(1))


def test_same_region_on_both_sides():
    mesh = box((0, 0, 0), 1)
    regions = np.concatenate([mesh.regions, [[1, 1]]])
    result, messages = repair(mesh.vertices, np.concatenate([mesh.faces, [[0, 3, 5]]]), regions)
    assert messages == ["removed 1 face with the same region on both sides"]
    assert_array_equal(result.faces, mesh.faces)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10**6), fraction=st.floats(0.01, 0.45))
def test_wrong_windings_are_turned_back(seed, fraction):
    mesh = torus((0, 0, 0), 3, 1, edge_length=0.7)
    rows = np.random.default_rng(seed).random(len(mesh.faces)) < fraction
    result, messages = repair(mesh.vertices, flipped(mesh.faces, rows))
    assert_allclose(result.region_volume(1), mesh.region_volume(1))
    assert_allclose(result.normals(), mesh.normals(), atol=1e-12)
    if rows.any():
        assert len(messages) == 1
        assert messages[0].startswith(f"turned {rows.sum()} wrongly wound face")


def test_windings_across_junctions_of_walls():
    from test_mesh import two_cubes

    mesh = two_cubes()
    good = repair(*parts(mesh))[0]
    rng = np.random.default_rng(3)
    for _ in range(20):
        rows = rng.random(len(mesh.faces)) < 0.3
        result, _ = repair(mesh.vertices, flipped(mesh.faces, rows), mesh.regions)
        assert_array_equal(result.regions, good.regions)
        assert_allclose(result.normals(), good.normals(), atol=1e-12)


def test_inside_out_surface_is_turned():
    mesh = sphere((0, 0, 0), 1.0)
    result, messages = repair(mesh.vertices, mesh.faces[:, ::-1])
    assert messages[0].startswith("turned 1 inside-out surface")
    assert_allclose(result.region_volume(1), mesh.region_volume(1))


def test_a_cavity_is_left_alone_and_a_neighbour_is_not():
    outer, inner = sphere((0, 0, 0), 2.0), sphere((0, 0, 0), 1.0)
    shell = Mesh.merge([outer, inner])
    faces = flipped(shell.faces, slice(len(outer.faces), None))
    result, messages = repair(shell.vertices, faces)
    assert messages == []
    assert_allclose(result.region_volume(1), outer.region_volume(1) - inner.region_volume(1))

    beside = (
        shell.vertices
        + np.where(np.arange(len(shell.vertices)) < len(outer.vertices), 0, 5)[:, None]
    )
    result, messages = repair(beside, faces)
    assert len(messages) == 1
    assert_allclose(result.region_volume(1), outer.region_volume(1) + inner.region_volume(1))


def test_a_cell_within_a_cell():
    outer, inner = sphere((0, 0, 0), 2.0), sphere((0, 0, 0), 1.0)
    both = Mesh.merge([outer, inner])
    regions = np.where(np.arange(len(both.faces))[:, None] < len(outer.faces), [1, 0], [2, 1])
    for faces in (both.faces, flipped(both.faces, slice(len(outer.faces), None))):
        result, _ = repair(both.vertices, faces, regions)
        assert_allclose(
            list(result.volumes().values()),
            [outer.region_volume(1) - inner.region_volume(1), inner.region_volume(1)],
        )


def test_a_one_sided_surface_is_reported():
    t = np.arange(12) * 2 * np.pi / 12
    rim = [
        np.stack(
            [s * np.sin(t / 2), *((3 + s * np.cos(t / 2)) * f(t) for f in (np.sin, np.cos))], 1
        )
        for s in (-1, 1)
    ]
    vertices = np.concatenate(rim)
    faces = []
    for i in range(12):
        j = (i + 1) % 12
        a, b, c, d = i, i + 12, j, j + 12
        if j == 0:
            c, d = d, c
        faces += [[a, b, c], [c, b, d]]
    _, messages = repair(vertices, faces)
    assert any("windings still disagree" in message for message in messages)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), "no faces"),
        (np.eye(3), [[0, 1, 5]], "vertex 5"),
        (np.eye(3) * np.nan, [[0, 1, 2]], "NaN"),
        (np.zeros((3, 3)), [[0, 1, 2]], "degenerate"),
        (np.eye(3)[:, :2], [[0, 1, 2]], "shape"),
        (np.eye(3), [[0, 0, 1]], "degenerate"),
    ],
)
def test_what_cannot_be_repaired_is_refused(vertices, faces, message):
    with pytest.raises(InputError, match=message):
        repair(vertices, faces)


def test_only_faces_without_sides_are_refused():
    with pytest.raises(InputError):
        repair(np.eye(3), [[0, 1, 2]], [[1, 1]])


def test_cell4(shared_data):
    path = shared_data / "multimaterial" / "deltamic__cell4.rec"
    n_vertices, words = 8162, path.read_text().split()
    xyz = np.array(words[1 : 1 + 3 * n_vertices], dtype=float).reshape(-1, 3)
    table = np.array(words[2 + 3 * n_vertices :], dtype=int).reshape(-1, 5)
    # Where windings disagree, the volume depends on the origin; this is about that of the file.
    a, b, c = (xyz[table[:, corner]] for corner in range(3))
    signed = np.einsum("fi,fi->f", a, np.cross(b, c)) / 6
    before = np.array(
        [signed[table[:, 3] == r].sum() - signed[table[:, 4] == r].sum() for r in range(5)]
    )
    with pytest.warns(RepairWarning) as caught:
        after = load_mesh(path)
    text = " | ".join(str(w.message) for w in caught)
    assert "merged 2 duplicate vertices" in text
    assert "turned 224 wrongly wound faces" in text
    assert_allclose(before[1:].sum(), 1038303, rtol=1e-5)
    assert_allclose(sum(after.volumes().values()), 1070968, rtol=1e-5)  # 3.1 % more
    assert_allclose(after.region_volume(3) / before[3], 1.149, rtol=1e-3)
    assert after.is_closed()
    assert repair(*parts(after))[1] == []
