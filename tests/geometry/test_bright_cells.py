"""Cells that shine from inside are found, and told from those whose membranes shine."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, distance_transform_edt, gaussian_filter, label

from napari_deltamic import InputError
from napari_deltamic.errors import NoCellsFound
from napari_deltamic.geometry.labels import bright_cells
from napari_deltamic.geometry.labels.bright_cells import cells_of
from napari_deltamic.geometry.labels.crowded_cells import crowded_cells, without_halves
from napari_deltamic.geometry.labels.find_cells import WalledCells
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


def test_what_is_dark_inside_of_a_nucleus_is_its_own():
    z, y, x = np.indices((30, 30, 60))
    away = [np.sqrt((z - 15) ** 2 + (y - 15) ** 2 + (x - c) ** 2) for c in (15, 45)]
    light = sum(((r < 10) & (r > 3)).astype(float) for r in away)
    image = np.random.default_rng(0).poisson(3 + 50 * gaussian_filter(light, 1.0))
    found = cells_of(image, (1.0, 1.0, 1.0)).labels
    assert [len(np.unique(found[r < 8.5])) for r in away] == [1, 1]
    assert found[15, 15, 15] > 0


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


def packed(gap, photons=60.0):
    """Labels and image of balls on a lattice, some not quite half as bright as others, fading."""
    rng = np.random.default_rng(2)
    places = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    centres = 8 + (12 + gap) * places + rng.uniform(-0.5, 0.5, places.shape)
    at = np.stack(np.indices((int(16 + 3 * (12 + gap)),) * 3), -1)
    away = np.stack([np.linalg.norm(at - c, axis=-1) for c in centres], -1)
    labels = np.where(away.min(-1) < 6, away.argmin(-1) + 1, 0)
    light = np.append(0.0, rng.uniform(0.6, 1.4, len(centres)))[labels]
    light = light * np.linspace(1, 0.5, len(light))[:, None, None]
    seen = gaussian_filter(light, (2.0, 1.4, 1.4))
    return labels, rng.poisson(2 + photons * seen).astype(np.float32)


def matched(found, labels):
    """Share of the cells that a found one is more than half the same as."""
    shares = []
    for k in range(1, labels.max() + 1):
        other = found == np.bincount(found[labels == k]).argmax()
        shares.append((other & (labels == k)).sum() / (other | (labels == k)).sum())
    return np.mean(np.array(shares) > 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("gap", [-0.5, 1.0])
def test_cells_with_dark_gaps_between_them_are_no_walls(gap):
    labels, image = packed(gap)
    found = cells_of(image, (1.0, 1.0, 1.0))
    assert found.bright
    assert matched(found.labels, labels) > 0.9
    assert found.labels.max() <= 1.1 * labels.max()


@pytest.mark.parametrize("size", [None, 12.0])
def test_crowded_cells_are_told_apart_without_a_threshold(size):
    labels, image = packed(1.0)
    data = ((image - image.min()) / np.ptp(image)).astype(np.float32)
    found = crowded_cells(data, np.ones(3), size)
    assert matched(found, labels) > 0.9
    assert found.max() <= 1.2 * labels.max()


def test_noise_alone_is_no_crowd():
    noise = np.random.default_rng(1).random((32, 32, 32)).astype(np.float32)
    assert not crowded_cells(noise, np.ones(3), None).any()


def net():
    """Junctions of an epithelium: a honeycomb in one slice, open above and below."""
    rng = np.random.default_rng(0)
    y, x = np.indices((120, 120))
    grid = np.stack(np.meshgrid(np.arange(8), np.arange(8), indexing="ij"), -1).reshape(-1, 2)
    centres = 8 + 15 * grid + rng.uniform(-3, 3, grid.shape)
    away = np.sort(np.hypot(*(np.stack([y, x], -1)[..., None, :] - centres).transpose(3, 0, 1, 2)))
    uneven = np.exp(20 * gaussian_filter(rng.normal(size=(120, 120)), 12))
    light = np.zeros((16, 120, 120))
    light[7] = ((away[..., 1] - away[..., 0]) < 3) * uneven
    seen = gaussian_filter(light, (1.5, 1.2, 1.2))
    return rng.poisson(3 + 30 * seen / seen.max()).astype(np.float32)


@pytest.mark.slow
def test_a_net_of_walls_that_encloses_nothing_is_not_cut_into_cells(monkeypatch):
    with pytest.raises(InputError, match="no cells"):
        cells_of(net(), (1.0, 0.2, 0.2))
    whatever = replace(bright_cells.RULES, holes=np.inf, whole=0.0)
    monkeypatch.setattr(bright_cells, "RULES", whatever)
    # But for the dark places that it surrounds, and as its pieces are not solid.
    assert cells_of(net(), (1.0, 0.2, 0.2)).bright


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "draw"), [("packed-hazy", 2), ("tissue-insides", 0)])
def test_nuclei_a_voxel_apart_or_touching_are_all_found(kind, draw):
    """They had come as 28 clumps of 45, and as a single cell."""
    scene = pytest.importorskip("benchmarks.defaults.scenes").made(kind, draw, "")
    found = cells_of(scene.image, scene.voxel_size)
    assert found.bright
    assert matched(found.labels, scene.all_labels) == 1
    assert found.labels.max() == len(scene.centres)


@pytest.mark.slow
def test_noise_beside_nuclei_is_not_found_with_them():
    """One bright nucleus is cut by the border: without it, noise explained the image better."""
    made = pytest.importorskip("benchmarks.defaults.scenes").made
    deskewed = pytest.importorskip("benchmarks.defaults.tissues").deskewed
    scene = deskewed(made("crowd-nuclei", 1, "a94a54327bc19d07c1ee634022f40c903dbadbe6"))
    assert cells_of(scene.image, scene.voxel_size).labels.max() <= 8


def test_a_large_cell_is_not_cut_in_halves():
    """And two that touch stay apart."""
    z, y, x = np.indices((30, 40, 70))

    def ball(c, r):
        return (z - c[0]) ** 2 + (y - c[1]) ** 2 + (x - c[2]) ** 2 < r**2

    whole, one, other = ball((15, 20, 16), 12), ball((15, 20, 42), 7), ball((15, 20, 55), 7)
    parts = np.where(whole, np.where(y < 20, 1, 2), 0)
    parts = np.where(one, 3, np.where(other & ~one, 4, parts))
    joined = without_halves(parts)
    assert len(np.unique(joined[whole])) == 1
    assert sorted(np.unique(joined[one | other])) == [3, 4]


def band(shape):
    """A slanted half of an image, as deskewing a light sheet's stack leaves it."""
    z, y, _ = np.ogrid[: shape[0], : shape[1], :1]
    middle = shape[1] / 2 + 0.5 * (z - shape[0] / 2)
    return np.broadcast_to(np.abs(y - middle) < 0.27 * shape[1], shape)


def cells_in(kind):
    """True labels of cells that shine from inside, or of cells with walls; and an image."""
    if kind == "nuclei":
        return packed(1.0)
    scene = pytest.importorskip("benchmarks.defaults.tissues").tissue(6, "")
    return scene.all_labels, scene.image


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nuclei", "walls"])
def test_no_cell_is_found_where_the_image_is_missing(kind):
    """Half of those found had been smeared edges of the image."""
    labels, image = cells_in(kind)
    known = band(image.shape)
    found = cells_of(np.where(known, image, np.nan), (1.0, 1.0, 1.0))
    assert not found.labels[binary_erosion(~known, iterations=2)].any()  # but for a stepped edge
    there = np.bincount(labels[known]) > 0.5 * np.bincount(labels.ravel())
    there[0] = False
    numbers = np.where(there, np.cumsum(there), 0)
    assert matched(found.labels, numbers[np.where(known, labels, 0)]) > 0.9
    assert found.bright == (kind == "nuclei")


@pytest.mark.slow
def test_a_dead_slice_is_bridged():
    image = image_of("nuclei")
    image[11] = np.nan
    found = cells_of(image, VOXEL)
    assert found.labels.max() == 3
    assert min(overlaps(found.labels)) > 0.8


@pytest.mark.slow
def test_a_cell_with_walls_in_a_bright_haze_comes_before_the_haze():
    scene = pytest.importorskip("benchmarks.defaults.scenes").made("haze", 2, "")
    found = cells_of(scene.image, scene.voxel_size)
    assert not found.bright
    assert matched(found.labels, scene.all_labels) == 1


def discs():
    """Nine flat cells at random tilts, their rims five times as bright as their insides."""
    rng = np.random.default_rng(0)
    places = np.stack(np.indices((84, 130, 130)), -1).astype(float)
    labels = np.zeros(places.shape[:3], int)
    for y, x in np.stack(np.meshgrid([21, 65, 109], [21, 65, 109]), -1).reshape(-1, 2):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        away = np.linalg.norm((places - [42, y, x]) @ axes / [8, 18.5, 18.5], axis=-1)
        labels[away < 1] = labels.max() + 1
    light = np.where(labels > 0, 0.2, 0.0)
    light[(labels > 0) & ~binary_erosion(labels > 0, iterations=2)] = 1
    return labels, rng.poisson(3 + 60 * gaussian_filter(light, 1.3)).astype(np.float32)


@pytest.mark.slow
def test_cells_with_bright_rims_are_found_whole_where_walls_enclose_none(monkeypatch):
    """As of red blood cells, whose dimples leave no dark place that a wall encloses."""

    def refused(*given):
        raise InputError("no cells")

    monkeypatch.setattr(bright_cells, "walled_cells", refused)
    labels, image = discs()
    found = cells_of(image, (1.0, 1.0, 1.0))
    assert found.labels.max() == 9
    assert matched(found.labels, labels) == 1


@pytest.mark.slow
def test_no_cell_has_crumbs_beside_it():
    rng = np.random.default_rng(0)
    image = gaussian_filter(rng.normal(size=(40, 48, 48)), 3.0)  # blobs with necks of any width
    image = rng.poisson(30 * np.clip(image / image.std(), 0.2, None) + 5).astype(np.float32)
    found = cells_of(image, (1.0, 1.0, 1.0)).labels
    assert found.max() > 5
    for name in range(1, found.max() + 1):
        assert label(found == name)[1] == 1


@pytest.mark.slow
def test_one_nucleus_with_a_bright_rim_and_dark_nucleoli_do_not_hide_the_others(monkeypatch):
    """Nucleoli are found where cells with walls are sought; and the rim of one is a wall."""
    at = np.stack(np.indices((24, 90, 120)), -1).astype(float)
    centres = np.array([[12.0, y, x] for y in (16, 45, 74) for x in (16, 45, 74, 103)])
    away = np.stack([np.linalg.norm((at - c) / (8, 11, 11), axis=-1) for c in centres], -1)
    labels = np.where(away.min(-1) < 1, away.argmin(-1) + 1, 0)
    light = np.append(0.0, np.linspace(0.8, 1.2, 12))[labels]
    rimmed = away[..., 5]
    light[rimmed < 1] = np.where(rimmed[rimmed < 1] > 0.8, 2.5, 0.7)
    nucleoli = np.zeros(labels.shape, np.int32)
    for k in (0, 10):
        nucleoli[np.linalg.norm(at - centres[k], axis=-1) < 4] = nucleoli.max() + 1
    light[nucleoli > 0] = 0.2
    rng = np.random.default_rng(3)
    image = rng.poisson(4 + 60 * gaussian_filter(light, (1.6, 1.0, 1.0))).astype(np.float32)
    surely = np.ones(nucleoli.max(), bool)
    monkeypatch.setattr(bright_cells, "walled_cells", lambda *given: WalledCells(nucleoli, surely))
    found = cells_of(image, (1.0, 1.0, 1.0))
    assert found.bright
    assert matched(found.labels, labels) == 1
    assert found.labels.max() == 12


def ball(gap):
    """Labels and image: three cells, parted by gaps, um; or, with 0, one nucleus with chromatin."""
    at = (np.stack(np.indices((25, 50, 50)), -1) + 0.5) * VOXEL - 5
    angles = 0.3 + 2 * np.pi * np.arange(3) / 3
    towards = at[..., 1:] @ np.stack([np.sin(angles), np.cos(angles)])
    near = np.sort(towards, axis=-1)
    apart = (near[..., 2] - near[..., 1]) / np.sqrt(3) >= gap / 2  # the distance from a wall
    inside = np.linalg.norm(at, axis=-1) < 3.5
    rng = np.random.default_rng(3)
    if gap:
        labels = np.where(inside & apart, towards.argmax(-1) + 1, 0)
        light = np.append(0.0, rng.uniform(0.7, 1.3, 3))[labels]
    else:
        labels = inside.astype(int)
        grain = gaussian_filter(rng.normal(size=labels.shape), (1.2, 2.4, 2.4))
        light = labels * np.clip(1 + 0.3 * grain / grain.std(), 0, None)
    return labels, rng.poisson(4 + 60 * gaussian_filter(light, (0.8, 1.0, 1.0)))


@pytest.mark.parametrize("gap", [0.3, 0.0])
def test_a_clump_is_parted_by_dark_walls_and_a_nucleus_with_chromatin_is_one(gap):
    labels, image = ball(gap)
    found = cells_of(image, VOXEL).labels
    assert found.max() == labels.max() == (3 if gap else 1)
    assert matched(found, labels) == 1


def test_cells_of_an_image_are_looked_for_once(monkeypatch):
    """Seeds are found, and then asked how far they reach: in large stacks, 20 s each."""
    looked, really = [], bright_cells._cells_of

    def look(*asked):
        looked.append(asked[2])
        return really(*asked)

    monkeypatch.setattr(bright_cells, "_cells_of", look)
    bright_cells._FOUND.clear()
    image = image_of("nuclei")
    first = cells_of(image, VOXEL)
    first.labels[:] = 0  # who has them may change them
    again = cells_of(2 * image.astype(np.float64), VOXEL)
    assert again.labels.max() > 1
    assert looked == [None]
    cells_of(image, VOXEL, again.size)
    cells_of(image, [2 * side for side in VOXEL])
    assert looked == [None, again.size, None]
    image[4:7, 20:24] = np.nan
    for _ in range(2):
        cells_of(image, VOXEL)
    assert len(looked) == 4
    for _ in range(2):
        with pytest.raises(NoCellsFound, match="no cells"):
            cells_of(np.random.default_rng(0).normal(size=(20, 30, 30)), VOXEL)
    assert len(looked) == 5
