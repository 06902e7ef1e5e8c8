"""Where a shape is wrong, the image near it is explained worse, in nats; elsewhere it is not."""

import numpy as np
import pytest
import torch

from napari_deltamic import GaussianPSF, Grid, Mesh, render
from napari_deltamic.fitting.model.problem import Problem
from napari_deltamic.fitting.surface.local_misfit import Misfit, gaps, misfit_of
from napari_deltamic.geometry import sphere
from napari_deltamic.scene.effects import as_effects

OPTICS, GRID = GaussianPSF(0.13), Grid((24, 24, 44), (0.1,) * 3)
PLACES = [np.array([[1.15, 1.15, x]]) for x in (1.8, 3.8)]
REACH = 0.4


def balls(second=0.5):
    one, other = sphere((1.15, 1.15, 1.15), 0.6, 0.12), sphere((1.15, 1.15, 3.2), second, 0.12)
    return Mesh.merge([one, other])


def problem(image, counted=None):
    counted = np.ones(GRID.shape, bool) if counted is None else counted
    return Problem(image.astype(np.float32), counted, GRID)


def misfit(given, mesh):
    return misfit_of(given, mesh, np.ones(len(mesh.faces)), OPTICS, as_effects(()), 1e-3)


def compared(given, before, after):
    found = misfit(given, before), misfit(given, after)
    return gaps(given, *found, PLACES, REACH, OPTICS)


def photographed(mesh, seed, gain=1.0):
    image = render(mesh, GRID, OPTICS, 1e-4).numpy().astype(np.float64).clip(0)
    return gain * np.random.default_rng(seed).poisson(2 + 40 * image / image.max())


@pytest.mark.parametrize("gain", [1.0, 300.0])
def test_only_the_place_that_is_wrong_is_explained_worse(gain):
    away, there = compared(problem(photographed(balls(), 0, gain)), balls(0.5), balls(0.6))
    assert there.nats < -100
    assert there.nats < -10 * there.error  # however few blocks the change lies in
    # The amplitude is that of the whole image.
    assert abs(away.nats) < 0.25 * abs(there.nats)


def test_a_gap_is_that_of_the_log_likelihoods():
    """In units of the noise, whatever the camera's gain: half the difference of the squares."""
    found = []
    for gain in (1.0, 300.0):
        _, there = compared(problem(photographed(balls(), 1, gain)), balls(0.5), balls(0.53))
        found.append(there)
    assert found[0].nats == pytest.approx(found[1].nats, rel=1e-3)
    assert found[0].error == pytest.approx(found[1].error, rel=1e-3)
    # Directly, from the image and the two that were rendered.
    shown = [render(balls(r), GRID, OPTICS, 1e-4).double().numpy().clip(0) for r in (0.5, 0.53)]
    expected = [2 + 40 * s / shown[0].max() for s in shown]
    measured = photographed(balls(), 1)
    own = np.indices(GRID.shape).reshape(3, -1).T * 0.1
    near = (np.linalg.norm(own - PLACES[1], axis=1) <= REACH).reshape(GRID.shape)
    logs = [(measured * np.log(e) - e)[near].sum() for e in expected]
    assert found[0].nats == pytest.approx(logs[1] - logs[0], rel=0.35)


def test_the_error_of_a_gap_is_what_noise_makes_of_it():
    before, after = balls(0.5), balls(0.515)
    found = [compared(problem(photographed(before, s)), before, after)[1] for s in range(12)]
    scatter = np.std([g.nats for g in found], ddof=1)
    assert 0.7 * scatter < np.mean([g.error for g in found]) < 2 * scatter


def test_a_shape_is_no_better_than_itself():
    given = problem(photographed(balls(), 0))
    for gap in compared(given, balls(), balls()):
        assert (gap.nats, gap.error) == (0, 0)


def test_where_nothing_lies_there_is_no_gap():
    given = problem(photographed(balls(), 0))
    nothing = Misfit(np.zeros(GRID.shape), 1.0, 1.0, torch.ones(GRID.shape))
    (gap,) = gaps(given, nothing, nothing, [np.full((1, 3), 50.0)], REACH, OPTICS)
    assert (gap.nats, gap.error) == (0, 0)


def test_voxels_that_do_not_count_are_left_out():
    image, counted = photographed(balls(), 0).astype(float), np.ones(GRID.shape, bool)
    counted[:, :, 30:] = False
    image[:, :, 30:] = np.nan
    near, away = compared(problem(image, counted), balls(0.5), balls(0.6))
    assert np.isfinite(near.nats)
    assert near.error > 0
    assert (away.nats, away.error) == (0, 0)
