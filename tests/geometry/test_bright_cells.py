"""Cells that shine from inside are found, and told from those whose membranes shine."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, gaussian_filter

from napari_deltamic import InputError
from napari_deltamic.geometry.labels.bright_cells import cells_of
from napari_deltamic.images.stacks import read_image

VOXEL = (0.4, 0.2, 0.2)
SHAPE = (24, 48, 60)
CENTRES = np.array([[4.6, 4.8, 2.6], [4.8, 4.2, 5.6], [5.0, 5.4, 9.0]])  # um; two touch
RADII = np.array([1.6, 1.6, 1.4])
BRIGHT = np.array([1.0, 0.6, 1.4])


def truth():
    places = np.stack(np.indices(SHAPE), -1) * VOXEL
    away = np.linalg.norm(places[..., None, :] - CENTRES, axis=-1) - RADII
    nearest = away.argmin(-1)
    return np.where(away.min(-1) < 0, nearest + 1, 0)


def image_of(kind, photons=60.0):
    labels = truth()
    if kind == "nuclei":
        light = np.append(0.0, BRIGHT)[labels]
    else:
        outer = np.stack([distance_transform_edt(labels == k, VOXEL) for k in (1, 2, 3)]).max(0)
        light = ((outer > 0) & (outer < 0.3)).astype(float)
    seen = gaussian_filter(light, (0.6, 1.2, 1.2))
    return np.random.default_rng(0).poisson(4 + photons * seen / seen.max()).astype(np.float32)


def overlaps(found):
    labels = truth()
    shares = []
    for k in (1, 2, 3):
        own = labels == k
        other = found == np.bincount(found[own]).argmax()
        shares.append((own & other).sum() / (own | other).sum())
    return shares


@pytest.mark.parametrize("size", [None, 3.0])
def test_nuclei_are_found_one_by_one(size):
    found = cells_of(image_of("nuclei"), VOXEL, size)
    assert found.bright
    assert found.labels.max() == 3
    assert min(overlaps(found.labels)) > 0.8
    assert found.size == pytest.approx(3.1, rel=0.15)


def test_membranes_are_not_taken_for_bright_cells():
    found = cells_of(image_of("membranes"), VOXEL)
    assert not found.bright
    assert min(overlaps(found.labels)) > 0.5


def test_a_gap_does_not_spoil_them():
    image = image_of("nuclei")
    image[:, :5] = np.nan
    assert cells_of(image, VOXEL).labels.max() == 3


@pytest.mark.parametrize("image", [np.zeros(SHAPE), np.zeros((4, 4)), np.full(SHAPE, np.nan)])
def test_where_nothing_can_be_seen(image):
    with pytest.raises(InputError):
        cells_of(image, VOXEL)


def test_noise_alone_is_no_cell():
    noise = np.random.default_rng(1).poisson(5.0, SHAPE).astype(np.float32)
    with pytest.raises(InputError, match="no cells"):
        cells_of(noise, VOXEL)


def test_a_bead_in_the_cones_of_its_light_is_found(shared_data):
    """They hold more light than the bead, which must not be lost in them."""
    image = read_image(shared_data / "images" / "bead2.5um_EPFL_25pct.tif")[0]
    found = cells_of(image, (0.64, 0.258, 0.258))
    assert found.bright
    assert found.labels.max() == 1
    assert 2.5 < found.size < 4  # it is blurred
