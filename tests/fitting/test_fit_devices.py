"""A fit on a chosen device, as far as that shows without one."""

from functools import cache

import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fourier.devices import choose_device
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer

GRID, OPTICS = nd.Grid((16, 16, 16), (0.2, 0.2, 0.2)), nd.GaussianPSF(0.3)
TRUTH = sphere((1.6, 1.5, 1.5), 0.8, subdivisions=1)
START = sphere((1.5, 1.5, 1.5), 0.7, subdivisions=1)


@cache
def image():
    return nd.render(TRUTH, GRID, OPTICS, 1e-2)


def states(**settings):
    chosen = FitSettings(accuracy=1e-2, levels=(1.0,), max_iterations=3, **settings)
    return nd.fit(image(), GRID, START, OPTICS, settings=chosen)


def test_a_device_that_cannot_be_used_is_told_before_the_fit_begins(monkeypatch):
    monkeypatch.setattr("napari_deltamic.fourier.devices.missing", lambda: "no GPU here")
    with pytest.raises(InputError, match="cannot be used: no GPU here"):
        states(device="cuda")


def test_where_memory_is_short_the_cpu_takes_over_and_says_so(monkeypatch):
    transform, refused = Renderer.transform, []

    def short(self, *arguments):
        if len(refused) < 1:
            refused.append(self)
            raise torch.OutOfMemoryError("no more")
        return transform(self, *arguments)

    expected = [s.mesh.vertices_numpy() for s in states(device="cpu")]
    monkeypatch.setattr(Renderer, "transform", short)
    found = list(states(device="auto"))
    assert "the fit continues on the CPU" in found[0].message
    assert all((s.mesh.vertices_numpy() == e).all() for s, e in zip(found, expected, strict=True))
    refused.clear()
    with pytest.raises(torch.OutOfMemoryError):
        list(states(device="cpu"))


def test_small_images_stay_on_the_cpu_where_there_is_a_gpu(monkeypatch):
    monkeypatch.setattr("napari_deltamic.fourier.devices.missing", lambda: "")
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    assert choose_device("auto", 64**3) == torch.device("cpu")
    assert choose_device("auto", 200**3) == choose_device("cuda", 64**3) == torch.device("cuda", 0)
