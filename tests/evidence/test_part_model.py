"""What a fit's objective says of a part of an image: columns as whole images differ, and steps."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from napari_deltamic import FitState, GaussianPSF, Grid, Mesh
from napari_deltamic.evidence.crop import Crop
from napari_deltamic.evidence.part_model import PartModel
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer, Scene
from napari_deltamic.scene.effects import (
    Attenuation,
    Bleaching,
    DepthPSF,
    Effects,
    Halo,
    Missing,
    PixelIntegration,
)
from napari_deltamic.scene.light import INSIDES, MEMBRANES, Light

GRID = Grid((14, 18, 30), (0.3, 0.2, 0.2))
OPTICS = GaussianPSF((0.42, 0.25, 0.25))
CELLS = Mesh.merge([sphere((2, 1.7, x), 1.0, edge_length=0.4) for x in (1.6, 4.2)])
ALL = Effects.of(Attenuation(per_um=0.1), DepthPSF(variance_z=0.1, variance_yx=0.02))
WHOLE = (slice(0, 14), slice(0, 18), slice(0, 30))
PIECE = (slice(2, 14), slice(0, 18), slice(4, 30))


def state(effects, light=MEMBRANES):
    even = np.ones(len(CELLS.faces))
    given = 1, 1, 1, CELLS, OPTICS, even, 0.0, 1000.0, 2.0, 1.0
    return FitState(*given, effects=effects, light=light)


@torch.no_grad()
def expected(of, vertices=None):
    """(Z, Y, X) of the whole image, planned for the surface as it is; also of it elsewhere."""
    renderer = Renderer(Scene.of(of.mesh, of.optics, of.effects, insides=True), GRID, 1e-4)
    places = torch.from_numpy(of.mesh.vertices_numpy() if vertices is None else vertices)
    spectrum = renderer.transform(places, torch.from_numpy(of.density), of.light)
    image = renderer.image(spectrum, renderer.otf(of.optics)).double().numpy()
    return of.amplitude * image + of.background


def settled(of, box=WHOLE, density="smooth"):
    """Its part of an image of the state itself, and how voxels of the whole image are picked."""
    first = [s.start for s in box]
    shape = [s.stop - s.start for s in box]
    z, y, x = np.multiply(first, GRID.voxel_size)
    piece = Grid(tuple(shape), GRID.voxel_size, (z, y, x))
    part = Crop(piece, box, CELLS, None, np.array([1, 2]), np.arange(np.prod(shape)), 2)
    settings = FitSettings(density=density)
    model = PartModel(part, expected(of).astype(np.float32), GRID, np.ones_like, settings)
    return model, model.begun(of), lambda image: image[box].reshape(-1).astype(float)


def near(column, change, share=0.03):
    return np.linalg.norm(column - change) < share * np.linalg.norm(change)


@pytest.mark.parametrize("effects", [Effects(), ALL], ids=["plain", "effects"])
@pytest.mark.parametrize("light", [MEMBRANES, INSIDES, Light(1.0, 0.3)], ids=["m", "i", "both"])
def test_columns_of_the_surface_are_those_of_whole_images(effects, light):
    model, found, seen = settled(state(effects, light), PIECE)
    columns, at = found.linearised.columns, found.state
    assert np.abs(found.linearised.residual).max() < 0.02 * np.ptp(expected(at))
    for k in (0, 3, len(model.modes) - 1):
        field = model.modes.fields[k]
        moved = [at.mesh.vertices_numpy() + h * field for h in (0.02, -0.02)]
        up, down = (seen(expected(at, vertices)) for vertices in moved)
        assert near(columns[:, k], (up - down) / 0.04)
    if light.membrane:
        k = len(model.modes) + 2
        field = model.density_columns(found, (CELLS.regions == 2).any(1)[None].astype(float))
        dimmer = [np.exp(h * (CELLS.regions == 2).any(1)) for h in (0.01, -0.01)]
        up, down = (seen(expected(replace(at, density=at.density * by))) for by in dimmer)
        assert near(field[:, 0], (up - down) / 0.02)
        assert columns[:, k].any()


@pytest.mark.parametrize("effect", [Halo(fraction=0.0), Bleaching(), PixelIntegration()])
def test_columns_of_an_effect_are_those_of_whole_images(effect):
    """Also of one that passes for another that is there: it is then seen in its place."""
    _, found, seen = settled(state(ALL), PIECE)
    rest = found.state.effects.without(*effect.contradicts)
    if effect.bounds:
        by = found.columns(effect)[:, 0] * 0.05
        p = effect.parameters()
        p[0] += 0.05
        with_it = rest.adding(effect.with_parameters(p))
        without = rest.adding(effect)
    else:
        by, with_it, without = found.columns(effect)[:, 0], rest.adding(effect), rest
    up, down = (seen(expected(replace(found.state, effects=e))) for e in (with_it, without))
    assert near(by, up - down)


def test_effects_that_name_voxels_of_the_whole_image_stay():
    held = Effects.of(Missing(slices=(0, 13)), Attenuation(per_um=0.1))
    _, found, _ = settled(state(held), PIECE)
    assert found.state.effects.missing == held.missing
    assert found.state.effects.attenuation.per_um == pytest.approx(0.1, rel=0.2)


def test_an_effect_is_found_by_steps_of_the_fit_and_left_out_again():
    hazy = Effects.of(Halo(fraction=0.2, width=0.8))
    of = state(hazy)
    model, found, _ = settled(of, density="uniform")
    held = found.linearised.columns.shape[1]
    assert list(found.own_columns(found.state.effects.halo)) == [held - 2, held - 1]
    none = np.zeros(len(model.modes))
    without = model.with_effects(found, Effects(), none)
    assert without.state.effects == Effects()
    again = model.with_effects(without, Effects.of(Halo(fraction=0.1, width=0.8)), none)
    assert again.state.effects.halo.fraction == pytest.approx(0.2, rel=0.2)
    rest, before = (np.linalg.norm(f.linearised.rest) for f in (again, without))
    assert rest < 0.3 * before
