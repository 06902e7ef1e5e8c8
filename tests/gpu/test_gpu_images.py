"""Images and fits on a GPU: the same as on the CPU."""

import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer, Scene, Solid, Surface

GRID, OPTICS = nd.Grid((40, 40, 40), (0.1, 0.1, 0.1)), nd.GaussianPSF(0.15)
METHODS = ("closed form", "particle-mesh")


def image_and_gradient(device, method, accuracy, effects=(), of=Surface):
    mesh = sphere((2.0, 1.9, 2.1), 1.1, subdivisions=3)
    scene = Scene((of(mesh),), OPTICS, effects)
    renderer = Renderer(scene, GRID, accuracy, method=method, device=device)
    v = torch.tensor(mesh.vertices, device=device, requires_grad=True)
    image = renderer.image(renderer.transform(v), renderer.otf(OPTICS))
    weight = torch.linspace(-1, 1, image.numel(), device=device, dtype=image.dtype)
    (gradient,) = torch.autograd.grad((image.reshape(-1) * weight).sum(), v)
    return image.detach().cpu(), gradient.cpu()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", [1e-3, 1e-6])
@pytest.mark.parametrize("effects", [(), ("pixel_integration",), ("bleaching",)])
def test_images_and_gradients_are_those_of_the_cpu(gpu, method, accuracy, effects):
    ours = image_and_gradient(gpu, method, accuracy, effects)
    theirs = image_and_gradient(torch.device("cpu"), method, accuracy, effects)
    for a, b in zip(ours, theirs, strict=True):
        assert a.dtype == b.dtype
        assert (a - b).norm() <= accuracy * b.norm()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", [1e-3, 1e-6])
def test_insides_are_those_of_the_cpu(gpu, method, accuracy):
    ours = image_and_gradient(gpu, method, accuracy, of=Solid)
    theirs = image_and_gradient(torch.device("cpu"), method, accuracy, of=Solid)
    for a, b in zip(ours, theirs, strict=True):
        assert (a - b).norm() <= accuracy * b.norm()


def test_render_follows_the_device_of_the_vertices(gpu):
    mesh = sphere((2.0, 1.9, 2.1), 1.1, subdivisions=2)
    image = nd.render(mesh.with_vertices(torch.tensor(mesh.vertices, device=gpu)), GRID, OPTICS)
    assert image.device == gpu
    expected = nd.render(mesh, GRID, OPTICS)
    assert (image.cpu() - expected).norm() <= 1e-3 * expected.norm()


def test_a_fit_ends_where_that_of_the_cpu_does(gpu):
    truth = sphere((2.0, 1.9, 2.1), 1.1, subdivisions=3)
    image = nd.render(truth, GRID, OPTICS)
    start = sphere((2.1, 2.0, 2.0), 0.8, subdivisions=3)
    ends = {}
    for device in ("cpu", "cuda"):
        settings = FitSettings(device=device, accuracy=1e-3)
        for state in nd.fit(image, GRID, start, OPTICS, settings=settings):
            ends[device] = state
    assert ends["cuda"].converged
    assert surface_distance(ends["cuda"].mesh, truth).mean <= 0.005  # 0.05 voxel
    assert surface_distance(ends["cuda"].mesh, ends["cpu"].mesh).mean <= 0.002


def test_a_fit_with_psf_and_effects_runs(gpu):
    truth = sphere((2.0, 1.9, 2.1), 1.1, subdivisions=2)
    image = nd.render(truth, GRID, OPTICS)
    settings = FitSettings(device="cuda", accuracy=1e-2, fit_psf=True, max_iterations=40)
    start = sphere((2.1, 2.0, 2.0), 0.9, subdivisions=2)
    states = nd.fit(
        image, GRID, start, nd.GaussianPSF(0.18), settings=settings, effects=("bleaching",)
    )
    last = list(states)[-1]
    assert last.loss < 0.5


def test_a_fit_that_does_not_fit_into_the_memory_goes_on_on_the_cpu(cuda_itself, monkeypatch):
    truth = sphere((2.0, 1.9, 2.1), 1.1, subdivisions=2)
    image = nd.render(truth, GRID, OPTICS)

    def short(*given):
        raise torch.OutOfMemoryError("no more")

    monkeypatch.setattr("napari_deltamic.fourier.cuda.transform.band_forward", short)
    monkeypatch.setattr("napari_deltamic.fourier.torch_mesh.spread", short)
    settings = FitSettings(device="cuda", accuracy=1e-2, max_iterations=3)
    start = sphere((2.1, 2.0, 2.0), 0.9, subdivisions=2)
    states = list(nd.fit(image, GRID, start, OPTICS, settings=settings))
    assert len(states) == 3
    assert "fit continues on the CPU" in states[0].message
