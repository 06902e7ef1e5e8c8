"""What effects are said to cost."""

import time
from statistics import median

import pytest
import torch
from evidence_scenes import GRID, OPTICS, TRUTH

from napari_deltamic import Grid
from napari_deltamic.evidence.effect_cost import EffectCosts
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene
from napari_deltamic.scene.effects import Attenuation, DepthPSF, Effects, Halo


def test_each_further_transform_costs_about_as_much_as_the_first(monkeypatch):
    monkeypatch.setattr(EffectCosts, "_timed", lambda *_: 0.1)  # seconds of a rendering
    costs = EffectCosts(TRUTH, GRID, OPTICS, Effects(), 1e-3)
    assert costs.milliseconds(DepthPSF()) == pytest.approx(100, rel=0.3)
    assert costs.milliseconds(Halo()) < 30
    assert costs.milliseconds(Attenuation()) == 0


def test_the_pace_is_that_of_this_machine():
    costs = EffectCosts(TRUTH, GRID, OPTICS, Effects(), 1e-2)
    assert 0 < costs.milliseconds(DepthPSF()) < 10_000


@pytest.mark.slow
def test_the_price_is_what_an_image_with_its_gradient_takes_longer(one_thread):
    effect = DepthPSF(variance_z=0.02, variance_yx=0.01)
    grid = Grid((64, 64, 64), (0.1, 0.1, 0.1))
    mesh = sphere((3.2, 3.2, 3.2), 2.0, subdivisions=4)
    own, plain = (
        Renderer(Scene.of(mesh, OPTICS, e), grid, 1e-3) for e in (Effects.of(effect), Effects())
    )

    def seconds(renderer):
        vertices = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
        began = time.perf_counter()
        renderer.image(renderer.transform(vertices), renderer.otf(OPTICS)).sum().backward()
        return time.perf_counter() - began

    measured, stated = [], []
    for _ in range(7):  # in turns, since the pace of a machine that others use varies
        first, second = seconds(own), seconds(plain)
        measured.append(first / second)
        costs = EffectCosts(mesh, grid, OPTICS, Effects(), 1e-3)
        stated.append(1 + costs.milliseconds(effect) / (1e3 * costs.seconds))
    assert median(stated) == pytest.approx(median(measured[1:]), rel=0.3)
