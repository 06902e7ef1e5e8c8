"""Forecasts of a fit: what they promise before it runs, and how they correct themselves."""

import time
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median

import numpy as np
import pytest

from napari_deltamic import fit
from napari_deltamic.accuracy.forecast import forecast
from napari_deltamic.accuracy.iteration_costs import FORECAST
from napari_deltamic.accuracy.machine_costs import costs
from napari_deltamic.fitting.history import History
from napari_deltamic.fourier.cost import BUILT_IN, Rates
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.runs.settings import NEAR_LEVELS, WIDE_LEVELS, FitSettings
from napari_deltamic.scene import Grid, samples
from synthetic import GRID, OPTICS, VOXEL, measured, start

WIDE = FitSettings(accuracy=1e-2)
NEAR = FitSettings(accuracy=1e-2, levels=NEAR_LEVELS)


def expected(settings=WIDE, mesh=None, grid=GRID, costs=BUILT_IN, **options):
    image = np.zeros(grid.shape, np.float32)
    return forecast(image, grid, mesh or start(), OPTICS, settings, costs=costs, **options)


def test_fewer_iterations_are_expected_where_no_other_neighbours_are_tried():
    two = Mesh.merge([start(), start()])
    tried, not_tried = (
        expected(NEAR.model_copy(update={"trials": trials}), two, touching=True)
        for trials in (True, False)
    )
    assert not_tried.seconds < tried.seconds
    assert not_tried.kind != tried.kind, "one teaches nothing about the other"


@dataclass(frozen=True)
class At:
    """Where a fit is."""

    level: int
    converged: bool = False


def course(*counts):
    """The history of a fit that had so many iterations at each level."""
    levels = [n for n, count in enumerate(counts, 1) for _ in range(count)]
    return History(loss=[0.0] * len(levels), level=levels, blur=[1.0] * len(levels))


# ---------------------------------------------------------------------------------- before a fit


def test_levels_are_those_of_the_fit():
    found = expected(FitSettings(accuracy=3e-4, levels=(2.0, 1.0)))
    assert [level.blur for level in found.levels] == [2.0, 1.0]
    states = fit(measured(), GRID, start(2), OPTICS, 3e-4, settings=FitSettings(levels=(2.0, 1.0)))
    seen = {state.blur for state, _ in zip(states, range(3), strict=False)}
    assert seen == {2.0}
    assert found.levels[0].shape == (12, 16, 16)
    assert found.levels[1].shape == GRID.shape
    assert [level.accuracy for level in found.levels] == [1e-2, 3e-4]
    assert found.seconds == pytest.approx(sum(level.seconds for level in found.levels))
    assert found.iterations == sum(level.iterations for level in found.levels)
    assert found.seconds_per_iteration == found.levels[-1].seconds_per_iteration


def test_finer_or_larger_or_freer_costs_more():
    seconds = [
        expected(WIDE.model_copy(update={"accuracy": a})).seconds for a in (1e-1, 1e-2, 1e-3, 1e-5)
    ]
    assert all(b > a for a, b in pairwise(seconds))
    each = expected().seconds_per_iteration
    larger = Grid((48, 64, 64), (VOXEL / 2,) * 3)
    assert expected(grid=larger).seconds_per_iteration > 1.1 * each
    assert expected(mesh=start(5)).seconds_per_iteration > 2 * each
    for less in ({"fit_psf": False}, {"fit_psf": False, "density": "uniform"}):
        assert expected(WIDE.model_copy(update=less)).seconds_per_iteration < each
    assert expected(NEAR).seconds < 0.7 * expected().seconds
    assert expected(effects=("depth_psf",)).seconds_per_iteration > 1.2 * each
    assert expected(effects=("attenuation",)).seconds_per_iteration == each


def test_accuracy_zero_is_dear():
    """The closed form at every wavevector: what the dial is there to show."""
    exact = expected(WIDE.model_copy(update={"accuracy": 0.0}))
    assert all(level.method == "closed form" for level in exact.levels)
    assert exact.seconds > 30 * expected().seconds


def test_seconds_follow_the_costs():
    dear = {
        f"{p}_{w}": Rates(*(10 * r for r in vars(getattr(BUILT_IN, f"{p}_{w}")).values()))
        for p in ("single", "double")
        for w in ("forward", "gradient")
    }
    dear |= {name: 10 * getattr(BUILT_IN, name) for name in ("vertex", "voxel", "face", "tap")}
    assert expected(costs=replace(BUILT_IN, **dear)).seconds == pytest.approx(
        10 * expected().seconds
    )
    assert not expected().measured
    assert expected(costs=replace(BUILT_IN, measured=True)).measured


def test_the_end_comes_at_the_limit():
    short = expected(WIDE.model_copy(update={"max_iterations": 40}))
    assert short.iterations == 40
    assert len(short.levels) == 2
    assert [level.number for level in short.levels] == [1, 2]


def test_levels_without_voxels_are_left_out():
    """As in a fit: where the blur is wider than what counts, there is nothing to go by."""
    few = np.zeros(GRID.shape, bool)
    few[10:14, 14:18, 14:18] = True
    found = expected(counted=few)
    assert found.levels[-1].number == len(WIDE_LEVELS)
    assert len(found.levels) < len(WIDE_LEVELS)


def test_accuracy_is_left_to_the_noise():
    image = measured(noise=0)
    auto = FitSettings(levels=(1.0,)).model_copy(update={"accuracy": None})
    found = forecast(image, GRID, start(), OPTICS, auto, costs=BUILT_IN)
    assert found.levels[-1].accuracy == 2e-2
    clean = forecast(measured(), GRID, start(), OPTICS, auto, costs=BUILT_IN)
    assert clean.levels[-1].accuracy == 1e-3
    assert clean.seconds > found.seconds


def test_fast_enough_for_a_dial():
    """Generous: shared machines; 15 ms alone."""
    grid = Grid((100, 100, 100), (0.1, 0.1, 0.1))
    mesh = sphere((5, 5, 5), 3.0, subdivisions=4)
    image = np.random.default_rng(0).normal(size=grid.shape).astype(np.float32)
    auto = FitSettings().model_copy(update={"accuracy": None})
    taken = []
    for _ in range(5):
        began = time.process_time()
        forecast(image, grid, mesh, OPTICS, auto, costs=BUILT_IN)
        taken.append(time.process_time() - began)
    assert median(taken) < 0.2


# -------------------------------------------------------------------------------- while it runs


def test_nothing_is_known_at_first_and_nothing_remains_at_last():
    found = expected()
    assert found.remaining_seconds(course(), At(1), 0.1) is None
    assert found.remaining_seconds(course(1), At(1), 0.1) is None
    assert found.remaining_seconds(course(5), At(1), 0.1) is not None
    assert found.remaining_seconds(course(90, 40), At(2, converged=True), 3.0) == 0


def test_what_remains_falls_as_the_fit_goes_on():
    found = expected()
    per_level = [level.iterations for level in found.levels]
    remaining, spent, elapsed = [], [], 0.0
    for number, count in enumerate(per_level, 1):
        elapsed += found.levels[number - 1].preparation
        for i in range(1, count + 1):
            elapsed += found.levels[number - 1].seconds_per_iteration
            history = course(*per_level[: number - 1], i)
            remaining.append(found.remaining_seconds(history, At(number), elapsed))
            spent.append(elapsed)
    known = [r for r in remaining if r is not None]
    assert all(b <= a * 1.001 for a, b in pairwise(known))
    begun = spent[remaining.index(known[0])]
    assert known[0] == pytest.approx(found.seconds - begun, rel=0.05)
    last = found.levels[-1].seconds_per_iteration
    assert known[-1] == pytest.approx(FORECAST.window * last, rel=0.01)


def test_the_pace_so_far_corrects_it():
    found = expected()
    level = found.levels[0]
    history, usual = course(60), level.preparation + 60 * level.seconds_per_iteration
    as_expected = found.remaining_seconds(history, At(1), usual)
    assert as_expected == pytest.approx(found.remaining_seconds(history, At(1)))
    assert found.remaining_seconds(history, At(1), 3 * usual) == pytest.approx(
        3 * as_expected, rel=0.15
    )
    # Of the first iterations it is not yet believed.
    early = found.remaining_seconds(course(2), At(1), 30 * level.seconds_per_iteration)
    assert early < 4 * found.seconds


def test_levels_that_took_longer_make_the_next_longer():
    found = expected()
    counts = [level.iterations for level in found.levels]
    usual = found.remaining_seconds(course(counts[0], counts[1], 1), At(3))
    slow = found.remaining_seconds(course(3 * counts[0], 3 * counts[1], 1), At(3))
    assert 1.5 * usual < slow < 3 * usual
    fast = found.remaining_seconds(course(counts[0] // 3, counts[1] // 3, 1), At(3))
    assert fast < 0.7 * usual


def test_the_next_forecast_is_what_the_last_fit_took():
    found = expected()
    counts = [3 * level.iterations for level in found.levels]
    history, end = course(*counts), At(len(counts), converged=True)
    took = 10 * found.seconds
    assert found.experience(history, end, took).single
    learned = found.after(found.experience(history, end, took))
    assert learned.seconds == pytest.approx(took, rel=0.01)
    assert learned.iterations == sum(counts)
    # One that went as that said teaches nothing new.
    same, known = learned.experience(history, end, took), learned.learned
    expected_again = (known.seconds, known.iterations)
    assert (same.seconds, same.iterations) == pytest.approx(expected_again, rel=0.01)


def test_what_a_fit_that_was_stopped_teaches():
    found = expected()
    level = found.levels[0]
    assert found.experience(course(3), At(1), 1.0) is None
    twice = 2 * (level.preparation + 10 * level.seconds_per_iteration)
    few = found.experience(course(10), At(1), twice)
    assert (few.seconds, few.iterations) == pytest.approx((2, 1))
    assert not few.single
    many = found.experience(course(2 * level.iterations), At(1), 1.0)
    assert many.iterations == pytest.approx(2)


def test_a_level_that_ends_late_still_needs_a_little():
    found = expected()
    last = len(found.levels)
    counts = [level.iterations for level in found.levels]
    late = course(*counts[:-1], 2 * counts[-1])
    left = found.remaining_seconds(late, At(last))
    assert left >= 12 * found.seconds_per_iteration
    later = course(*counts[:-1], 3 * counts[-1])
    assert found.remaining_seconds(later, At(last)) is None, "nobody knows when it will end"


def test_a_level_that_ends_early_leaves_less():
    found = expected()
    before = found.remaining_seconds(course(40), At(1))
    after = found.remaining_seconds(course(40, 1), At(2))
    assert after < before


# -------------------------------------------------------------------------------------- in truth


def timed_fit(image, grid, mesh, optics, settings):
    """Seconds per iteration at each level, in all, and the forecast of it.

    Of a level, the median: the first iteration makes what the others find made, and after the last
    other PSFs are tried, which counts in all. Time is that of the process, so that other programs
    on the machine change it less.
    """
    promise = forecast(image, grid, mesh, optics, settings, costs=costs(measure=True))
    per_level: dict[int, list[float]] = {}
    began = last = time.process_time()
    for state in fit(image, grid, mesh, optics, settings=settings):
        now = time.process_time()
        per_level.setdefault(state.level, []).append(now - last)
        last = now
    return {k: float(np.median(v[1:])) for k, v in per_level.items()}, last - began, promise


@pytest.fixture
def clock(monkeypatch, tmp_path):
    """Costs measured with the clock of the process."""
    from napari_deltamic.accuracy import calibration, machine_costs

    monkeypatch.setenv("DELTAMIC_CACHE", str(tmp_path))
    monkeypatch.setattr(machine_costs, "_known", {})
    monkeypatch.setattr(calibration.time, "perf_counter", time.process_time)


def ratios(found, seconds, promise):
    """Promised over spent: of the iterations that were done, and to the end."""
    each = [level for level in promise.levels if level.number in found]
    spent = sum(found[level.number] * level.iterations for level in each)
    promised = sum(level.seconds_per_iteration * level.iterations for level in each)
    return promised / spent, promise.seconds / seconds


@pytest.mark.slow
def test_a_small_fit_takes_about_what_was_forecast(clock):
    """Generous, and in the median of three: threads that wait for a busy core count as work."""
    settings = FitSettings(accuracy=1e-2, levels=NEAR_LEVELS)
    given = measured(noise=1), GRID, start(), OPTICS, settings
    each, whole = np.median([ratios(*timed_fit(*given)) for _ in range(3)], axis=0)
    assert 1 / 4 < each < 4
    assert 1 / 8 < whole < 8


@pytest.mark.slow
@pytest.mark.parametrize("accuracy", [1e-2, 1e-3])
@pytest.mark.parametrize("sample", ["vesicle_sample", "two_cell_sample", "dividing_cell_sample"])
def test_milliseconds_per_iteration_within_half_as_much_again(clock, sample, accuracy):
    """On a machine of one's own: seconds per iteration to 1.5, seconds to the end to 2."""
    scene = getattr(samples, sample)()
    mesh = Mesh.merge([sphere(c, 2.0, edge_length=0.35) for c in scene.centers])
    settings = FitSettings(accuracy=accuracy)
    found, seconds, promise = timed_fit(scene.image, scene.grid, mesh, scene.optics, settings)
    for level in promise.levels[-1:]:
        assert 1 / 1.5 < level.seconds_per_iteration / found[level.number] < 1.5
    assert 1 / 2 < promise.seconds / seconds < 2
