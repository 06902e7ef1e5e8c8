"""The scenes of the benchmark of defaults are what they say, by their own renderer."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam

imaging = pytest.importorskip("benchmarks.defaults.imaging")
from benchmarks.defaults.scenes import made, rng_of  # noqa: E402
from benchmarks.defaults.scoring import score  # noqa: E402
from benchmarks.defaults.tissues import counted, deskewed, matched  # noqa: E402

FIELD = imaging.Field((24, 22, 20), (0.3, 0.2, 0.2), rim=4)


def test_insides_have_the_volume_of_the_mesh():
    two = foam(np.array([[3.4, 2.0, 1.5], [3.4, 2.0, 2.6]]), np.array([0.9, 0.8]), 0.15)
    for region in (1, 2):
        solid = imaging.inside(two, region, FIELD.fine_shape, FIELD.fine_position)
        volume = solid.sum() * np.prod(FIELD.fine_size)
        assert volume == pytest.approx(two.region_volume(region), rel=0.01)


def test_light_is_the_area_wherever_the_surface_lies_in_the_stack():
    ball = sphere((3.4, 2.1, 1.9), 1.0, edge_length=0.2)
    rng = np.random.default_rng(0)
    for thickness in (0.0, 0.4):
        light = imaging.surface_light(ball, FIELD, rng, thickness=thickness)
        image = imaging.imaged(light, FIELD, (0.3, 0.2, 0.2))
        assert image.sum() * np.prod(FIELD.voxel) == pytest.approx(ball.areas().sum(), rel=0.01)


@cache
def plain():
    return made("plain", 0, "a commit")


def test_the_truth_has_no_error_and_a_lost_cell_is_off_by_its_radius():
    scene = plain()
    same = score(scene, scene.truth)
    assert same.surface < 0.01
    assert abs(same.volume) < 1e-9
    assert not same.lost
    away = scene.truth.translated((0.4, 0, 0))  # 2 voxels
    assert 0.7 < score(scene, away).surface < 2
    assert score(scene, None).surface == pytest.approx(11)
    assert score(scene, None).lost == 1


def test_a_focus_that_aberrations_move_is_no_error_but_more_is():
    scene = plain()
    aberrated = replace(scene, recipe=replace(scene.recipe, aberrated=0.6))
    for away in (0.15, -0.15):
        moved = scene.truth.translated((away, 0, 0))
        assert score(aberrated, moved).surface < 0.02 < score(scene, moved).surface
    far = scene.truth.translated((0.6, 0, 0))
    nearer = scene.truth.translated((0.4, 0, 0))
    assert score(aberrated, far).surface == pytest.approx(score(scene, nearer).surface, rel=0.05)


@pytest.mark.slow
def test_odd_draws_follow_the_commit_and_even_ones_do_not():
    for draw, same in ((0, True), (1, False)):
        one, other = (rng_of("dim", draw, commit).random() for commit in ("a", "b"))
        assert (one == other) is same
    one, other = (made("plain", 1, commit).image for commit in ("a", "b"))
    assert not np.array_equal(one, other)


@pytest.mark.parametrize(("microscope", "kept"), [("widefield", 1.0), ("confocal", 0.5)])
def test_microscopes_are_as_wide_as_asked_and_keep_light_out_of_focus(microscope, kept):
    field = imaging.Field((21, 31, 31), (0.1, 0.1, 0.1), rim=4)
    light = np.zeros(field.fine_shape)
    light[tuple(n // 2 for n in light.shape)] = 1
    image = imaging.seen_by(microscope, light, field, 0.12)
    z, y, x = np.unravel_index(image.argmax(), image.shape)
    row = image[z, y]
    top = row > 0.3 * row.max()
    bend, _ = np.polyfit(0.1**2 * (np.flatnonzero(top) - x) ** 2, np.log(row[top]), 1)
    whole = imaging.effective_sigma(field, (0.12, 0.12, 0.12))[0]  # voxels included
    assert (-0.5 / bend) ** 0.5 == pytest.approx(whole, rel=0.05)
    sums = image.sum((1, 2))
    assert sums[z + 6] / sums[z] < kept + 0.05
    if microscope == "widefield":
        assert sums[z + 6] / sums[z] > 0.95


def test_what_is_found_of_cells_that_do_not_count_counts_neither_way():
    """Of three cells in a row, the first is mostly cut off, and the last is found in two halves."""
    true = np.repeat(np.array([[[-1, 0, 1, 1, 2, 2]]], np.int32), 4, axis=1)
    found = np.repeat(np.array([[[3, 0, 1, 1, 2, 4]]], np.int32), 4, axis=1)
    assert counted(found, true) == 3
    assert matched(found, true) == 0.5  # a half is not more than a half
    assert matched(np.where(found == 4, 2, found), true) == 1


@pytest.mark.slow
def test_a_deskewed_stack_keeps_the_labels_of_cells_that_are_mostly_there():
    scene = made("neighbours-nuclei", 0, "")
    cut = deskewed(scene)
    known = np.isfinite(cut.image)
    assert 0.3 < known.mean() < 0.7
    assert not cut.all_labels[~known].any()
    for name in range(1, scene.all_labels.max() + 1):
        own = scene.all_labels == name
        left = set(np.unique(cut.all_labels[own & known]).tolist())
        assert left <= ({name} if known[own].mean() > 0.5 else {-1})
    assert (cut.all_labels == -1).any()


def test_an_aberrated_focus_is_where_the_stage_says():
    sharp, aberrated = (imaging.point_spread("confocal", FIELD, 0.24, a) for a in (0.0, 0.6))
    middle = sharp.shape[0] // 2
    for point in (sharp, aberrated):
        assert point.sum() == pytest.approx(1)
        assert int(point.max((1, 2)).argmax()) == middle
    np.testing.assert_allclose(sharp, sharp[::-1], atol=1e-6 * sharp.max())
    assert aberrated.max() < 0.9 * sharp.max()
    assert np.abs(aberrated - aberrated[::-1]).max() > 0.1 * aberrated.max()


@pytest.mark.parametrize("leaning", [0.0, 30.0, -40.0])
def test_the_axis_of_a_leaning_sheet_leans_as_told(leaning):
    point = imaging.point_spread("sheet", FIELD, 0.24, leaning=leaning)
    assert point.sum() == pytest.approx(1)
    axes = [(np.arange(n) - n // 2) * d for n, d in zip(point.shape, FIELD.fine_size, strict=True)]
    bright = np.where(point > 0.1 * point.max(), point, 0)
    z, _, x = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
    spread = np.cov(np.stack([z, x]), aweights=bright.ravel())
    long = np.linalg.eigh(spread)[1][:, -1]
    assert np.rad2deg(np.arctan(long[1] / long[0])) == pytest.approx(leaning, abs=2)
