import numpy as np
import pytest
from benchmarks.image_similarity import image_similarity

from napari_deltamic.errors import InputError

RNG = np.random.default_rng(0)
IMAGE = RNG.normal(size=(6, 20, 24)).cumsum(1).cumsum(2)


def test_brightness_and_offset_of_a_rendered_image_do_not_matter():
    found = image_similarity(IMAGE, 3 * IMAGE + 7)
    assert found.mse < 1e-25
    assert found.psnr > 200
    assert found.ssim == pytest.approx(1)
    assert found.amplitude == pytest.approx(1 / 3)
    assert found.background == pytest.approx(-7 / 3)


def test_noise_of_a_known_size_gives_its_mse():
    low, high = np.percentile(IMAGE, (0.1, 99.9))
    noise = 0.1 * (high - low) * RNG.normal(size=IMAGE.shape)
    found = image_similarity(IMAGE + noise, IMAGE)
    span = np.ptp(np.percentile(IMAGE + noise, (0.1, 99.9)))
    assert found.mse == pytest.approx(noise.var() / span**2, rel=0.02)
    assert found.psnr == pytest.approx(-10 * np.log10(found.mse))
    assert found.ssim < 0.9


def test_only_voxels_that_count_are_compared():
    spoilt = IMAGE.copy()
    spoilt[:, :5] = 1e6
    spoilt[0, 0, 0] = np.nan
    counted = np.ones(IMAGE.shape, bool)
    counted[:, :5] = False
    assert image_similarity(IMAGE, spoilt, counted).mse < 1e-20


@pytest.mark.parametrize(
    ("measured", "rendered", "message"),
    [
        (IMAGE, IMAGE[:3], "one 3D shape"),
        (np.ones_like(IMAGE), IMAGE, "flat"),
        (np.full_like(IMAGE, np.nan), IMAGE, "no voxel"),
    ],
)
def test_what_cannot_be_compared_is_refused(measured, rendered, message):
    with pytest.raises(InputError, match=message):
        image_similarity(measured, rendered)
