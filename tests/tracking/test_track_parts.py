"""The parts of tracking: motion, divisions, alarms, the quality of frames."""

import numpy as np
import pytest
from movies import GRID, MIDDLE, OPTICS, RADIUS, VOXEL, ball, pair, photographed

from napari_deltamic import render
from napari_deltamic.fitting.model.state import FitState
from napari_deltamic.geometry import Mesh
from napari_deltamic.tracking.alarms import CellLook, Volumes, alarms, gone, looks
from napari_deltamic.tracking.divisions import Residual, explains, has_folded, proposals
from napari_deltamic.tracking.frames import Quality
from napari_deltamic.tracking.motion import Start, shifted, starts
from napari_deltamic.tracking.result import Event, FrameResult, lineage

KNOWN = np.ones(GRID.shape, bool)


def rendered(mesh, like=None):
    """Photons that a mesh is expected to give, and the amplitude; 40 at the peak, or as another."""
    clean = render(mesh, GRID, OPTICS, 1e-3).numpy()
    peak = clean if like is None else render(like, GRID, OPTICS, 1e-3).numpy()
    amplitude = 40 / peak.max()
    return (2 + amplitude * clean).astype(np.float32), float(amplitude)


def state(mesh, like=None):
    image, amplitude = rendered(mesh, like)
    density = np.ones(len(mesh.faces))
    return FitState(1, 1, 1, mesh, OPTICS, density, 0.1, amplitude, 2.0, 1.0,
                    _image=image)  # fmt: skip


def found(shift, velocity=(0, 0, 0)):
    """Starts for an image in which the cell has moved by so many voxels."""
    image = photographed(ball(shift))
    expected = {1: VOXEL * np.asarray(velocity, float)}
    return starts(ball(), rendered(ball())[0], image, KNOWN, GRID, OPTICS, expected)


def moved(start):
    return (start.mesh.vertices_numpy().mean(0) - ball().vertices_numpy().mean(0)) / VOXEL


def test_a_shift_is_seen_in_the_images():
    best = found((0, 4, -3))[0]
    assert best.name == "images"
    np.testing.assert_allclose(moved(best), (0, 4, -3), atol=0.6)


def test_a_good_velocity_is_used_and_a_bad_one_is_not():
    assert found((0, 2.5, 0), (0, 2.4, 0))[0].name == "velocity"
    best = found((0, 0, 0), (0, 4, 0))[0]
    assert best.name == "as it was"
    np.testing.assert_array_equal(best.mesh.vertices_numpy(), ball().vertices_numpy())


def test_missing_voxels_do_not_move_a_cell():
    image, known = photographed(ball()), KNOWN.copy()
    known[:, :8] = False
    best = starts(ball(), rendered(ball())[0], np.where(known, image, 0), known, GRID, OPTICS, {})
    assert np.linalg.norm(moved(best[0])) < 0.6


@pytest.mark.parametrize(
    ("left", "levels"),
    [(0.5, (1.0,)), (1.9, (2.0, 1.35, 1.0)), (9, (5.0, 3.2, 2.0, 1.35, 1.0))],
)
def test_the_first_blur_reaches_the_membranes(left, levels):
    assert Start("", ball(), left, 0.0).levels(1.0) == levels


def test_neighbours_that_move_apart_stretch_what_lies_between_them():
    mesh = pair(6.0)
    apart = np.array([0, 0.1, 0.0])
    result = shifted(mesh, {1: -apart, 2: apart})
    shift = result.vertices_numpy() - mesh.vertices_numpy()
    far = np.abs(mesh.vertices_numpy()[:, 1] - MIDDLE[1]).argmax()
    assert np.abs(shift[far, 1]) == pytest.approx(0.1, abs=0.03)
    wall = np.unique(mesh.faces[(mesh.regions > 0).all(axis=1)])
    assert np.abs(shift[wall]).mean() < 0.03
    edges = mesh.edges()
    assert np.linalg.norm(shift[edges[:, 0]] - shift[edges[:, 1]], axis=1).max() < 0.08, (
        "no edge tears"
    )


# Divisions ------------------------------------------------------------------------------------


def whole(mesh):
    """The two cells of a pair as one: its outer surface."""
    outer = (mesh.regions == 0).any(axis=1)
    return Mesh(mesh.vertices, mesh.faces[outer], np.minimum(mesh.regions[outer], 1))


def test_a_wall_inside_a_cell_is_proposed_where_it_is():
    image = photographed(pair(6.0))
    before = Residual(image, KNOWN, GRID, state(whole(pair(6.0)), pair(6.0)))
    (proposal,) = proposals(before, whole(pair(6.0)))
    across = np.array([0, np.cos(0.6), np.sin(0.6)])
    assert abs(proposal.normal @ across) > 0.97
    assert abs((proposal.point - MIDDLE) @ across) < 0.7 * VOXEL
    assert proposal.evidence > 15
    assert 0.5 < proposal.brightness < 1.5
    after = Residual(image, KNOWN, GRID, state(pair(6.0)))
    assert explains(before, after, 1)
    assert not explains(before, before, 1)


def test_a_cell_has_folded_where_its_surface_lies_along_the_wall():
    image, one = photographed(pair(6.0)), whole(pair(6.0))
    start = Residual(image, KNOWN, GRID, state(one, pair(6.0)))
    (wall,) = proposals(start, one)
    assert not has_folded(start, start, wall), "its surface is where it was"
    thinner = Mesh(MIDDLE + 0.85 * (one.vertices_numpy() - MIDDLE), one.faces, one.regions)
    assert not has_folded(start, Residual(image, KNOWN, GRID, state(thinner)), wall)
    places = one.vertices_numpy()
    along = (places - wall.point) @ wall.normal
    size = np.abs(along).max()
    waist = 1 - 0.8 * np.exp(-0.5 * (along / (0.25 * size)) ** 2)
    flat = wall.point + np.outer(along, wall.normal)
    folded = Mesh(flat + waist[:, None] * (places - flat), one.faces, one.regions)
    assert has_folded(start, Residual(image, KNOWN, GRID, state(folded)), wall)


@pytest.mark.parametrize("seed", range(4))
def test_noise_and_a_bright_spot_are_no_wall(seed):
    image = photographed(ball(), seed)
    assert proposals(Residual(image, KNOWN, GRID, state(ball())), ball()) == []
    z, y, x = np.round(MIDDLE / VOXEL).astype(int)
    image[z - 1 : z + 2, y - 1 : y + 2, x - 1 : x + 2] += 40
    assert proposals(Residual(image, KNOWN, GRID, state(ball())), ball()) == []


# Alarms ---------------------------------------------------------------------------------------


def two(left=(0, -4, 0), right=(0, 4, 0), radius=0.5):
    return Mesh.merge([ball(left, radius * RADIUS), ball(right, radius * RADIUS)])


def test_cells_that_stay_give_no_alarm():
    assert alarms(two((0, -4.5, 0)), two(), looks(two()), GRID) == {}


def test_a_cell_on_the_place_of_its_neighbour_is_an_alarm():
    swapped = two((0, 4, 0), (0, 9, 0))
    found = alarms(swapped, two(), looks(two()), GRID)
    assert found[1] == "it is where cell 2 should be"
    assert "from where it was expected" in found[2]


def test_a_volume_that_jumps_is_an_alarm():
    found = alarms(two(radius=0.66), two(), looks(two()), GRID)
    assert set(found) == {1, 2}
    assert "its volume is 2.3 times what it was" in found[1]


def told_of(last, usual=0.01):
    """Jumps of one cell in the last of eight frames; the others scatter by a share."""
    frames, random = Volumes(), np.random.default_rng(0)
    for off in random.normal(scale=usual, size=7):
        frames.add({1: CellLook(100 * np.exp(off), np.zeros(3))})
    return frames.jumps({1: CellLook(last, np.zeros(3)), 2: CellLook(5.0, np.zeros(3))})


def test_a_volume_that_changes_as_none_has_before_is_an_alarm():
    assert told_of(118.0) == {1: "its volume is 1.2 times that of the frames before"}
    assert told_of(84.0) == {1: "its volume is 0.84 times that of the frames before"}
    assert told_of(105.0) == {}  # too little to matter
    assert told_of(118.0, usual=0.1) == {}  # usual here


def test_of_the_first_frames_no_volume_is_unusual():
    frames = Volumes()
    assert frames.jumps({1: CellLook(1.0, np.zeros(3))}) == {}
    frames.add({1: CellLook(1.0, np.zeros(3))})
    frames.add({1: CellLook(0.0, np.zeros(3))})  # it has gone
    assert frames.jumps({1: CellLook(9.0, np.zeros(3))}) == {}


def test_cells_that_have_gone():
    mesh = Mesh.merge([ball((0, 0, 0), 0.8), ball((0, -17, 0)), ball((0, 5, 5), 0.02)])
    found = gone(mesh, {1: 400 * RADIUS**3}, GRID, 0.3)
    assert "shrunk to 0% of its largest volume" in found[1]
    assert found[2] == "it has left the field of view"
    assert found[3] == "it has shrunk to a point"


# Frames ---------------------------------------------------------------------------------------


def test_frames_like_the_others_are_good():
    quality = Quality(GRID, OPTICS)
    for seed in range(3):
        image = photographed(ball(), seed, peak=40 - 6 * seed)  # it bleaches
        assert quality.flaw(image) == ""
        assert quality.misfit(0.1 + 0.02 * seed) == ""
        quality.accept(image, 0.1 + 0.02 * seed)
    assert quality.misfit(0.6) == "the meshes explain 40% instead of 88% of it"


def test_mostly_missing_frames_are_bad():
    image = photographed(ball())
    image[:, :20] = np.nan
    assert "are known" in Quality(GRID, OPTICS).flaw(image)


# Lineage --------------------------------------------------------------------------------------


def test_lives_of_cells():
    one, daughters = ball(), pair(6.0)
    daughters = Mesh(
        daughters.vertices,
        daughters.faces,
        np.where(daughters.regions > 0, daughters.regions + 1, 0),
    )
    results = [
        FrameResult(0, 0.0, one),
        FrameResult(1, 1.0, None, "left out"),
        FrameResult(2, 2.0, daughters, "", (Event("divided", 2, 1, "it divided", (2, 3)),)),
        FrameResult(3, 3.0, daughters, "", (Event("alarm", 3, 2, "it may be lost"),)),
    ]
    lives = [(c.cell, c.parent, c.first, c.last, c.end) for c in lineage(results)]
    assert lives == [(1, 0, 0, 0, "it divided"), (2, 1, 2, 3, ""), (3, 1, 2, 3, "")]
