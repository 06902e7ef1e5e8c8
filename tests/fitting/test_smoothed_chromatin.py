"""Nuclei with chromatin in a stack that was smoothed: what is left is no noise there."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, gaussian_filter

import napari_deltamic as nd
from napari_deltamic.geometry import mesh_from_labels
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.light import structure_of

GRID = nd.Grid((36, 42, 42), (0.2, 0.2, 0.2))
RADII = np.array([9.0, 10.0, 9.5])  # voxels
OPTICS = nd.GaussianPSF((0.19, 0.21, 0.21))


def stack():
    """The stack, and a label one voxel too small."""
    rng = np.random.default_rng(2)
    at = np.indices(GRID.shape).reshape(3, -1).T - (np.array(GRID.shape) - 1) / 2
    nucleus = (((at / RADII) ** 2).sum(1) < 1).reshape(GRID.shape)
    chromatin = gaussian_filter(rng.normal(size=GRID.shape), 6)
    light = nucleus * (1 + 0.25 * chromatin / chromatin.std()).clip(0)
    seen = rng.poisson(60 * gaussian_filter(light, (2.2, 1.2, 1.2)) + 8).astype(float)
    return gaussian_filter(seen, 1.0).astype(np.float32), binary_erosion(nucleus).astype(np.int32)


@pytest.mark.slow
def test_it_is_no_membrane_around_its_middle():
    image, labels = stack()
    start = mesh_from_labels(labels, GRID.voxel_size)
    settings = FitSettings(structure="auto", levels=(1.0,), fit_psf=True)
    *_, last = nd.fit(image, GRID, start, OPTICS, settings=settings)
    assert structure_of(last.light) == "interior"
    true = 4 / 3 * np.pi * np.prod(RADII) * 0.2**3
    assert last.mesh.volumes()[1] == pytest.approx(true, rel=0.05)
