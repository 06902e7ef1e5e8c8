"""A fit put together of what is chosen: for a window, for commands, of one stack or of a series."""

import numpy as np
import pytest
from test_tilted_ground import SHAPE, SIZE, X, counted

from napari_deltamic import Grid
from napari_deltamic.errors import RepairWarning
from napari_deltamic.evidence.put_together import put_together, start_of
from napari_deltamic.evidence.tilted_ground import tilted_ground
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.seeds import MeshSeeds, PointSeeds
from napari_deltamic.runs.settings import RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.effects.smooth import Background

GRID = Grid(SHAPE, SIZE)
IMAGE = counted(40 - 20 * X)
BALL = sphere((3.5, 3.5, 5.0), 1.5, edge_length=0.5)


def made(scene, points=None, image=IMAGE, **how):
    """The fit, the image that its start was made of, and what was told."""
    seen, told = [], []
    settings = RunSettings(image="", seeds="", scene=scene)

    def start(level, grid):
        seen.append(level)
        return BALL, "rough", points

    job = put_together(settings, image, GRID, start, tell=lambda *news: told.append(news), **how)
    return job, seen[0], told[0]


def test_what_is_left_open_the_image_tells():
    job, level, (scene, uneven, _) = made(SceneSettings(voxel_size=SIZE))
    assert job.settings.scene == scene
    assert scene.effects.names == ("background",)
    assert scene.sigma is not None
    assert "the background varies by" in uneven
    assert tilted_ground(level) is None
    assert job.image is IMAGE


@pytest.mark.parametrize(
    ("further", "crowded"), [((0, 0.6, 0), {1}), ((0, 3.0, 0), set()), ((90, 0, 0), set())]
)
def test_several_points_in_one_surface_are_known(further, crowded):
    middle = np.array([3.5, 3.5, 5.0])
    points = np.stack([middle, middle + further])
    job, _, _ = made(SceneSettings(voxel_size=SIZE), points)
    assert job.crowded == crowded
    assert made(SceneSettings(voxel_size=SIZE))[0].crowded == set()


@pytest.mark.parametrize(
    ("further", "missing"), [((0, 0.6, 0), ()), ((0, 3.0, 0), (2,)), ((90, 0, 0), ())]
)
def test_points_without_a_cell_are_known(further, missing):
    middle = np.array([3.5, 3.5, 5.0])
    job, _, _ = made(SceneSettings(voxel_size=SIZE), np.stack([middle, middle + further]))
    assert job.missing == missing
    assert made(SceneSettings(voxel_size=SIZE))[0].missing == ()


def test_nothing_sees_hot_voxels():
    spoilt = IMAGE.copy()
    spoilt[5, 6, 7] = spoilt[9, 20, 30] = 100 * IMAGE.max()
    with pytest.warns(RepairWarning, match="2 hot voxels"):
        job, level, told = made(SceneSettings(voxel_size=SIZE), image=spoilt)
    np.testing.assert_array_equal(np.isnan(job.image), spoilt != IMAGE)
    np.testing.assert_array_equal(np.isnan(level), spoilt != IMAGE)
    assert job.as_read is spoilt
    assert not job.has_missing  # of the file
    assert told[0].sigma == pytest.approx(made(SceneSettings(voxel_size=SIZE))[2][0].sigma, rel=0.1)


def test_points_of_seeds_are_told_in_um():
    one = PointSeeds(np.array([[3.5, 3.5, 5.0]]) / SIZE, np.array([1.5]), in_voxels=True)
    mesh, kind, points = start_of(one, IMAGE, GRID)
    assert (len(mesh.region_ids()), kind) == (1, "rough")
    np.testing.assert_allclose(points, [[3.5, 3.5, 5.0]])
    assert start_of(MeshSeeds(BALL), IMAGE, GRID)[2] is None


def test_of_a_series_the_background_is_not_looked_for():
    job, level, (_, uneven, _) = made(SceneSettings(voxel_size=SIZE), ground=False)
    assert (job.settings.scene.effects, uneven) == (Effects(), "")
    assert level is IMAGE


@pytest.mark.parametrize("ground", [True, False])
def test_what_is_given_stays_and_counts_for_the_start(ground):
    given = Background(order=1, coefficients=(0, 0, -20))
    scene = SceneSettings(voxel_size=SIZE, sigma=(0.4, 0.3, 0.3), effects=Effects.of(given))
    job, level, told = made(scene, ground=ground)
    assert told == (scene, "", False)
    assert job.settings.scene == scene
    np.testing.assert_allclose(IMAGE - level, -20 * X, atol=1e-3)
