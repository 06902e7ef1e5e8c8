"""Everything that forms an image stays on the device that it was asked to be on.

Torch's device ``meta`` computes shapes alone, and refuses to mix with tensors that lie elsewhere.
"""

import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.fourier import Band
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene

MESH = sphere((1.0, 1.0, 1.0), 0.6, subdivisions=1)
GRID = nd.Grid((12, 13, 14), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF(0.3)


@pytest.mark.parametrize("effects", [(), ("pixel_integration",), ("bleaching",)])
@pytest.mark.parametrize("vertices_on", ["cpu", "meta"])
def test_images_are_formed_on_the_device(vertices_on, effects):
    renderer = Renderer(
        Scene.of(MESH, OPTICS, effects), GRID, 1e-3, method="particle-mesh", device="meta"
    )
    v = torch.zeros(MESH.vertices.shape, dtype=torch.float64, device=vertices_on)
    transform = renderer.transform(v, torch.ones(len(MESH.faces)))
    image = renderer.image(transform, renderer.otf(OPTICS))
    assert transform.device == image.device == torch.device("meta")
    assert image.shape == GRID.shape
    assert image.dtype == torch.float32


def test_gradients_come_back_to_where_the_vertices_are():
    renderer = Renderer(Scene.of(MESH, OPTICS), GRID, 1e-3, method="particle-mesh", device="meta")
    v = torch.zeros(MESH.vertices.shape, dtype=torch.float64, device="meta", requires_grad=True)
    image = renderer.image(renderer.transform(v), renderer.otf(OPTICS))
    (gradient,) = torch.autograd.grad(image.sum(), v)
    assert gradient.device == v.device
    assert gradient.shape == v.shape


def test_the_otf_of_the_same_optics_is_made_once():
    renderer = Renderer(Scene.of(MESH, OPTICS), GRID, 1e-3, method="particle-mesh", device="meta")
    first = renderer.otf(OPTICS)
    assert renderer.otf(OPTICS) is first
    assert renderer.otf(nd.GaussianPSF(0.2)) is not first
    sigma = torch.full((3,), 0.3, requires_grad=True)
    assert renderer.otf(nd.GaussianPSF(sigma)).requires_grad


@pytest.mark.parametrize("shape", [(8, 9, 10), (7, 8, 9)])
def test_boxes_of_a_band_stay_on_the_device(shape):
    band = Band.within(shape, (0.2, 0.2, 0.2), (12.0, 12.0, 12.0))
    rows = torch.zeros(band.count, dtype=torch.complex64, device="meta")
    image = band.to_image(band.to_box(rows), shape)
    assert image.device == torch.device("meta")
    assert image.shape == shape
