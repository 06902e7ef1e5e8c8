"""A first width of the PSF, from the spectrum."""

from dataclasses import replace

import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid, render
from napari_deltamic.evidence import first_sigma as module
from napari_deltamic.evidence.estimate import Finding
from napari_deltamic.evidence.first_sigma import FirstSigma, first_sigma, plausible_sigma
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.light import Light


@pytest.mark.parametrize("sigma", [(0.42, 0.24, 0.24), (0.6, 0.3, 0.3)])
def test_widths_are_right_to_a_quarter(sigma):
    grid = Grid((36, 56, 56), (0.3, 0.2, 0.2))
    mesh = sphere((5.3, 5.5, 5.4), (3.2, 3.6, 3.0), edge_length=0.3)
    image = render(mesh, grid, GaussianPSF(sigma), 1e-3).numpy()
    image = np.random.default_rng(0).poisson(2 + 40 * image.clip(0) / image.max())
    found = first_sigma(image, grid.voxel_size)
    assert found.z.value == pytest.approx(sigma[0], rel=0.25)
    assert found.yx.value == pytest.approx(sigma[1], rel=0.25)
    assert abs(found.yx.value - sigma[1]) < 3 * found.yx.error


@pytest.mark.parametrize(
    "image",
    [
        np.full((20, 30, 30), 4.0),
        np.random.default_rng(0).normal(size=(24, 32, 32)),
        np.random.default_rng(0).poisson(5, (6, 30, 30)),
        np.random.default_rng(0).poisson(5, (4, 30, 30)),
    ],
    ids=["constant", "noise", "few slices of noise", "thin"],
)
def test_an_image_that_tells_nothing_gives_none(image):
    found = first_sigma(image, (0.3, 0.2, 0.2))
    assert not found.z.known
    assert not found.yx.known
    assert found.z.reason


def test_missing_voxels_are_taken():
    image = np.random.default_rng(0).normal(size=(24, 32, 32))
    image[3, :4] = np.nan
    assert not first_sigma(image, (0.3, 0.2, 0.2)).z.known


@pytest.mark.parametrize("seed", range(4))
def test_a_large_stack_may_miss_whole_parts(monkeypatch, seed):
    monkeypatch.setattr(module, "SPECTRUM", replace(module.SPECTRUM, looked_at=20_000))
    image = np.random.default_rng(seed).poisson(5, (20, 80, 80)).astype(np.float32)
    image[:, :40], image[0, 60, 60] = np.nan, np.inf
    found = first_sigma(image, (0.3, 0.2, 0.2))
    assert not found.z.known
    assert not found.yx.known
    assert found.z.reason.startswith("the spectrum ")


def test_a_part_that_holds_only_the_caps_of_a_large_cell_does_not_decide(monkeypatch):
    grid, true = Grid((60, 90, 90), (1.0, 1.0, 1.0)), (2.0, 1.3, 1.3)
    cell = sphere((29.5, 44.5, 44.5), 25, edge_length=3.0)
    image = render(cell, grid, GaussianPSF(true), 1e-2).numpy().clip(0)
    image = np.random.default_rng(0).poisson(2 + 30 * image / image.max())
    monkeypatch.setattr(module, "SPECTRUM", replace(module.SPECTRUM, looked_at=100_000))
    found = first_sigma(image, grid.voxel_size)
    assert found.yx.value == pytest.approx(1.3, rel=0.2)
    assert found.z.value == pytest.approx(2.0, rel=0.25)


@pytest.mark.parametrize(
    ("widths", "usable"),
    [((6.5, 3.0), True), ((9.0, 3.0), False), ((6.5, 4.5), False)],
)
def test_a_psf_may_be_wide_along_z_alone(widths, usable, monkeypatch):
    """Voxels; in a haze, the spectrum tells great widths in the plane as well."""
    z, yx = (Finding(width * side, 0.01, "") for width, side in zip(widths, (0.3, 0.2)))  # noqa: B905
    monkeypatch.setattr(module, "first_sigma", lambda *_: FirstSigma(z, yx))
    found = plausible_sigma(np.zeros((20, 20, 20)), (0.3, 0.2, 0.2))
    assert found == ((z.value, yx.value, yx.value) if usable else None)


@pytest.mark.parametrize(
    ("widths", "used"),
    [((0.4, 0.8), (0.6, 0.8)), ((1.0, 0.3), (1.0, 0.6)), ((None, 1.0), (1.2, 1.0))],
)
def test_what_voxels_do_not_tell_is_as_wide_as_they_may(widths, used, monkeypatch):
    """Voxels; one axis alone is better than none."""
    sides = 0.3, 0.3
    z, yx = (
        Finding(None if w is None else w * side, 0.01, "")
        for w, side in zip(widths, sides, strict=True)
    )
    monkeypatch.setattr(module, "first_sigma", lambda *_: FirstSigma(z, yx))
    found = plausible_sigma(np.zeros((20, 20, 20)), (0.3, 0.3, 0.3))
    assert found == pytest.approx((0.3 * used[0], 0.3 * used[1], 0.3 * used[1]))


def seen_in(shape, voxel_size, sigma, light, seed=0):
    """Photons of a cell in the middle."""
    grid = Grid(shape, voxel_size)
    middle = (np.asarray(shape) - 1) * np.asarray(voxel_size) / 2
    cell = sphere(middle, (1.6, 2.4, 2.2), subdivisions=4)
    given = grid, GaussianPSF(sigma), 1e-2, 1.0, 0.0
    image = expected_image(cell, *given, light=light).clip(0)
    return np.random.default_rng(seed).poisson(2 + 60 * image / image.max()).astype(np.float32)


@pytest.mark.parametrize(
    "light", [Light(1.0, 0.0), Light(1.0, 1.0), Light(0.0, 1.0)], ids=["membrane", "both", "inside"]
)
@pytest.mark.parametrize("seed", range(3))
def test_what_shines_does_not_matter(light, seed):
    """The light of an inside falls faster: as that of a membrane, it looked 1.5 times as wide."""
    true, size = (0.6, 0.2, 0.2), (0.6, 0.12, 0.12)
    image = seen_in((11, 56, 56), size, true, light, seed)
    assert plausible_sigma(image, size) == pytest.approx(true, rel=0.25)


@pytest.mark.parametrize("slices", [6, 8, 11])
def test_few_slices_tell_it_as_well(slices):
    true, size = (0.6, 0.2, 0.2), (0.6, 0.12, 0.12)
    image = seen_in((slices, 56, 56), size, true, Light(1.0, 0.0))
    assert plausible_sigma(image, size) == pytest.approx(true, rel=0.25)


def test_a_psf_six_voxels_long_is_told():
    grid, true = Grid((60, 60, 60), (0.2, 0.2, 0.2)), (1.2, 0.5, 0.5)
    cell = sphere((5.9, 5.9, 5.9), 2.8, edge_length=0.4)
    image = render(cell, grid, GaussianPSF(true), 1e-2).numpy().clip(0)
    image = np.random.default_rng(0).poisson(2 + 60 * image / image.max())
    assert plausible_sigma(image, grid.voxel_size) == pytest.approx(true, rel=0.25)


def disc(grid, sigma, seed=0):
    """Photons of a flat cell, a third as high as it is wide."""
    middle = (np.asarray(grid.shape) - 1) * np.asarray(grid.voxel_size) / 2
    cell = sphere(middle, (1.0, 3.2, 3.2), subdivisions=4)
    image = render(cell, grid, GaussianPSF(sigma), 1e-2).numpy().clip(0)
    return np.random.default_rng(seed).poisson(2 + 60 * image / image.max()).astype(np.float32)


@pytest.mark.parametrize("true", [(0.3, 0.3, 0.3), (0.45, 0.25, 0.25)])
def test_flat_cells_do_not_look_like_a_short_psf(true):
    """Else, 0.42 in the plane was found for 0.3."""
    grid = Grid((36, 56, 56), (0.15, 0.15, 0.15))
    found = first_sigma(disc(grid, true), grid.voxel_size)
    assert found.z.value == pytest.approx(true[0], rel=0.25)
    assert found.yx.value == pytest.approx(true[2], rel=0.25)


def test_the_edge_of_what_is_missing_is_not_taken_for_a_sharp_structure():
    """Else, 0.17 along Z was found for 0.45. A deskewed stack is missing beyond a slope."""
    grid, true = Grid((36, 56, 56), (0.15, 0.15, 0.15)), (0.45, 0.25, 0.25)
    z, y, _ = np.ogrid[:36, :56, :56]
    missing = (z + y < 30) | (z + y > 60)
    found = first_sigma(np.where(missing, np.nan, disc(grid, true)), grid.voxel_size)
    assert found.z.value == pytest.approx(true[0], rel=0.25)
    assert found.yx.value == pytest.approx(true[2], rel=0.15)


@pytest.mark.parametrize("dead", [[8], [18], [18, 19], [18, 19, 20]])
def test_dead_slices_do_not_look_sharp(dead):
    grid, true = Grid((36, 56, 56), (0.15, 0.15, 0.15)), (0.45, 0.25, 0.25)
    image = disc(grid, true)
    image[dead] = np.nan
    assert plausible_sigma(image, grid.voxel_size) == pytest.approx(true, rel=0.25)


def test_of_noise_no_width_along_z_is_told():
    for seed in range(40):
        image = np.random.default_rng(seed).poisson(5, (20, 40, 40))
        assert not first_sigma(image, (0.3, 0.2, 0.2)).z.known


def test_single_missing_voxels_change_little():
    grid, true = Grid((36, 56, 56), (0.15, 0.15, 0.15)), (0.45, 0.25, 0.25)
    dead = np.random.default_rng(1).random(grid.shape) < 0.02
    found = first_sigma(np.where(dead, np.nan, disc(grid, true)), grid.voxel_size)
    assert found.z.value == pytest.approx(true[0], rel=0.25)
    assert found.yx.value == pytest.approx(true[2], rel=0.25)


@pytest.mark.parametrize(("z", "used"), [(0.15, 0.15), (0.13, 0.2)])
def test_a_psf_is_not_shorter_along_z_than_any_microscope_has(z, used, monkeypatch):
    """Planes along the slices, such as the cover slip's, look sharp along Z."""
    widths = Finding(z, 0.01, ""), Finding(0.2, 0.01, "")
    monkeypatch.setattr(module, "first_sigma", lambda *_: FirstSigma(*widths))
    found = plausible_sigma(np.zeros((20, 20, 20)), (0.1, 0.1, 0.1))
    assert found == (used, 0.2, 0.2)
