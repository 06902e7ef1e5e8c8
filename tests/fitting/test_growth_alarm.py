import numpy as np
import pytest

from napari_deltamic import Mesh
from napari_deltamic.fitting.surface.growth_alarm import (
    GrowthAlarm,
    shrunken,
    told_shrunken,
    why_stuck,
)
from napari_deltamic.geometry import sphere


@pytest.fixture
def mesh():
    one = sphere((0, 0, 0), 1, subdivisions=1)
    return Mesh.merge([one, one.translated((9, 0, 0))])


def grown(mesh, region, factor):
    """One sphere of the two scaled about its own centre."""
    vertices = mesh.vertices_numpy().copy()
    corners = np.unique(mesh.faces[(mesh.regions == region).any(1)])
    middle = vertices[corners].mean(0)
    vertices[corners] = middle + factor * (vertices[corners] - middle)
    return mesh.with_vertices(vertices)


def leaked(mesh, region, reach):
    """One sphere of the two with a cap drawn out, as through a neck."""
    vertices = mesh.vertices_numpy().copy()
    corners = np.unique(mesh.faces[(mesh.regions == region).any(1)])
    cap = corners[vertices[corners, 1] > 0.6]
    vertices[cap, 1] += reach
    return mesh.with_vertices(vertices)


@pytest.mark.parametrize("factor", [0.5, 1.5, 4.0])
def test_a_start_of_the_wrong_size_is_silent(mesh, factor):
    assert GrowthAlarm(mesh).check(grown(mesh, 1, factor)) == ""


def test_a_leak_is_told_once_for_each_region(mesh):
    alarm = GrowthAlarm(mesh)
    message = alarm.check(leaked(mesh, 2, 8))
    assert "cell 2 (" in message
    assert "1 (" not in message
    assert "\n" not in message
    assert alarm.check(leaked(mesh, 2, 9)) == ""
    assert "cell 1 (" in alarm.check(leaked(leaked(mesh, 2, 9), 1, 8))


def test_a_region_that_starts_without_area_is_no_crash():
    flat = Mesh([[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 1, 0]], [[0, 1, 2]])
    alarm = GrowthAlarm(flat)
    alarm.check(flat.with_vertices([[0, 0, 0], [0, 0, 1], [0, 1, 2], [0, 1, 0]]))


def test_regions_that_are_only_points_are_told():
    mesh = Mesh.merge([sphere((0, 0, 0), 1.0, subdivisions=2), sphere((5, 0, 0), 0.02)])
    assert shrunken(mesh, 0.2) == [2]
    assert shrunken(mesh, 0.01) == []


def test_only_where_every_cell_is_a_point_the_fit_is_stuck():
    assert why_stuck(0.9, False, [7], 37) == ""
    assert told_shrunken([7, 9]).startswith("cells 7 and 9 have shrunk to a point: place them")
    assert told_shrunken([]) == ""
    assert why_stuck(0.9, False, [1, 2], 2).startswith("stuck: cells 1 and 2 have shrunk")
    assert why_stuck(0.01, False, [], 37).startswith("stuck")
