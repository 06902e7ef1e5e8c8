"""Backgrounds that rise from side to side are seen before a fit; cells and haze are none."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic import Grid
from napari_deltamic.evidence.tilted_ground import tilted_ground, with_ground
from napari_deltamic.fitting.job import levelled
from napari_deltamic.runs.settings import SceneSettings
from napari_deltamic.scene.effects import Background, Effects

SHAPE, SIZE = (24, 36, 40), (0.3, 0.2, 0.2)
Z, Y, X = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
CELL = ((Z / 0.6) ** 2 + (Y / 0.5) ** 2 + ((X - 0.3) / 0.4) ** 2) < 1
LIGHT = 60 * gaussian_filter(CELL.astype(float), 1.2)


def counted(ground):
    return np.random.default_rng(0).poisson(ground + LIGHT).astype(np.float32)


def test_an_even_one_is_left_alone():
    image = counted(np.full(SHAPE, 5.0))
    assert tilted_ground(image) is None
    scene = SceneSettings(voxel_size=SIZE)
    assert with_ground(scene, image) == (scene, "")


@pytest.mark.parametrize(
    ("ground", "numbers"),
    [(40 + 8 * Z - 20 * X, (8, 0, -20)), (60 - 30 * Y**2, (0,) * 6 + (-20, 0, 0))],
    ids=["plane", "bent"],
)
def test_an_uneven_one_is_read_between_the_cells(ground, numbers):
    image = counted(ground)
    found = tilted_ground(image)
    np.testing.assert_allclose(found.coefficients, numbers, atol=2.5)  # blocks are coarse
    scene, told = with_ground(SceneSettings(voxel_size=SIZE), image)
    assert scene.effects.names == ("background",)
    assert "the background varies by" in told
    level = levelled(image, Grid(SHAPE, SIZE), scene.effects)
    assert tilted_ground(level) is None


@pytest.mark.parametrize(("height", "seen"), [(110, True), (40, False)])
def test_a_dome_of_light_counts_where_it_is_high(height, seen):
    dome = height * np.exp(-(Z**2 + Y**2 + X**2))  # no polynomial: less than 0.97 is explained
    found = tilted_ground(counted(5 + dome))
    assert (found is not None) == seen
    assert not seen or found.order == 2


def test_missing_voxels_do_not_count():
    image = counted(40 - 20 * X)
    image[:, :8] = np.nan
    np.testing.assert_allclose(tilted_ground(image).coefficients, (0, 0, -20), atol=1.5)


def test_effects_that_are_told_stay():
    scene = SceneSettings(voxel_size=SIZE, effects=Effects.from_text("illumination"))
    assert with_ground(scene, counted(40 - 20 * X)) == (scene, "")


def test_a_background_that_is_asked_for_begins_as_the_image_shows_it():
    asked = Effects.from_text("background,illumination")
    scene = SceneSettings(voxel_size=SIZE, effects=asked)
    found, told = with_ground(scene, counted(40 - 20 * X))
    assert found.effects.names == asked.names
    assert found.effects.background.coefficients[2] == pytest.approx(-20, abs=2.5)
    assert "the background varies by" in told
    # With numbers of the user's own it stays, and where the image shows none.
    own = scene.effects.adding(Background(order=1, coefficients=(1.0, 0.0, 0.0)))
    scene = scene.model_copy(update={"effects": own})
    assert with_ground(scene, counted(40 - 20 * X)) == (scene, "")


def test_cells_on_one_side_and_haze_around_them_are_no_background():
    one_side = gaussian_filter(np.where(X > 0.1, 40.0, 0.0), 1.0)
    rng = np.random.default_rng(1)
    wander = gaussian_filter(rng.normal(size=SHAPE), 6)
    haze = 20 * (wander - wander.min()) / np.ptp(wander)
    for ground in (one_side, haze):
        assert tilted_ground(counted(5 + ground)) is None


@pytest.mark.parametrize("image", [np.zeros((2, 9, 9)), np.full(SHAPE, np.nan), np.ones(SHAPE)])
def test_where_nothing_can_be_told(image):
    assert tilted_ground(image) is None
