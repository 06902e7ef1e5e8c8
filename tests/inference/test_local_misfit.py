"""Where a shape is wrong, the image near it is explained worse, in nats; elsewhere it is not."""

from types import SimpleNamespace

import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid, Mesh, render
from napari_deltamic.geometry import sphere
from napari_deltamic.inference.density import DensityField
from napari_deltamic.inference.local_misfit import local_misfit
from napari_deltamic.inference.preconditioner import components
from napari_deltamic.scene.effects import as_effects
from napari_deltamic.settings import FitSettings

OPTICS, GRID = GaussianPSF(0.13), Grid((24, 24, 44), (0.1,) * 3)
PLACES = [np.array([[1.15, 1.15, x]]) for x in (1.8, 3.8)]


def balls(second=0.5):
    one, other = sphere((1.15, 1.15, 1.15), 0.6, 0.12), sphere((1.15, 1.15, 3.2), second, 0.12)
    return Mesh.merge([one, other])


def run_at(mesh, image, counted=None, likelihood="poisson"):
    counted = np.ones(GRID.shape, bool) if counted is None else counted
    settings = FitSettings(accuracy=1e-3, likelihood=likelihood)
    return SimpleNamespace(
        mesh=mesh,
        image=image,
        counted=counted,
        grid=GRID,
        optics=OPTICS,
        settings=settings,
        effects=as_effects(()),
        density=DensityField(mesh, components(mesh), settings.density),
    )


def photographed(mesh, seed, gain=1.0):
    image = render(mesh, GRID, OPTICS, 1e-4).numpy().astype(np.float64).clip(0)
    return gain * np.random.default_rng(seed).poisson(2 + 40 * image / image.max())


@pytest.mark.parametrize("gain", [1.0, 300.0])
def test_only_the_place_that_is_wrong_is_explained_worse(gain):
    image = photographed(balls(), 0, gain)
    right, wrong = (local_misfit(run_at(balls(r), image), PLACES, 0.4) for r in (0.5, 0.6))
    assert wrong[1] - right[1] > 10
    assert wrong[0] - right[0] < 0  # relative to what is left in the whole image


def test_it_is_the_log_likelihood_of_the_noise():
    # Of the truth half a nat for each voxel.
    own = np.indices(GRID.shape).reshape(3, -1).T * 0.1
    for k, place in enumerate(PLACES):
        voxels = (np.linalg.norm(own - place, axis=1) < 0.4).sum()
        found = [
            local_misfit(run_at(balls(), photographed(balls(), s)), PLACES, 0.4)[k]
            for s in range(5)
        ]
        assert np.mean(found) == pytest.approx(voxels / 2, rel=0.15)


@pytest.mark.parametrize("likelihood", ["poisson", "gaussian", "paper"])
def test_voxels_that_do_not_count_are_left_out(likelihood):
    image, counted = photographed(balls(), 0), np.ones(GRID.shape, bool)
    counted[:, :, 30:] = False
    image[:, :, 30:] = np.nan
    near, away = local_misfit(run_at(balls(), image, counted, likelihood), PLACES, 0.4)
    assert near > 0
    assert away == 0
