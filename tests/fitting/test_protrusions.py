"""Thin protrusions are light of their cell; what merely lies beside it is not."""

import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid
from napari_deltamic.fitting import counted_voxels
from napari_deltamic.fitting.voxels.protrusions import protrusions
from napari_deltamic.fitting.voxels.voxel_ownership import counted_around
from napari_deltamic.geometry import sphere
from napari_deltamic.scene.render import expected_image

GRID = Grid((40, 40, 56), (0.1, 0.1, 0.1))
PSF = GaussianPSF((0.12, 0.12, 0.12))
MIDDLE, RADIUS = np.array([2.0, 2.0, 2.0]), 1.0
BODY = sphere(MIDDLE, 0.9 * RADIUS, subdivisions=4)


def with_finger(length):
    """A ball with a finger along X, too thin for a dark inside."""
    mesh = sphere(MIDDLE, RADIUS, subdivisions=5)
    ahead = (mesh.vertices_numpy() - MIDDLE) / RADIUS
    angle = np.arccos(np.clip(ahead[:, 2], -1, 1))
    longer = 1 + length * np.exp(-0.5 * (angle / 0.12) ** 2)
    return mesh.with_vertices(MIDDLE + RADIUS * ahead * longer[:, None])


def image_of(mesh, specks=()):
    clean = expected_image(mesh, GRID, PSF, 1e-3, 1.0, 0.0)
    clean = clean / clean.max()
    places = np.moveaxis(np.indices(GRID.shape), 0, -1) * 0.1
    for speck in specks:
        clean = clean + 2 * np.exp(-0.5 * ((places - speck) ** 2).sum(-1) / 0.15**2)
    return np.random.default_rng(0).poisson(5 + 60 * clean).astype(np.float32)


@pytest.mark.parametrize("ground", [counted_voxels, counted_around])
def test_a_finger_is_light_of_its_cell(ground):
    image = image_of(with_finger(1.6))
    tip = np.s_[18:23, 18:23, 40:46]
    assert image[tip].mean() > 2 * np.median(image), "the finger reaches there"
    assert ground(image, GRID, BODY, PSF)[tip].all()


@pytest.mark.parametrize("ground", [counted_voxels, counted_around])
def test_a_speck_that_no_membrane_leads_to_is_not(ground):
    speck = 2.0, 2.0, 3.9
    counted = ground(image_of(with_finger(0.0), [speck]), GRID, BODY, PSF)
    assert not counted[19:22, 19:22, 38:41].any()


@pytest.mark.parametrize("ground", [counted_voxels, counted_around])
def test_a_dead_voxel_in_a_finger_changes_nothing(ground):
    image = image_of(with_finger(1.6))
    image[20, 20, 42] = np.nan
    counted = ground(image, GRID, BODY, PSF)
    assert counted[18:23, 18:23, 40:46].sum() == 5 * 5 * 6 - 1


@pytest.mark.parametrize("ground", [counted_voxels, counted_around])
def test_a_finger_in_a_single_slice(ground):
    """Nothing lies on either side of it."""
    grid = Grid((1, 40, 56), (0.5, 0.1, 0.1))
    y, x = np.indices((40, 56)) * 0.1 - 2.0
    ring = np.exp(-0.5 * ((np.hypot(y, x) - 1) / 0.12) ** 2)
    finger = np.exp(-0.5 * (y / 0.14) ** 2) * ((x > 0.9) & (x < 2.6))
    shown = 5 + 200 * np.clip(ring + finger, 0, 1.2)
    image = np.random.default_rng(0).poisson(shown)[None].astype(np.float32)
    body = BODY.with_vertices(BODY.vertices_numpy() - [2.0, 0, 0])
    assert ground(image, grid, body, GaussianPSF((0.3, 0.12, 0.12)))[0, 19:22, 36:44].all()


@pytest.mark.parametrize("place", [2, 37])
def test_a_crumb_of_noise_beside_a_finger_changes_nothing(monkeypatch, place):
    """Whether it is numbered before the finger or after it."""
    crumb = np.s_[place, 20, 20:23]

    def crumbed(foreign, bright, *others):
        foreign[crumb] = bright[crumb] = True
        return protrusions(foreign, bright, *others)

    monkeypatch.setattr("napari_deltamic.fitting.voxels.voxel_ownership.protrusions", crumbed)
    counted = counted_around(image_of(with_finger(1.6)), GRID, BODY, PSF)
    assert counted[18:23, 18:23, 40:46].all()
    assert not counted[crumb].any()


def test_a_finger_among_specks_may_be_one():
    """Then what is known to be a cell counts alone."""
    specks = [(0.7, 0.7, 3.9), (3.2, 0.7, 4.2), (0.7, 3.2, 4.2)]
    counted = counted_around(image_of(with_finger(1.6), specks), GRID, BODY, PSF)
    assert not counted[18:23, 18:23, 43:46].any()


def test_walls_of_a_neighbour_without_a_seed_are_not():
    """They lead to the cell as a finger does, but enclose something."""
    neighbour = sphere(MIDDLE + np.array([0, 0, 2.05]), RADIUS, subdivisions=5)
    clean = sum(expected_image(m, GRID, PSF, 1e-3, 1.0, 0.0) for m in (with_finger(0.0), neighbour))
    image = np.random.default_rng(0).poisson(5 + 60 * clean / clean.max()).astype(np.float32)
    counted = counted_around(image, GRID, BODY, PSF)
    assert not counted[18:23, 18:23, 45:].any()


def test_a_small_neighbour_that_hardly_shows_its_inside_is_not():
    """Blurred, it is as thin as a finger and joined to the cell, but dimmer in its middle."""
    small = sphere(MIDDLE + np.array([0, 0, 1.4]), 0.34, subdivisions=4)
    clean = sum(expected_image(m, GRID, PSF, 1e-3, 1.0, 0.0) for m in (with_finger(0.0), small))
    image = np.random.default_rng(0).poisson(5 + 200 * clean / clean.max()).astype(np.float32)
    counted = counted_around(image, GRID, BODY, PSF)
    assert not counted[18:23, 18:23, 35:].any()


def test_beside_a_small_neighbour_what_looks_like_a_finger_may_be_another():
    small = sphere(MIDDLE - np.array([0, 1.4, 0]), 0.34, subdivisions=4)
    clean = sum(expected_image(m, GRID, PSF, 1e-3, 1.0, 0.0) for m in (with_finger(1.6), small))
    image = np.random.default_rng(0).poisson(5 + 200 * clean / clean.max()).astype(np.float32)
    counted = counted_around(image, GRID, BODY, PSF)
    assert not counted[18:23, 18:23, 43:46].any()


@pytest.mark.parametrize(("middle", "theirs"), [(0.0, False), (0.9, True)])
def test_a_ring_around_dark_ground_is_another_cell(middle, theirs):
    """Where noise is above all levels at which walls are looked for."""
    places = np.moveaxis(np.indices((24, 24, 40)), 0, -1)
    cell, other = (np.linalg.norm(places - c, axis=-1) for c in ((12, 12, 10), (12, 12, 24)))
    inside, beside, ring = cell < 6, cell < 9, (other < 5.5) & (cell >= 9)
    height = np.where(((cell > 6) & beside) | ring, 1.0, 0.0)
    height[other < 3] = middle
    known, spacing = np.ones(height.shape, bool), np.full(3, 0.5)
    bright = height > 0.5
    starts, beyond = inside.astype(int), (cell - 9) * 0.5
    found = protrusions(ring & bright, bright, starts, beyond, height, known, 0.65, spacing)
    assert found.any() == theirs


@pytest.mark.parametrize("radius", [0.8, 0.9])
def test_a_start_that_is_too_small_has_its_finger_too(radius):
    """It lies on the dark inner flank of its membrane, where nothing is as bright as that."""
    start = sphere(MIDDLE, radius * RADIUS, subdivisions=4)
    assert counted_voxels(image_of(with_finger(1.6)), GRID, start, PSF)[18:23, 18:23, 40:46].all()


def thin_cell():
    """A flat cell, whose blurred inside is nearly as bright as its membrane, with a finger."""
    mesh = with_finger(1.6)
    return mesh.with_vertices(MIDDLE + (mesh.vertices_numpy() - MIDDLE) * [0.55, 0.55, 1.0])


def test_the_finger_of_a_thin_cell_through_a_psf_that_was_told_too_wide():
    start = BODY.with_vertices(MIDDLE + (BODY.vertices_numpy() - MIDDLE) * [0.55, 0.55, 1.0])
    wide = GaussianPSF((0.2, 0.2, 0.2))
    assert counted_around(image_of(thin_cell()), GRID, start, wide)[19:22, 19:22, 41:45].all()
