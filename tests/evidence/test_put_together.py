"""A fit put together of what is chosen: for a window, for commands, of one stack or of a series."""

import numpy as np
import pytest
from test_tilted_ground import SHAPE, SIZE, X, counted

from napari_deltamic import Grid
from napari_deltamic.evidence.put_together import put_together
from napari_deltamic.evidence.tilted_ground import tilted_ground
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.effects.smooth import Background

GRID = Grid(SHAPE, SIZE)
IMAGE = counted(40 - 20 * X)
BALL = sphere((3.5, 3.5, 5.0), 1.5, edge_length=0.5)


def made(scene, **how):
    """The fit, the image that its start was made of, and what was told."""
    seen, told = [], []
    settings = RunSettings(image="", seeds="", scene=scene)

    def start(level, grid):
        seen.append(level)
        return BALL, "rough"

    job = put_together(settings, IMAGE, GRID, start, tell=lambda *news: told.append(news), **how)
    return job, seen[0], told[0]


def test_what_is_left_open_the_image_tells():
    job, level, (scene, uneven, _) = made(SceneSettings(voxel_size=SIZE))
    assert job.settings.scene == scene
    assert scene.effects.names == ("background",)
    assert scene.sigma is not None
    assert "the background varies by" in uneven
    assert tilted_ground(level) is None
    assert job.image is IMAGE


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
