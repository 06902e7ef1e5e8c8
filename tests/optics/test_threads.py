"""The same bits for any number of threads, of the PSF of a microscope and of what is seen by it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene

GRID = nd.Grid((40, 80, 80), (0.3, 0.1, 0.1))


def seen(threads):
    """OTF, image, and gradients by the parameters of the PSF and by the places of vertices."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        psf = nd.ConfocalPSF(nd.GibsonLanniPSF(1.2, 0.6, 1.515, depth=5.0), 0.5)
        scene = Scene.of(sphere((6.0, 4.0, 4.0), 2.5, edge_length=0.3), psf)
        renderer = Renderer(scene, GRID, 1e-3)
        numbers = psf.parameters().requires_grad_()
        vertices = torch.from_numpy(scene.mesh.vertices_numpy()).requires_grad_()
        otf = renderer.otf(psf.with_parameters(numbers))
        image = renderer.image(renderer.transform(vertices), otf)
        weights = torch.from_numpy(np.random.default_rng(0).normal(size=GRID.shape)).to(image)
        by = torch.autograd.grad((image * weights).double().sum(), (numbers, vertices))
        return [one.detach().numpy().tobytes() for one in (otf, image, *by)]
    finally:
        torch.set_num_threads(before)


@pytest.fixture(scope="module")
def on_one():
    return seen(1)


@pytest.mark.parametrize("threads", [2, 3])
def test_the_same_bits_on_any_number_of_threads(threads, on_one):
    assert [a == b for a, b in zip(seen(threads), on_one, strict=True)] == [True] * 4
