"""Labels that only mark their cells, such as those of their nuclei."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, gaussian_filter, grey_dilation, grey_erosion

from napari_deltamic import Grid
from napari_deltamic.errors import InputError, RepairWarning
from napari_deltamic.geometry import mesh_from_labels
from napari_deltamic.geometry.labels.whole_cells import whole_cells
from napari_deltamic.runs.seeds import LabelSeeds

SIZE = np.ones(3)
SHAPE = (32, 32, 60)
MIDDLES = (16, 16, 15), (16, 16, 41)
RADIUS = 10.0


def distances(middle):
    places = np.moveaxis(np.indices(SHAPE), 0, -1)
    return np.linalg.norm(places - middle, axis=-1)


def numbered(radius):
    labels = np.zeros(SHAPE, np.int32)
    for name, middle in enumerate(MIDDLES, 1):
        labels[distances(middle) < radius] = name
    return labels


def seen(light):
    noise = np.random.default_rng(0)
    return noise.poisson(5 + 100 * gaussian_filter(light, 1.2)).astype(float)


def shells():
    return sum(np.abs(distances(middle) - RADIUS) < 1 for middle in MIDDLES).astype(float)


def solids():
    return (numbered(RADIUS) > 0).astype(float)


IMAGES = {"membranes": shells(), "nuclei": solids(), "both": shells() + 0.5 * solids()}


def overlap(one, other):
    return 2 * (one & other).sum() / (one.sum() + other.sum())


@pytest.mark.parametrize("share", [0.35, 0.5, 0.65])
@pytest.mark.parametrize("kind", IMAGES)
def test_a_label_well_inside_its_cell_becomes_the_cell(kind, share):
    found, names = whole_cells(seen(IMAGES[kind]), numbered(share * RADIUS), SIZE)
    assert names == [1, 2]
    whole = numbered(RADIUS)
    assert min(overlap(found == k, whole == k) for k in (1, 2)) > 0.8  # a voxel: 0.83


def test_noise_of_the_few_voxels_in_the_core_of_a_label_is_no_edge():
    """Of a small label in an even inside, that are bright by chance."""
    middle = MIDDLES[0]
    image = seen(IMAGES["both"])
    noise = image[distances(middle) < 4].std()
    # By 2.3 times the noise of the smoothed image: the error of two such layers is twice that.
    image[distances(middle) < 1.5] += 1.1 * noise
    labels = (distances(middle) < 0.4 * RADIUS).astype(np.int32)
    assert whole_cells(image, labels, SIZE)[1] == [1]


@pytest.mark.parametrize("radius", [RADIUS - 1, RADIUS, RADIUS + 2])
@pytest.mark.parametrize("kind", IMAGES)
def test_labels_of_whole_cells_stay_what_they_are(kind, radius):
    labels = numbered(radius)
    found, names = whole_cells(seen(IMAGES[kind]), labels, SIZE)
    assert names == []
    assert (found == labels).all()


@pytest.mark.parametrize("blur", [1.2, 2.0])
def test_a_label_of_a_nucleus_that_ends_within_its_edge_is_not_the_cell(blur):
    """The cytoplasm is 0.55 times as bright, and its border as steep as that of the nucleus."""
    away = np.linalg.norm(np.moveaxis(np.indices((56,) * 3), 0, -1) - 28, axis=-1)
    light = gaussian_filter(0.45 * (away < 11) + 0.55 * (away < 23), blur)
    image = np.random.default_rng(0).poisson(6 + 42 * light).astype(float)
    labels = (away < 0.92 * 11).astype(np.int32)
    found, names = whole_cells(image, labels, SIZE)
    assert names == []
    assert (found == labels).all()


def test_a_label_that_lacks_one_side_stays():
    """The fit finds the rest (:mod:`.missed_parts`)."""
    labels = numbered(RADIUS)
    labels[:15] = 0
    assert whole_cells(seen(shells()), labels, SIZE)[1] == []


def test_where_nothing_is_seen_around_it_a_label_stays():
    noise = np.random.default_rng(0).poisson(20, SHAPE).astype(float)
    assert whole_cells(noise, numbered(4), SIZE)[1] == []


def test_of_a_cell_and_a_mark_the_mark_alone_becomes_a_cell():
    labels = np.where(numbered(RADIUS) == 1, 1, numbered(4))
    found, names = whole_cells(seen(shells()), labels, SIZE)
    assert names == [2]
    assert ((found == 1) == (labels == 1)).all()


def test_what_the_border_cuts_goes_on_there():
    image, labels = seen(shells())[16:], numbered(5)[16:]
    assert whole_cells(image, labels, SIZE)[1] == [1, 2]


def test_a_wall_with_a_hole_parts_two_marks():
    """Flooded from points, both lie in one region."""
    labels, inside = np.zeros(SHAPE, np.int32), np.zeros(SHAPE, bool)
    inside[4:28, 4:28, 8:52] = True
    depth = distance_transform_edt(inside)
    light = ((depth > 0) & (depth <= 2)).astype(float)
    light[4:28, 4:28, 29:31] = 1.0
    light[14:18, 14:18, 29:31] = 0.0
    labels[12:20, 12:20, 15:23], labels[12:20, 12:20, 37:45] = 1, 2
    found, names = whole_cells(seen(light), labels, SIZE)
    assert names == [1, 2]
    assert (found == 1).sum() == pytest.approx((found == 2).sum(), rel=0.1)
    assert not (found[..., 32:] == 1).any()


@pytest.mark.parametrize(
    ("names", "words"), [((1, 2), "labels 1 and 2 lie"), ((7,), "label 7 lies")]
)
def test_a_user_is_told(names, words):
    labels = numbered(4)
    labels = np.where(labels == 1, names[0], labels * (len(names) > 1))
    with pytest.warns(RepairWarning, match=f"{words} well inside what the image shows"):
        mesh = mesh_from_labels(labels, SIZE, image=seen(shells()))
    wanted = 4 / 3 * np.pi * RADIUS**3
    assert list(mesh.volumes()) == list(names)
    assert list(mesh.volumes().values()) == pytest.approx(len(names) * [wanted], rel=0.15)


@pytest.mark.filterwarnings("ignore:labels 1 and 2 lie:UserWarning")
def test_label_seeds_look_at_the_image_that_may_have_holes():
    image = seen(shells())
    image[:, :2] = np.nan
    mesh = LabelSeeds(numbered(4)).make(image, Grid(SHAPE, (1.0, 1.0, 1.0)))
    assert min(mesh.volumes().values()) > 3500


@pytest.mark.slow
def test_of_a_tissue_one_mark_becomes_one_cell():
    """Flooded from one point, what closes around it may be several cells."""
    rng = np.random.default_rng(3)
    places, shape = rng.uniform(0, 1, (12, 3)) * (32, 40, 40), (32, 40, 40)
    away = np.linalg.norm(np.moveaxis(np.indices(shape), 0, -1)[..., None, :] - places, axis=-1)
    cells = away.argmin(-1) + 1
    grown, shrunk = grey_dilation(cells, (3, 3, 3)), grey_erosion(cells, (3, 3, 3))
    image = seen((grown != shrunk).astype(float))
    for name in range(1, 13):
        depth = distance_transform_edt(np.pad(cells == name, 1))[1:-1, 1:-1, 1:-1]
        labels = np.where(depth > 0.5 * depth.max(), name, 0).astype(np.int32)
        found, names = whole_cells(image, labels, SIZE)
        assert names in ([], [name])
        assert (found == name).sum() < 1.2 * (cells == name).sum()


def shell(radius, middle=MIDDLES[0]):
    return (np.abs(distances(middle) - radius) < 1).astype(float)


@pytest.mark.parametrize(
    "light",
    [
        (distances(MIDDLES[0]) > 6).astype(float),
        0.3 * shell(6) + shell(13),
        0.4 * (distances(MIDDLES[0]) < 6) + shell(13),
        0.15 * shell(6) + shell(13),
    ],
    ids=["dark in bright ground", "dim wall", "nucleus and membrane", "dimmer wall"],
)
def test_a_label_that_ends_where_the_image_does_stays(light):
    labels = (distances(MIDDLES[0]) < 6).astype(np.int32)
    assert whole_cells(seen(light), labels, SIZE)[1] == []


@pytest.mark.parametrize("name", [10**7, 2**31 - 1])
def test_numbers_may_be_large(name):
    labels = np.where(numbered(4) == 1, np.int32(name), 0).astype(np.int32)
    found, names = whole_cells(seen(shells()), labels, SIZE)
    assert names == [name]
    assert set(np.unique(found)) == {0, name}
    assert found.dtype == np.int32


@pytest.mark.parametrize("image", [np.zeros((3, 3, 3)), np.full(SHAPE, np.nan)])
def test_an_image_that_is_none_of_the_labels(image):
    with pytest.raises(InputError, match="finite and of the shape of the labels"):
        mesh_from_labels(numbered(4), SIZE, image=image)
