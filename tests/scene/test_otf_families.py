"""Images keep to the accuracy whatever the OTF: decayed, cut at Nyquist, with a missing cone."""

from functools import cache
from statistics import median

import numpy as np
import pytest
import torch
from benchmarks.shapes import box

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.optics import MeasuredPSF

GRID = nd.Grid((22, 26, 28), (0.2, 0.1, 0.1))
CENTRE = (2.1, 1.25, 1.35)
MESHES = {
    "sphere": sphere(CENTRE, 0.7, subdivisions=2),
    "box": box(CENTRE, (1.6, 1.0, 1.2)),
    "speck": sphere(CENTRE, 0.03, subdivisions=0),
}
ACCURACIES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


def bead():
    """A noisy picture of a bead, as a measured PSF is made of."""
    z, y, x = np.meshgrid(*(np.arange(n) - n // 2 for n in (15, 17, 17)), indexing="ij")
    clean = np.exp(-0.5 * ((z / 2.2) ** 2 + (y / 2.0) ** 2 + (x / 2.1) ** 2))
    return np.maximum(clean + np.random.default_rng(3).normal(0, 2e-3, clean.shape), 0)


@cache
def optics(name):
    if name == "Gaussian":
        return nd.GaussianPSF((0.4, 0.16, 0.16))
    if name == "PSF of 0.6 voxel":
        return nd.GaussianPSF((0.12, 0.06, 0.06))
    if name == "widefield":
        return nd.ScalarPSF(na=1.2, wavelength=0.52, index=1.33)
    return MeasuredPSF(bead(), GRID.voxel_size)


NAMES = ("Gaussian", "PSF of 0.6 voxel", "widefield", "measured")


@cache
def exact(mesh, name):
    return nd.render(MESHES[mesh], GRID, optics(name), 0)


@cache
def error_of(mesh, name, accuracy):
    with torch.no_grad():
        image = nd.render(MESHES[mesh], GRID, optics(name), accuracy, method="particle-mesh")
    return float((image - exact(mesh, name)).norm() / exact(mesh, name).norm())


@pytest.mark.parametrize("accuracy", ACCURACIES)
@pytest.mark.parametrize("name", NAMES)
def test_no_image_is_less_accurate_than_asked(name, accuracy):
    found = {mesh: error_of(mesh, name, accuracy) for mesh in MESHES}
    assert max(found.values()) <= accuracy, found


@pytest.mark.parametrize("accuracy", ACCURACIES[:4])
def test_nor_much_more_so(accuracy):
    """That would cost time for nothing. Finer ones are decided by the gradient."""
    found = [error_of(mesh, "Gaussian", accuracy) for mesh in MESHES]
    assert median(found) > accuracy / 10
