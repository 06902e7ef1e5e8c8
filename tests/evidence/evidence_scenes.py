"""A cell with noise, as a camera sees it, and a fit of it."""

import numpy as np

from napari_deltamic import GaussianPSF, Grid, fit
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.light import MEMBRANES

VOXEL = (0.3, 0.2, 0.2)
GRID = Grid((20, 28, 28), VOXEL)
SIGMA = (0.42, 0.25, 0.25)
OPTICS = GaussianPSF(SIGMA)
CENTER = (2.85, 2.7, 2.7)
TRUTH = sphere(CENTER, (1.5, 1.6, 1.7), edge_length=0.2)
# Membranes alone: what a fit left out is what is asked for here.
SETTINGS = FitSettings(levels=(1.0,), structure="membrane", max_iterations=80)


def expected(effects=None, peak=40.0, background=4.0, light=MEMBRANES):
    """(Z, Y, X) photons expected."""
    plain = expected_image(TRUTH, GRID, OPTICS, 1e-4, 1.0, 0.0)
    amplitude = peak / float(np.percentile(plain, 99.7))
    given = TRUTH, GRID, OPTICS, 1e-4, amplitude, background
    return expected_image(*given, effects=effects or Effects(), light=light)


def photons(effects=None, seed=0, **options):
    """The same with the noise of counted photons."""
    return np.random.default_rng(seed).poisson(expected(effects, **options)).astype(np.float32)


def fitted(image, effects=(), **settings):
    """The last state of a fit that starts near."""
    start = sphere(CENTER, (1.4, 1.5, 1.6), edge_length=0.45)
    chosen = SETTINGS.model_copy(update=settings)
    *_, last = fit(image, GRID, start, OPTICS, settings=chosen, effects=effects)
    return last
