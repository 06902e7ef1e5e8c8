"""The compiled functions check what they are given."""

import numpy as np
import pytest

fourier = pytest.importorskip("napari_deltamic.fourier._mesh_ft")
remeshing = pytest.importorskip("napari_deltamic.geometry._remesh")
calls = pytest.importorskip("benchmarks.robustness.native")

VERTICES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
REGIONS = np.tile([1, 0], (4, 1))


def remeshed(vertices=VERTICES, faces=FACES, regions=REGIONS, length=0.5, passes=2):
    n = len(vertices)
    lengths, none = np.full(n, length), np.zeros(n, np.uint8)
    carried = np.zeros((n, 0))
    return remeshing.remesh(
        vertices, faces, regions, lengths, none, carried, none, passes, True, 0.0
    )


def test_wrong_calls_are_refused_or_do_no_harm():
    found, troubles = calls.attempt(170)  # ten of each function
    assert not troubles
    assert found["refused"] > 100


def test_a_repeated_corner_is_refused():
    faces = FACES.copy()
    faces[0] = [0, 2, 2]
    with pytest.raises(ValueError, match="same vertex twice"):
        remeshed(faces=faces)


@pytest.mark.parametrize("far", [np.nan, np.inf, 1e308])
def test_places_that_cannot_be_computed_with_are_refused(far):
    vertices = VERTICES.copy()
    vertices[1, 1] = far
    with pytest.raises(ValueError, match="finite"):
        remeshed(vertices=vertices)
    with pytest.raises(ValueError, match="finite"):
        remeshing.crossings(vertices, FACES[:, :2].copy(), FACES, 0.0)
    with pytest.raises(ValueError, match="finite"):
        fourier.list_forward_f64(
            vertices, FACES, np.ones(4), np.ones((1, 3)), np.zeros((1, 2)), 1, "generic"
        )


def test_regions_of_any_number_stay_what_they_are():
    large = np.where(REGIONS == 1, 2**40 + 7, 2**31)
    _, faces, regions, *_ = remeshed(regions=large)
    assert np.array_equal(np.unique(regions, axis=0), [[2**40 + 7, 2**31]])
    assert len(faces) == len(remeshed()[1])
    edges = np.array([[0, 1, 2], [0, 1, 2]])
    apart = remeshing.region_pieces(edges, np.array([[1, 0], [2**32 + 1, 2**32]]), 3)
    assert len(np.unique(apart)) == 4


def test_edges_that_would_fill_the_memory_are_refused():
    with pytest.raises(ValueError, match="memory"):
        remeshed(length=1e-9, passes=40)


def test_results_are_never_written_to_a_copy():
    out = np.zeros((1, 2), np.float32)
    with pytest.raises(TypeError):
        fourier.list_forward_f64(VERTICES, FACES, np.ones(4), np.ones((1, 3)), out, 1, "generic")
