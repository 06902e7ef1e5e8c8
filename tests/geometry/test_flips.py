"""Small walls go, short junctions become walls, small pieces vanish; nothing else changes."""

import warnings
from functools import cache

import numpy as np
import pytest

from napari_deltamic import Mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.contacts import contacts
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.geometry.topology.crossings import crosses
from napari_deltamic.geometry.topology.rearranging import give_way
from napari_deltamic.geometry.topology.small_pieces import small_pieces
from napari_deltamic.geometry.topology.thin_places import short_junctions, small_walls

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
EDGE = 0.3


def ring_of_three(half, radius=1.5):
    """Cells 1 and 2 above and below three others, which meet in a junction; 1 and 2 touch through
    it if ``half`` is small."""
    turns = 2 * np.pi * np.arange(3) / 3 + 0.3
    around = np.stack([0 * turns, np.sin(turns), np.cos(turns)], axis=1)
    ends = np.array([[-half, 0.02, 0.01], [half, 0, 0]])
    return foam(np.concatenate([ends, around]), np.full(5, radius), EDGE)


def sound(mesh):
    assert mesh.is_closed()
    assert not crosses(mesh)
    assert np.bincount(mesh.face_edges().reshape(-1)).max() == 3
    return min(mesh.volumes().values()) > 0


def stayed(before, after, place, reach=2.5 * EDGE):
    """Whether all vertices away from a place are where they were."""
    vertices = before.vertices_numpy()
    apart = np.linalg.norm(vertices[:, None] - place.points[None], axis=2).min(1)
    far = {tuple(v) for v in vertices[apart > reach]}
    assert len(far) > 100
    return far <= {tuple(v) for v in after.vertices_numpy()}


def test_cells_part_at_a_small_wall():
    mesh = ring_of_three(0.9)
    assert (1, 2) in contacts(mesh)
    (wall,) = [p for p in small_walls(mesh, 1.0) if p.regions == (1, 2)]
    assert wall.sides == (3, 4, 5)
    done = give_way(mesh, [wall], EDGE).mesh
    assert sound(done)
    assert contacts(done) == contacts(mesh) - {(1, 2)}
    assert stayed(mesh, done, wall)


def test_cells_at_the_ends_of_a_short_junction_come_to_touch():
    mesh = ring_of_three(1.15)
    assert (1, 2) not in contacts(mesh)
    (line,) = [p for p in short_junctions(mesh, 1.0) if p.sides == (1, 2)]
    assert line.regions == (3, 4, 5)
    done = give_way(mesh, [line], EDGE).mesh
    assert sound(done)
    assert contacts(done) == contacts(mesh) | {(1, 2)}
    assert stayed(mesh, done, line)


def test_a_flip_there_and_back_leaves_the_contacts():
    mesh = ring_of_three(1.15)
    (line,) = [p for p in short_junctions(mesh, 1.0) if p.sides == (1, 2)]
    there = give_way(mesh, [line], EDGE).mesh
    (wall,) = [p for p in small_walls(there, 1.0) if p.regions == (1, 2)]
    back = give_way(there, [wall], EDGE).mesh
    assert sound(back)
    assert contacts(back) == contacts(mesh)


def test_junctions_longer_than_asked_are_none():
    mesh = ring_of_three(1.3)
    assert [p for p in short_junctions(mesh, 2.0) if p.sides == (1, 2)]
    assert not [p for p in short_junctions(mesh, 0.2) if p.sides == (1, 2)]


def test_a_place_that_is_gone_cannot_flip():
    mesh = ring_of_three(0.9)
    (wall,) = [p for p in small_walls(mesh, 1.0) if p.regions == (1, 2)]
    moved = mesh.translated((0.5, 0, 0))
    done = give_way(moved, [wall], EDGE)
    assert done.mesh is moved
    assert done.hopeless == (wall,)


@cache
def enclosed():
    """Four cells around a gap, which is a fifth one taken away."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    balls = np.array([*4 * [1.05], 0.6])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the tips of the fifth
        mesh = foam(np.concatenate([corners, [[0, 0, 0]]]), balls, 0.1)
    return Mesh(mesh.vertices, mesh.faces, np.where(mesh.regions == 5, 0, mesh.regions))


def test_a_gap_that_cells_enclose_closes():
    mesh = enclosed()
    (gap,) = small_pieces(mesh, 0.2)
    assert (gap.regions, gap.sides) == ((0,), (1, 2, 3, 4))
    done = give_way(mesh, [gap], 0.1)
    assert sound(done.mesh)
    assert not small_pieces(done.mesh, 0.2)
    assert contacts(done.mesh) == contacts(mesh)
    assert "a gap between cells 1, 2, 3, 4 has closed" in done.events
    assert stayed(mesh, done.mesh, gap, 0.35)
    total = sum(done.mesh.volumes().values()) - sum(mesh.volumes().values())
    assert total == pytest.approx(gap.volume, rel=0.2)


def test_large_gaps_and_whole_cells_are_no_small_pieces():
    mesh = enclosed()
    (gap,) = small_pieces(mesh, 0.2)
    assert not small_pieces(mesh, 0.9 * gap.volume)
    assert not small_pieces(sphere((0, 0, 0), 0.3, 0.1), 10.0)


def test_a_fragment_of_a_cell_vanishes():
    ball, crumb = sphere((0, 0, 0), 1.0, 0.3), sphere((0, 0, 1.6), 0.2, 0.1)
    places = np.concatenate([ball.vertices, crumb.vertices])
    mesh = Mesh(places, np.concatenate([ball.faces, crumb.faces + len(ball.vertices)]))
    (piece,) = small_pieces(mesh, 0.1)
    assert (piece.regions, piece.sides) == ((1,), (0,))
    done = give_way(mesh, [piece], 0.3).mesh
    assert len(done.faces) == len(ball.faces)
    assert done.region_ids().tolist() == [1]
    told = give_way(mesh, [piece], 0.3).events
    assert told == ("a piece of cell 1 has vanished",)
