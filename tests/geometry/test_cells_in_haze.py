"""Nuclei are found in the light of what holds them; texture and noise are no cells."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.bright_cells import cells_of

SHAPE = (40, 90, 90)
COUNT = 16
RADIUS = 4.0  # voxels; of the nuclei
PLACES = np.indices(SHAPE).transpose(1, 2, 3, 0).astype(float)
MIDDLE = (np.array(SHAPE) - 1) / 2
AWAY = np.linalg.norm((PLACES - MIDDLE) / MIDDLE, axis=-1)  # 1 at the border of an ellipsoid


def nuclei():
    """Labels of balls in the body, none near its surface."""
    rng, found = np.random.default_rng(0), np.zeros(SHAPE, int)
    centres = []
    while len(centres) < COUNT:
        centre = rng.uniform(0, 1, 3) * SHAPE
        near = np.linalg.norm((centre - MIDDLE) / MIDDLE) > 0.62
        if near or any(np.linalg.norm(centre - other) < 2.8 * RADIUS for other in centres):
            continue
        centres.append(centre)
        found[np.linalg.norm(PLACES - centre, axis=-1) < RADIUS] = len(centres)
    return found


def image_of(light, photons=60.0):
    seen = gaussian_filter(light, (1.5, 1.2, 1.2))
    return np.random.default_rng(1).poisson(3 + photons * seen).astype(np.float32)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("haze", "size"),
    [
        pytest.param("body", None, marks=SLOW),
        ("body", 9.0),
        pytest.param("centre", None, marks=SLOW),
        pytest.param("none", None, marks=SLOW),
    ],
)
def test_nuclei_of_an_embryo_that_shines_all_over_are_found(haze, size):
    truth = nuclei()
    light = {"body": AWAY < 0.9, "centre": np.exp(-2 * AWAY**2), "none": 0.0}[haze]
    found = cells_of(image_of((truth > 0) + 1.0 * light), (1.0, 1.0, 1.0), size)
    assert found.bright
    assert found.labels.max() == COUNT
    for k in range(1, COUNT + 1):
        own = truth == k
        other = found.labels == np.bincount(found.labels[own]).argmax()
        assert (own & other).sum() / (own | other).sum() > 0.5
    assert found.size == pytest.approx(2 * RADIUS, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["even", "textured", "few grains"])
def test_what_a_body_holds_may_be_no_cells(kind):
    light = (AWAY < 0.9).astype(float)
    if kind == "textured":
        texture = gaussian_filter(np.random.default_rng(2).normal(size=SHAPE), 2.5)
        light *= np.exp(0.4 * texture / texture.std())
    elif kind == "few grains":
        truth = nuclei()
        light += (truth > 0) & (truth <= 5)
    found = cells_of(image_of(light), (1.0, 1.0, 1.0))
    assert found.labels.max() == 1


@pytest.mark.slow
def test_noise_holds_no_cells():
    with pytest.raises(InputError, match="no cells"):
        cells_of(image_of(np.ones(SHAPE)), (1.0, 1.0, 1.0))
