"""Insides that are uneven: read from voxels deep inside, and carried to the border."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, gaussian_filter

from napari_deltamic import GaussianPSF, Grid, fit
from napari_deltamic.fitting.objective.evening import RULES, Unevenness, deepest, unevenness
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.light import INSIDES
from napari_deltamic.scene.render import expected_image

GRID, OPTICS, CENTRE = Grid((34,) * 3, (1.0,) * 3), GaussianPSF(1.3), (16.4, 16.7, 16.2)
BALL = sphere(CENTRE, 9.0, edge_length=1.2)
WIDTHS, EVERYWHERE = np.full(3, 1.3), np.ones(GRID.shape, bool)
INSIDE = expected_image(BALL, GRID, OPTICS, 1e-4, 1.0, 0.0, light=INSIDES).clip(0).astype(float)


def field(sd=0.3, seed=1, width=3.0):
    """Brightness that differs over nearly two widths (voxels), one on average."""
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=GRID.shape), width)
    return np.exp(sd * noise / noise.std())


def read(true, photons=100.0):
    """What is read of an image, and where it is deep inside."""
    shown = photons * INSIDE
    seen = np.random.default_rng(0).poisson(shown * true + 3.0) - 3.0
    noise = np.sqrt(shown + 3.0) * np.random.default_rng(2).choice([-1.0, 1.0], GRID.shape)
    found = unevenness(seen, shown, INSIDE, noise, WIDTHS, EVERYWHERE)
    return None if found is None else found.gain, RULES.deep < INSIDE


def test_it_is_read_where_a_voxel_sees_nothing_else():
    true = field()
    found, deep = read(true)
    assert np.abs(found / true - 1)[deep].mean() < 0.04
    assert np.abs(true - 1)[deep].mean() > 0.15


def test_it_is_carried_to_the_border():
    true = field()
    found, deep = read(true)
    beyond = distance_transform_edt(~deep)
    border = (beyond > 0) & (beyond <= 2)
    assert np.abs(found / true - 1)[border].mean() < 0.5 * np.abs(true - 1)[border].mean()


def test_noise_alone_says_nothing():
    assert read(np.ones(GRID.shape), photons=5.0)[0] is None
    assert read(np.ones(GRID.shape), photons=100.0)[0] is None


def test_where_nothing_is_deep_nothing_is_read():
    given = INSIDE, INSIDE, 0.15 * INSIDE, 0 * INSIDE, WIDTHS, EVERYWHERE
    assert unevenness(*given) is None


HALF = 0.5 * INSIDE  # as if no voxel saw more than half of a flat cell


def test_of_flat_cells_it_is_read_where_they_are_deepest():
    true = field(width=1.5)
    found = unevenness(INSIDE * true, INSIDE, HALF, 0 * INSIDE, WIDTHS, EVERYWHERE, True)
    assert found is not None
    middle = RULES.deep < INSIDE
    assert np.corrcoef(found.gain[middle], true[middle])[0, 1] > 0.8
    assert unevenness(INSIDE * true, INSIDE, HALF, 0 * INSIDE, WIDTHS, EVERYWHERE) is None
    rim = deepest(HALF, WIDTHS) & (INSIDE < 0.7)
    assert not rim.any(), "beside what is deep, the rim is not"


def test_what_varies_slowly_in_flat_cells_is_their_height():
    slow = np.exp(0.03 * (np.arange(34.0) - 16)) * np.ones(GRID.shape)
    middle = RULES.deep < INSIDE
    given = INSIDE * slow, INSIDE
    thick = unevenness(*given, INSIDE, 0 * INSIDE, WIDTHS, EVERYWHERE)
    flat = unevenness(*given, HALF, 0 * INSIDE, WIDTHS, EVERYWHERE, True)
    assert np.abs(thick.gain / slow - 1)[middle].mean() < 0.02
    assert flat is None


@pytest.mark.parametrize("photons", [5.0, 100.0])
def test_noise_alone_says_nothing_of_flat_cells(photons):
    """Only one slice is read there, so less of the noise is smoothed away."""
    sheet = np.where(np.abs(np.arange(34) - 16)[:, None, None] < 1, HALF, 0.3 * HALF)
    rng, shown = np.random.default_rng(0), photons * INSIDE
    seen = rng.poisson(shown + 3.0) - 3.0
    noise = np.sqrt(shown + 3.0) * rng.choice([-1.0, 1.0], GRID.shape)
    assert unevenness(seen, shown, sheet, noise, WIDTHS, EVERYWHERE, True) is None


def test_where_the_deep_does_not_count_the_rim_is_not_read():
    counted = RULES.deep > INSIDE
    assert unevenness(INSIDE * field(), INSIDE, INSIDE, 0 * INSIDE, WIDTHS, counted) is None


def test_it_is_no_less_and_no_more_than_a_cell_may_be():
    found, _ = read(np.where(np.arange(34)[:, None, None] < 16, 0.02, 2.0) * np.ones(GRID.shape))
    assert found.min() >= RULES.least
    assert found.max() <= RULES.most


def test_voxels_are_trusted_less_where_uneven_insides_shine():
    """A fifth of 10 is 2, of variance 4, beside noise of variance 1 or 2; where none shines, 0."""
    noise = np.array([1.0, -1.0, np.sqrt(2.0)])
    found = Unevenness(np.ones(3), 0.04, np.ones(3, bool))
    weights = found.weights(np.array([3.0, 3.0, 1.5]), np.array([0.0, 10.0, 10.0]), noise)
    assert weights == pytest.approx([3 / 1, 3 / 5, 3 / 6])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_a_nucleus_with_fine_chromatin_keeps_no_membrane(seed):
    """1.0 and 0.39 voxel off when any membrane that explained the border was believed."""
    image = np.random.default_rng(4).poisson(4 + 100 * INSIDE * field(0.3, seed, 1.5)).astype(float)
    start, sharp = sphere(CENTRE, 8.4, edge_length=2.2), GaussianPSF(1.6)
    *_, last = fit(image, GRID, start, sharp, settings=FitSettings(levels=(1.0,)))
    assert last.light.membrane == 0
    assert surface_distance(last.mesh, BALL).mean < 0.35


@pytest.mark.slow
@pytest.mark.parametrize("sd", [0.0, 0.35])
def test_a_grainy_nucleus_is_found(sd):
    """0.32 voxel off where its image is taken as it is."""
    image = np.random.default_rng(4).poisson(4 + 80 * INSIDE * field(sd, seed=5)).astype(float)
    start = sphere(CENTRE, 8.4, edge_length=2.2)
    *_, last = fit(image, GRID, start, OPTICS, settings=FitSettings(levels=(1.0,)))
    assert last.light.membrane == 0
    assert surface_distance(last.mesh, BALL).mean < (0.22 if sd else 0.06)


@pytest.mark.parametrize("seed", [*(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2)), 3])
def test_the_height_of_a_flat_nucleus_does_not_follow_its_chromatin(seed):
    """Read deep inside alone, its volume was 0.59 to 0.66 of it, its surface 1.1 to 1.4 um off."""
    grid, optics = Grid((8, 44, 44), (4.0, 1.0, 1.0)), GaussianPSF((4.5, 1.2, 1.2))

    def flat(radius, height):
        ball = sphere((0, 0, 0), radius, edge_length=1.5)
        squeeze, middle = np.array([height / (2 * radius), 1, 1]), np.array([12.0, 21.4, 21.7])
        return ball.with_vertices(squeeze * ball.vertices_numpy() + middle)

    truth = flat(16.0, 11.0)
    inside = expected_image(truth, grid, optics, 1e-4, 1.0, 0.0, light=INSIDES).clip(0)
    rng = np.random.default_rng(seed)
    noise = gaussian_filter(rng.normal(size=grid.shape), (0.5, 2, 2))
    chromatin = np.exp(0.45 * noise / noise.std())
    image = rng.poisson(5 + 100 * inside / inside.max() * chromatin).astype(float)
    settings = FitSettings(levels=(1.0,), structure="interior", fit_psf=False)
    *_, last = fit(image, grid, flat(15.0, 16.0), optics, settings=settings)
    assert last.mesh.volumes()[1] == pytest.approx(truth.volumes()[1], rel=0.25)
    assert surface_distance(last.mesh, truth, 2000).mean < 1.0
