"""Fits whose images torch computes alone: as on a GPU, or without the compiled extension."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting.model import level, likelihood
from napari_deltamic.fourier import particle_mesh, real_fft
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer

GRID, OPTICS = nd.Grid((24, 25, 26), (0.2, 0.2, 0.2)), nd.GaussianPSF(0.3)


@pytest.mark.parametrize("accuracy", [1e-2, pytest.param(1e-5, marks=pytest.mark.slow)])
def test_a_fit_ends_where_that_of_the_compiled_loops_does(monkeypatch, accuracy):
    image = nd.render(sphere((2.4, 2.3, 2.5), 1.2, subdivisions=2), GRID, OPTICS)
    start = sphere((2.2, 2.4, 2.5), 0.9, subdivisions=2)

    def by_particle_mesh(*given, **named):
        return Renderer(*given, **named, method="particle-mesh")

    monkeypatch.setattr(level, "Renderer", by_particle_mesh)
    # What explains the image is the same for both here; its loops have a test of their own.
    monkeypatch.setattr(likelihood, "compiled", lambda device: False)
    ends = []
    for compiled in (True, False):
        for module in (particle_mesh, real_fft):
            monkeypatch.setattr(module, "compiled", lambda device, given=compiled: given)
        # The shape alone: steps with PSF and brightness free carry rounding to 1e-4 um.
        alone = {"structure": "membrane", "density": "uniform", "fit_psf": False}
        settings = FitSettings(accuracy=accuracy, levels=(1.5, 1.0), max_iterations=40, **alone)
        *_, last = nd.fit(image, GRID, start, OPTICS, settings=settings)
        ends.append(last)
    ours, by_torch = (np.asarray(e.mesh.vertices_numpy()) for e in ends)
    assert ours.shape == by_torch.shape
    # Rounding that a fit carries along, against the size of the cell.
    assert np.abs(ours - by_torch).max() < (1e-3 if accuracy > 3e-5 else 1e-7) * 2.4
    assert ends[0].loss == pytest.approx(ends[1].loss, rel=1e-3)
