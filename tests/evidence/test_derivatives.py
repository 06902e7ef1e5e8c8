"""The expected image of a scene and its derivatives, put together from parts and on pieces."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from napari_deltamic import GaussianPSF, Grid, Mesh
from napari_deltamic.evidence.fitted_scene import FittedScene
from napari_deltamic.evidence.image_model import ImageModel
from napari_deltamic.evidence.modes import shape_modes
from napari_deltamic.evidence.transforms import Transforms
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene
from napari_deltamic.scene.effects import Attenuation, DepthPSF, Effects, Halo
from napari_deltamic.scene.light import INSIDES, MEMBRANES, Light
from napari_deltamic.scene.structures import Surface

GRID = Grid((14, 18, 30), (0.3, 0.2, 0.2))
OPTICS = GaussianPSF((0.42, 0.25, 0.25))
CELLS = Mesh.merge([sphere((2, 1.7, x), 1.0, edge_length=0.4) for x in (1.6, 4.2)])
BOTH = Light(1.0, 0.3)
ALL = Effects.of(Attenuation(per_um=0.1), DepthPSF(variance_z=0.1, variance_yx=0.02))
INDEX = np.arange(np.prod(GRID.shape))


def scene(effects, light=MEMBRANES):
    density = 1 + 0.3 * np.sin(np.arange(len(CELLS.faces)))
    found = FittedScene.of(CELLS, OPTICS, effects, density, insides=light.interior != 0)
    return replace(found, light=light).scaled(10.0, 2.0)


@pytest.mark.parametrize("effects", [Effects(), ALL], ids=["plain", "effects"])
@pytest.mark.parametrize("light", [MEMBRANES, INSIDES, BOTH], ids=["membranes", "insides", "both"])
def test_parts_make_the_whole(effects, light):
    own = scene(effects, light)
    renderer = Renderer(Scene.of(CELLS, OPTICS, effects, insides=True), GRID, 1e-3)
    whole = renderer.transform(density=torch.tensor(own.density), light=light)
    kept = Transforms()
    for _ in range(2):
        parts = kept.of(renderer, own)
        assert (parts - whole).abs().max() < 1e-4 * whole.abs().max()


def test_what_an_effect_leaves_as_it_is_is_computed_once(monkeypatch):
    made = []
    planned = Surface.planned

    def counting(surface, site):
        found = planned(surface, site)
        transform = found.transform
        found.transform = lambda *given: made.append(1) or transform(*given)
        return found

    monkeypatch.setattr(Surface, "planned", counting)
    own = scene(Effects())
    model = ImageModel(own, GRID, INDEX, 1e-2)
    for names in ((), ("bleaching",), ("pixel_integration",), ("illumination",)):
        model.expected(replace(own, effects=Effects.of(*names)))
    assert len(made) == 1
    model.expected(replace(own, effects=Effects.of("attenuation")))
    assert len(made) == 2


def test_a_plan_for_a_wider_psf_does_not_serve_a_narrower_one():
    """Nor that of effects which need a plan of their own."""
    hazy = Effects.of(Halo(fraction=0.3, width=1.5))
    own = scene(hazy)
    model = ImageModel(scene(Effects()), GRID, INDEX, 1e-4)
    model.expected(replace(own, optics=GaussianPSF((0.84, 0.5, 0.5))))
    found, fresh = model.expected(own), ImageModel(own, GRID, INDEX, 1e-4).expected(own)
    assert np.abs(found - fresh).max() < 1e-3 * np.ptp(fresh)


@pytest.mark.parametrize("effects", [Effects(), ALL], ids=["plain", "effects"])
@pytest.mark.parametrize("light", [MEMBRANES, INSIDES, BOTH], ids=["membranes", "insides", "both"])
def test_columns_of_the_shape_are_those_of_the_whole_image(effects, light):
    own = scene(effects, light)
    model = ImageModel(own, GRID, INDEX, 1e-3)
    modes = shape_modes(CELLS, count=4)
    columns = model.shape_columns(own, modes)
    vertices, h = CELLS.vertices_numpy(), 0.02
    for k in (0, 3, len(modes) - 1):
        ends = [
            model.expected(
                own.with_surface(
                    CELLS.with_vertices(vertices + side * h * modes.fields[k]), own.density
                )
            )
            for side in (1, -1)
        ]
        change = (ends[0] - ends[1]) / (2 * h)
        assert np.linalg.norm(columns[:, k] - change) < 0.03 * np.linalg.norm(change)


def test_the_column_of_the_interior_is_that_of_the_whole_image():
    own = scene(ALL, BOTH)
    model = ImageModel(own, GRID, INDEX, 1e-3)
    columns = model.light_columns(own, model.rendered(own))
    ends = [model.expected(replace(own, light=Light(1.0, 0.3 + by))) for by in (0.1, -0.1)]
    change = (ends[0] - ends[1]) / 0.2
    assert np.linalg.norm(columns[:, 2] - change) < 1e-3 * np.linalg.norm(change)


def test_columns_of_the_density_are_those_of_the_whole_image():
    own = scene(ALL, BOTH)
    model = ImageModel(own, GRID, INDEX, 1e-3)
    field = (CELLS.regions == 2).any(1).astype(float)
    column = model.density_columns(own, field[None])[:, 0]
    ends = [
        model.expected(own.with_surface(CELLS, own.density * np.exp(s * 0.01 * field)))
        for s in (1, -1)
    ]
    change = (ends[0] - ends[1]) / 0.02
    assert np.linalg.norm(column - change) < 0.03 * np.linalg.norm(change)
