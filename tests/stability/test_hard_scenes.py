"""The particle-mesh at its stated accuracy, on scenes that strain it; see :mod:`scene_errors`."""

import numpy as np
import pytest
from scene_errors import ACCURACIES, scene_errors, scenes

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene

METHODS = ("particle-mesh", "closed form")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", ACCURACIES)
@pytest.mark.parametrize("name", scenes())
def test_image_and_gradient_keep_to_the_accuracy(name, accuracy, method):
    image, gradient = scene_errors(name, accuracy, method)
    assert 0 < image < accuracy
    assert 0 < gradient < accuracy


def test_scenes_are_what_they_are_called():
    mesh, _, optics = scenes()["edges of 1000 rad"]
    corners = mesh.vertices_numpy()[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    # At the edge of the band of the finest accuracy.
    assert longest * np.sqrt(2 * np.log(1e6)) / min(optics.sigma_um) > 1000
    mesh = scenes()["slivers of aspect 1e6"][0]
    corners = mesh.vertices_numpy()[mesh.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert (edges.max(1) ** 2 / (2 * mesh.areas())).max() > 1e5
    assert (scenes()["faces of no area"][0].areas() < 1e-15).sum() == 3


@pytest.mark.parametrize("sigma", [1e-3, 1e-6, 1e-12])
@pytest.mark.parametrize("method", METHODS)
def test_a_psf_far_below_a_voxel_costs_no_more_points(sigma, method):
    """The band ends where the grid does; points for what lies beyond once filled the memory."""
    mesh = sphere((1.0, 1.0, 1.0), 0.6, subdivisions=1)
    grid = nd.Grid((20, 21, 22), (0.1, 0.1, 0.1))
    optics = nd.GaussianPSF(sigma)
    renderer = Renderer(Scene.of(mesh, optics), grid, 1e-3, method=method)
    assert renderer.plan.points < 200 * len(mesh.faces)
    image, exact = (nd.render(mesh, grid, optics, a, method=method) for a in (1e-3, 0))
    assert (image - exact).norm() < 1e-3 * exact.norm()
