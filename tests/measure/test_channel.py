"""Amounts of another channel: what was put in comes out, within its errors."""

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere
from napari_deltamic.measure.channel import ChannelSettings, channel_amounts
from napari_deltamic.measure.channel_tables import channel_tables
from napari_deltamic.measure.part_images import part_images
from napari_deltamic.scene import Scene, Solid, Surface, render_scene

GRID = nd.Grid((24, 28, 40), (0.3, 0.25, 0.25))
OPTICS = nd.GaussianPSF((0.4, 0.3, 0.3))
WALLS = np.array([150.0, 1500.0, 500.0])  # per um^2: a dim wall beside one ten times brighter
INSIDES = np.array([200.0, 50.0])
BACKGROUND = 5.0


@pytest.fixture(scope="module")
def mesh():
    return DoubleBubble(1.7, (1.0, 0.9, 1.1)).mesh(0.5).translated((3.4, 3.4, 4.8))


def seen(mesh, shift=(0, 0, 0), optics=OPTICS, insides=INSIDES, seed=0):
    """The channel's image, with noise of photons."""
    moved = mesh.translated(shift)
    density = WALLS[moved.interfaces()[1]] / moved.membranes()
    inside = dict(zip(moved.region_ids().tolist(), insides.tolist(), strict=True))
    scene = Scene((Surface(moved, density), Solid(moved, inside)), optics)
    image = render_scene(scene, GRID, 1e-4).double().numpy() + BACKGROUND
    return np.random.default_rng(seed).poisson(image).astype(np.float32)


def test_columns_add_up_to_the_whole(mesh):
    columns = part_images(mesh, GRID, OPTICS, True, True, 1e-4)
    assert columns.shape == (np.prod(GRID.shape), 5)
    scene = Scene((Surface(mesh, 1 / mesh.membranes()), Solid(mesh, 1.0)), OPTICS)
    whole = render_scene(scene, GRID, 1e-4).double().numpy()
    summed = np.asarray(columns.sum(1)).reshape(GRID.shape)
    np.testing.assert_allclose(summed, whole, atol=2e-3 * whole.max())
    assert columns.nnz < 0.7 * np.prod(columns.shape)  # cut out of the grid


def test_a_shifted_blurred_channel(mesh):
    shift, optics = (0.15, -0.1, 0.2), nd.GaussianPSF((0.5, 0.34, 0.34))
    found = channel_amounts(seen(mesh, shift, optics), GRID, mesh, OPTICS)
    np.testing.assert_allclose(found.shift, shift, atol=0.02)
    np.testing.assert_allclose(found.sigma, optics.sigma_um, rtol=0.06)
    assert found.background == pytest.approx(BACKGROUND, rel=0.1)
    assert (np.abs(found.walls - WALLS) < 4 * found.walls_se).all()
    assert (np.abs(found.insides - INSIDES) < 4 * found.insides_se).all()
    assert (found.walls_se < 0.15 * WALLS).all()
    assert found.explained > 0.5


def test_errors_are_those_of_the_noise(mesh):
    held = ChannelSettings(register=False)
    drawn = [channel_amounts(seen(mesh, seed=k), GRID, mesh, OPTICS, held) for k in range(12)]
    off = np.concatenate([(d.walls - WALLS) / d.walls_se for d in drawn])
    assert 0.6 < np.sqrt((off**2).mean()) < 1.5
    assert np.abs(off.mean()) < 0.7


def test_only_what_shines_has_columns(mesh):
    image = seen(mesh, insides=0 * INSIDES)
    found = channel_amounts(image, GRID, mesh, OPTICS, ChannelSettings(insides=False))
    assert found.insides.shape == (0,)
    assert (np.abs(found.walls - WALLS) < 5 * found.walls_se).all()
    walls, cells = channel_tables(mesh, found)
    areas = np.array(walls.values("area_um2"), float)
    np.testing.assert_allclose(walls.values("light"), found.walls * areas)
    assert cells.values("light") == [None, None]
    light = np.array(walls.values("light"), float)
    halves = [light[0] + light[2] / 2, light[1] + light[2] / 2]
    np.testing.assert_allclose(cells.values("membrane_light"), halves)


def test_a_part_that_is_not_seen_is_told(mesh):
    far = nd.Mesh.merge([mesh, sphere((3, 3, 40), 1.0)])
    settings = ChannelSettings(register=False)
    found = channel_amounts(seen(mesh), GRID, far, OPTICS, settings)
    walls, cells = channel_tables(far, found)
    rows = {(r["region_a"], r["region_b"]): r for r in walls.rows}
    assert rows[(3, 0)]["light"] is None
    assert "nothing of it is seen" in rows[(3, 0)]["note"]
    assert "nothing of it is seen" in cells.rows[2]["note"]
    assert rows[(1, 0)]["note"] == ""


def test_missing_voxels_are_left_out(mesh):
    image = seen(mesh)
    image[:, :, 18:22] = np.nan
    found = channel_amounts(image, GRID, mesh, OPTICS, ChannelSettings(register=False))
    assert (np.abs(found.walls - WALLS) < 4 * found.walls_se).all()


def test_what_cannot_be(mesh):
    with pytest.raises(InputError, match="shape"):
        channel_amounts(np.ones((4, 5, 6)), GRID, mesh, OPTICS)
    with pytest.raises(InputError, match="more than 2"):
        channel_amounts(seen(mesh), GRID, mesh, OPTICS, ChannelSettings(most_parts=2))
    with pytest.raises(InputError, match="nothing of the mesh"):
        channel_amounts(seen(mesh), GRID, mesh.translated((0, 0, 60)), OPTICS)
    with pytest.raises(InputError, match="walls, insides, or both"):
        ChannelSettings(walls=False, insides=False)
