"""Points where nothing dark closes, as in nuclei."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic import InputError
from napari_deltamic.errors import RepairWarning
from napari_deltamic.geometry import labels_from_points

SIZE = (1.0, 1.0, 1.0)


def balls(*centres, shape=(32, 32, 48), radius=8.0):
    """(Z, Y, X) bool of balls, voxels."""
    places = np.moveaxis(np.indices(shape), 0, -1)
    return [np.linalg.norm(places - c, axis=-1) < radius for c in centres]


def seen(shining):
    noise = np.random.default_rng(0)
    return noise.poisson(5 + 60 * gaussian_filter(np.asarray(shining, float), 1.2)).astype(float)


@pytest.fixture(scope="module")
def nuclei():
    one, other = balls((16, 16, 12), (16, 16, 36))
    return seen(one | other), one, other


def overlap(one, other):
    return 2 * (one & other).sum() / (one.sum() + other.sum())


def test_a_point_in_a_nucleus_names_it(nuclei):
    image, one, other = nuclei
    found = labels_from_points(image, SIZE, [(16, 16, 36), (14, 17, 13)])
    assert overlap(found == 1, other) > 0.9
    assert overlap(found == 2, one) > 0.9


def test_two_points_in_one_nucleus_are_told(nuclei):
    image, one, _ = nuclei
    with pytest.warns(RepairWarning, match="points 1 and 2 lie in the same region"):
        found = labels_from_points(image, SIZE, [(16, 16, 12), (14, 17, 13)])
    assert overlap(found == 1, one) > 0.9


def test_a_point_beside_all_of_them_names_nothing(nuclei):
    with pytest.raises(InputError, match="point 1 lies in no closed region"):
        labels_from_points(nuclei[0], SIZE, [(2, 2, 24)])


def test_dark_regions_alone_are_none_of_them(nuclei):
    with pytest.raises(InputError, match="point 1 lies in no closed region"):
        labels_from_points(nuclei[0], SIZE, [(16, 16, 36)], dark=True)


@pytest.mark.slow
def test_points_in_a_crowd_of_nuclei_name_them_not_the_gaps_between():
    centres = [(14, y, x) for y in (10, 27, 44) for x in (10, 27, 44)]
    crowd = balls(*centres, shape=(28, 54, 54), radius=7.5)
    image = seen(np.any(crowd, axis=0))
    found = labels_from_points(image, SIZE, centres[:5])
    for k, one in enumerate(crowd[:5], 1):
        assert overlap(found == k, one) > 0.85


@pytest.mark.filterwarnings("error")
def test_nuclei_that_look_like_one_are_parted_at_their_necks():
    centres = [(16, 16, 11), (16, 16, 21), (16, 16, 31)]
    row = balls(*centres, radius=7.0)
    image = seen(np.any(row, axis=0))
    found = labels_from_points(image, SIZE, [centres[k] for k in (2, 0, 1)])
    sizes = np.bincount(found.ravel(), minlength=4)[1:]
    for name, k in ((1, 2), (2, 0), (3, 1)):
        at = np.argwhere(found == name).mean(0)
        assert np.linalg.norm(at - centres[k]) < 1.5
    assert sizes.min() > 0.6 * sizes.max()


def test_a_second_point_in_one_of_the_parts_is_told():
    centres = [(16, 16, 11), (16, 16, 21)]
    image = seen(np.any(balls(*centres, radius=7.0), axis=0))
    with pytest.warns(RepairWarning, match="points 1 and 2 lie in the same region"):
        found = labels_from_points(image, SIZE, [(16, 16, 11), (14, 17, 10), (16, 16, 21)])
    assert set(np.unique(found)) == {0, 1, 3}
    with pytest.warns(RepairWarning, match="points 2 and 3 lie in the same region"):
        found = labels_from_points(image, SIZE, [(16, 16, 11), (16, 16, 21), (16, 16, 21.2)])
    assert set(np.unique(found)) == {0, 1, 2}


@pytest.mark.slow
def test_the_dim_middle_of_a_nucleus_is_not_a_cell():
    """Chromatin often leaves the middle of a nucleus dimmer, and it closes around a point there."""
    (whole,), (middle,) = (balls((20, 20, 24), shape=(40, 40, 48), radius=r) for r in (14.0, 6.0))
    found = labels_from_points(seen(whole - 0.15 * middle), SIZE, [(20, 20, 24)])
    assert overlap(found == 1, whole) > 0.9


def test_a_membrane_around_a_dim_inside_ends_at_its_crest():
    (outer,), (inner,) = (balls((16, 16, 24), radius=r) for r in (9.0, 7.0))
    found = labels_from_points(seen(outer - 0.5 * inner), SIZE, [(16, 16, 24)])
    assert (found == 1).sum() < 1.15 * inner.sum()


def test_cells_in_flat_stacks_end_at_their_membranes():
    """What lies at the first and last slice is no end of a region."""
    _, y, x = np.indices((5, 64, 64))
    centres = [(16, 16), (16, 48), (48, 16), (48, 48)]
    far = np.min([np.hypot(y - a, x - b) for a, b in centres], axis=0)
    light = np.where(np.abs(far - 13) < 1, 1.0, np.where(far < 13, 0.4, 0.0))
    image = np.random.default_rng(0).poisson(5 + 100 * gaussian_filter(light, (0.5, 1.5, 1.5)))
    found = labels_from_points(image.astype(float), (3.0, 1.0, 1.0), [(6, *c) for c in centres])
    for name in range(1, 5):
        assert (found == name).sum() / 5 < 1.1 * np.pi * 13**2
