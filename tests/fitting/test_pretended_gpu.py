"""Fits and images on a GPU that is not there: nothing is made of tensors of two devices."""

import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer, Scene, Solid
from napari_deltamic.scene.light import Light
from napari_deltamic.scene.render import expected_image
from pretended_gpu import pretended_gpu

GRID, OPTICS = nd.Grid((24, 26, 26), (0.2, 0.2, 0.2)), nd.GaussianPSF(0.25)
TRUTH = sphere((2.3, 2.5, 2.6), 1.4, subdivisions=2)
START = sphere((2.4, 2.5, 2.5), 1.2, subdivisions=2)
COARSE = sphere((2.4, 2.5, 2.5), 1.2, subdivisions=0)  # exact sums are slow
BOTH = Light(1.0, 0.8)


def test_what_a_gpu_refuses_is_refused(monkeypatch):
    with pretended_gpu(monkeypatch) as gpu:
        x = torch.ones(3, device=gpu, requires_grad=True)
        assert (x + 1).device == torch.zeros_like(x).device == gpu
        assert x.cpu().device.type == "cpu"
        for refused in (lambda: x + torch.ones(3), lambda: x.detach().numpy()):
            with pytest.raises((RuntimeError, TypeError), match=r"two devices|cannot see"):
                refused()
        y = torch.ones(3, requires_grad=True)
        (y.to(gpu) * x).sum().backward()
        assert (y.grad.device.type, x.grad.device) == ("cpu", gpu)


@pytest.mark.parametrize("method", ["closed form", "particle-mesh"])
def test_insides_are_those_of_the_cpu(method, monkeypatch):
    found = []
    with pretended_gpu(monkeypatch) as gpu:
        for device in ("cpu", gpu):
            renderer = Renderer(
                Scene((Solid(TRUTH),), OPTICS), GRID, 1e-3, method=method, device=device
            )
            v = torch.tensor(TRUTH.vertices_numpy(), device=device, requires_grad=True)
            image = renderer.image(renderer.transform(v), renderer.otf(OPTICS))
            (gradient,) = torch.autograd.grad(image.square().sum(), v)
            found.append([image.detach().cpu(), gradient.cpu()])
    for ours, theirs in zip(*found, strict=True):
        assert (ours - theirs).norm() <= 1e-3 * theirs.norm()


@pytest.mark.parametrize(
    ("accuracy", "start"), [(1e-3, START), pytest.param(0.0, COARSE, marks=pytest.mark.slow)]
)
def test_a_fit_goes_where_that_of_the_cpu_goes(accuracy, start, monkeypatch):
    image = 2 + expected_image(TRUTH, GRID, OPTICS, 1e-4, 1.0, 0.0, light=BOTH)
    given = FitSettings(accuracy=accuracy, levels=(1.0,), max_iterations=3)
    meshes = []
    for device in ("cpu", "cuda"):
        settings = given.model_copy(update={"device": device})
        with monkeypatch.context() as patched, pretended_gpu(patched):
            *_, last = nd.fit(image, GRID, start, OPTICS, settings=settings)
        meshes.append(last.mesh)
    assert surface_distance(*meshes).mean < 0.01 * GRID.voxel_size[0]


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["bleaching", "depth_psf"])
def test_effects_and_the_psf_are_found_there(effect, monkeypatch):
    image = 2 + nd.render(TRUTH, GRID, OPTICS).numpy()
    given = FitSettings(accuracy=1e-2, levels=(1.0,), max_iterations=6)
    found = []
    for device in ("cpu", "cuda"):
        settings = given.model_copy(update={"device": device})
        with monkeypatch.context() as patched, pretended_gpu(patched):
            states = nd.fit(
                image, GRID, START, nd.GaussianPSF(0.28), settings=settings, effects=(effect,)
            )
            *_, last = states
        found.append(last)
    here, there = found
    assert surface_distance(here.mesh, there.mesh).mean < 0.02 * GRID.voxel_size[0]
    assert there.optics.sigma_um == pytest.approx(here.optics.sigma_um, rel=0.02)
    assert there.loss == pytest.approx(here.loss, rel=0.05)
