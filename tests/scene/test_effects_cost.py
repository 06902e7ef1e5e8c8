"""An absent effect changes no bit and runs no code; a present one takes what it says."""

import time
from statistics import median

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

import napari_deltamic as nd
from napari_deltamic.fitting.model import level
from napari_deltamic.fourier import particle_mesh
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer, Scene
from napari_deltamic.scene.effects import (
    KINDS,
    Attenuation,
    Background,
    Bleaching,
    Camera,
    DepthPSF,
    Effects,
    Halo,
    Illumination,
    Missing,
)

OPTICS = nd.GaussianPSF((0.2, 0.15, 0.15))
GRID = nd.Grid((24, 32, 30), (0.12, 0.1, 0.1))
BALL = sphere((1.4, 1.6, 1.5), 0.8, subdivisions=3)
PRESENT = Effects.of(
    Attenuation(per_um=0.1),
    Illumination(coefficients=(0.1, -0.2, 0.1, 0.05, -0.1)),
    Halo(fraction=0.2, width=0.3),
    DepthPSF(variance_z=0.01, variance_yx=0.01),
    Background(coefficients=(1.0, 2.0, 1.0)),
    Camera(),
    Missing(),
    "pixel_integration",
)
KNOWN = {**{e.name: e for e in PRESENT.present()}, "bleaching": Bleaching(per_slice=0.01)}


class Plain(Renderer):
    """The formula of rendering, without any notion of an effect."""

    def transform(self, vertices, density=None, light=None, cells=None):
        assert cells is None
        assert light is None or light.interior == 0
        (of,) = self._planned
        weight = of._membranes if density is None else of._membranes * density
        return self.plan.transform(vertices - of._origin, of._faces, weight)

    def otf(self, optics):
        otf = optics.otf(self._axes)
        for k, blur in zip(self._axes, self.blur, strict=True):
            if blur > 0:
                otf = otf * torch.exp(-0.5 * (blur * k) ** 2)
        return otf

    def image(self, transform, otf, known=None):
        return self.plan.band.to_image(transform, self.grid.shape, otf, known)


class Operations(TorchDispatchMode):
    """Every operation of torch with the number of elements that it makes, in order."""

    def __init__(self):
        super().__init__()
        self.done = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        made = function(*args, **(kwargs or {}))
        first = made[0] if isinstance(made, (tuple, list)) else made
        size = first.numel() if isinstance(first, torch.Tensor) else 0
        self.done.append((str(function), size))
        return made


def rendered(renderer):
    vertices = torch.tensor(BALL.vertices_numpy(), requires_grad=True)
    image = renderer.image(renderer.transform(vertices), renderer.otf(OPTICS))
    image.square().sum().backward()
    return image.detach(), vertices.grad


@pytest.mark.parametrize("method", ["closed form", "particle-mesh"])
def test_absent_effects_change_no_bit_of_an_image(method, one_thread):
    for own, plain in zip(
        *(
            rendered(kind(Scene.of(BALL, OPTICS), GRID, 1e-3, method=method))
            for kind in (Renderer, Plain)
        ),
        strict=True,
    ):
        assert torch.equal(own, plain)


def test_absent_effects_run_no_operation(one_thread):
    done = []
    for kind in (Renderer, Plain):
        renderer = kind(Scene.of(BALL, OPTICS), GRID, 1e-3)
        with Operations() as operations:
            rendered(renderer)
        done.append(operations.done)
    assert done[0] == done[1]


def test_absent_effects_change_no_bit_of_a_fit(monkeypatch, one_thread):
    image = 3 + 20 * nd.render(BALL, GRID, OPTICS, 1e-4).numpy()
    start = BALL.with_vertices(1.5 + 0.8 * (BALL.vertices_numpy() - 1.5))
    ends, done = [], []
    for kind in (Renderer, Plain):
        monkeypatch.setattr(level, "Renderer", kind)
        settings = FitSettings(levels=(1.5, 1.0), structure="membrane", max_iterations=30)
        with Operations() as operations:
            *_, last = nd.fit(image, GRID, start, OPTICS, settings=settings, effects=Effects())
        assert last.iteration == 30
        ends.append((last.mesh.vertices_numpy(), last.optics.parameters().numpy(), last.loss))
        done.append(operations.done)
    for own, plain in zip(*ends, strict=True):
        np.testing.assert_array_equal(own, plain)
    assert done[0] == done[1]


# ------------------------------------------------------------------------------- what they take


def passes(operations, size):
    """Elements that elementwise operations make, in passes over something so large."""
    other = ("view", "slice", "fft", "expand", "_to_copy", "detach", "select")
    return sum(n for name, n in operations.done if not any(o in name for o in other)) / size


class Transforms:
    """Counts how often points are spread."""

    def __enter__(self):
        self.count, self._spread = 0, particle_mesh.spread

        def counted(*given, **named):
            self.count += 1
            return self._spread(*given, **named)

        particle_mesh.spread = counted
        return self

    def __exit__(self, *_):
        particle_mesh.spread = self._spread


def work(effects):
    """Passes over the band for the OTF, over the image, and mesh transforms of one rendering."""
    renderer = Renderer(Scene.of(BALL, OPTICS, effects), GRID, 1e-3, method="particle-mesh")
    vertices = torch.tensor(BALL.vertices_numpy())
    with torch.no_grad():
        with Operations() as of_otf:
            otf = renderer.otf(OPTICS)
        with Transforms() as of_mesh:
            transform = renderer.transform(vertices)
        with Operations() as of_image:
            image = renderer.image(transform, otf)
    multiplied = sum("mul" in name and n == image.numel() for name, n in of_image.done)
    return passes(of_otf, int(np.prod(otf.shape[-3:]))), multiplied, of_mesh.count


@pytest.mark.parametrize("name", list(KNOWN))
def test_present_effects_take_the_operations_that_they_state(name):
    stated = KINDS[name].cost
    plain, own = work(Effects()), work(Effects.of(KNOWN[name]))
    bands, voxels, transforms = (b - a for a, b in zip(plain, own, strict=True))
    assert bands == pytest.approx(stated.bands, rel=0.3, abs=0.15)
    assert voxels == stated.voxels
    assert transforms == stated.transforms


def ratio(effects, method, mesh, grid):
    """Time of an image with its gradient, with the effects relative to without; taken in turns."""
    both = [Renderer(Scene.of(mesh, OPTICS, e), grid, 1e-3, method=method) for e in (effects, ())]
    taken = []
    for _ in range(8):
        pair = []
        for renderer in both:
            began = time.perf_counter()
            vertices = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
            renderer.image(renderer.transform(vertices), renderer.otf(OPTICS)).sum().backward()
            pair.append(time.perf_counter() - began)
        taken.append(pair[0] / pair[1])
    return median(taken[1:])


@pytest.mark.slow
@pytest.mark.parametrize("method", ["closed form", "particle-mesh"])
@pytest.mark.parametrize("name", [n for n in KNOWN if KINDS[n].cost.transforms])
def test_present_effects_take_the_time_that_they_state(name, method, one_thread):
    """Where the transform of the mesh is nearly all there is, as in every real scene."""
    closed = method == "closed form"
    grid = GRID if closed else nd.Grid((64, 64, 64), (0.1, 0.1, 0.1))
    mesh = sphere((1.4, 1.6, 1.5), 0.8 if closed else 1.3, subdivisions=3 if closed else 5)
    stated = 1 + KINDS[name].cost.transforms
    assert ratio(Effects.of(KNOWN[name]), method, mesh, grid) == pytest.approx(stated, rel=0.3)
