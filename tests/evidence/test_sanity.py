"""What is said before a fit about images that cannot be what they are said to be."""

import warnings

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from napari_deltamic.evidence.sanity import doubts, followed
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Grid

SHAPE, VOXEL = (32, 32, 32), (0.3, 0.2, 0.2)


def distance(centre=(4.6, 3.1, 3.0), radius=2.0):
    """um; negative inside of a ball."""
    places = np.moveaxis(np.indices(SHAPE), 0, -1) * VOXEL
    return np.linalg.norm(places - np.array(centre), axis=-1) - radius


def membrane(seed=0, peak=80.0):
    light = gaussian_filter(np.exp(-((distance() / 0.15) ** 2)), (2.0, 1.2, 1.2))
    return np.random.default_rng(seed).poisson(peak * light / light.max() + 4).astype(np.float32)


def kinds(image, voxel=VOXEL, seeds=None, **more):
    return [doubt.kind for doubt in doubts(image, voxel, seeds, **more)]


SEEDS = sphere((4.6, 3.1, 3.0), 1.8)


def test_nothing_is_said_of_an_image_in_order():
    assert kinds(membrane(), seeds=SEEDS) == []
    holes = membrane()
    holes[10:14] = np.nan
    assert kinds(holes, seeds=SEEDS) == []


@pytest.mark.parametrize("factor", [0.25, 4])
def test_a_wrong_step_along_z(factor):
    assert kinds(membrane(), (VOXEL[0] * factor, *VOXEL[1:])) == ["voxel size"]


def test_nanometres_for_micrometres():
    (doubt,) = doubts(membrane(), (300.0, 200.0, 200.0))
    assert doubt.kind == "voxel size"
    assert "300 200 200" in doubt.sentence


def test_voxels_in_the_order_x_y_z():
    (doubt,) = doubts(membrane(), (0.2, 0.2, 0.3))
    assert doubt.kind == "voxel size"
    assert "0.2 um along Y but 0.3 um along X" in doubt.sentence
    assert "in the order Z Y X?" in doubt.sentence
    assert kinds(membrane(), (0.3, 0.2, 0.204)) == []  # as after a rounded resampling


def test_leaning_slices():
    raw = membrane()
    lean = np.stack([shift(s, (1.4 * (k - 16), 0), mode="nearest") for k, s in enumerate(raw)])
    assert kinds(lean) == ["lean"]


def test_cut_brightness():
    assert kinds(np.minimum(membrane(), 50), seeds=SEEDS) == ["saturation"]


def test_nothing_but_noise():
    assert kinds(np.random.default_rng(0).poisson(9.0, SHAPE), seeds=SEEDS) == ["empty"]


@pytest.mark.parametrize("value", [1, 7])
def test_labels_in_place_of_an_image(value):
    inner, other = distance() < 0, distance((2.4, 1.4, 5.0), 1.2) < 0
    image = np.where(inner, value, np.where(other, 12 if value > 1 else 1, 0)).astype(np.float32)
    assert kinds(image, seeds=SEEDS) == ["labels"]
    assert kinds(gaussian_filter(image, 1.0)) != ["labels"]


def test_a_stack_of_few_grey_levels_is_no_label_image():
    smooth = np.rint(gaussian_filter(membrane(), 2.0) / 4)
    assert len(np.unique(smooth)) == 12
    assert "labels" not in kinds(smooth)


def test_seeds_of_another_image():
    elsewhere = gaussian_filter(np.random.default_rng(0).normal(size=SHAPE), 2.5)
    image = np.random.default_rng(1).poisson(40 + 200 * elsewhere.clip(-0.1))
    assert "seeds" in kinds(image, seeds=SEEDS)


def test_time_taken_for_depth():
    rng = np.random.default_rng(0)
    frames = [shift(membrane()[16], d) for d in np.cumsum(rng.normal(0, 0.1, (32, 2)), 0)]
    assert kinds(rng.poisson(np.clip(frames, 0.1, None))) == ["time"]


def test_a_single_slice():
    image = membrane()
    alone = np.arange(len(image))[:, None, None] == 15
    for one in (image[15:16], np.where(alone, image, 0), np.where(alone, image, np.nan)):
        (doubt,) = doubts(one, VOXEL, SEEDS)
        assert doubt.kind == "slices"
        assert "does not tell how high cells are" in doubt.sentence
    assert kinds(image[14:16], seeds=SEEDS) == []


def test_images_that_hardly_are_some_raise_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for image in (np.zeros((2, 3, 4)), np.ones((8, 8, 8)), np.full((9, 9, 9), np.nan)):
            doubts(image, VOXEL)


def test_seeds_where_the_image_is_missing_raise_nothing():
    image = np.random.default_rng(0).poisson(5.0, (20, 20, 20)).astype(float)
    image[:10] = np.nan
    seeds = sphere((1.0, 1.0, 1.0), 0.3, edge_length=0.2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert followed(image, Grid(image.shape, (0.3, 0.2, 0.2)), seeds) == 0


def test_a_logarithm_is_known_by_its_noise():
    assert kinds(20 * np.log1p(membrane()), seeds=SEEDS) == ["brightness"]
    assert kinds(10 * np.sqrt(membrane()), seeds=SEEDS) == []  # a camera's own noise is as even


def test_without_noise_nothing_is_said_of_brightness():
    light = gaussian_filter(np.exp(-((distance() / 0.15) ** 2)), (2.0, 1.2, 1.2))
    for image in (light, np.log1p(100 * light)):
        assert "brightness" not in kinds(image.astype(np.float32), seeds=SEEDS)


def test_background_that_rises_across_is_no_film():
    rising = np.random.default_rng(1).poisson(np.broadcast_to(np.linspace(0, 60, 32), SHAPE))
    assert "time" not in kinds(membrane() + rising.astype(np.float32))
