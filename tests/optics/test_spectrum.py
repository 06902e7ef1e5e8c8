"""Bands and reach of PSFs that are not Gaussian: images keep to the accuracy asked for."""

import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene

GRID = nd.Grid((24, 32, 32), (0.2, 0.1, 0.1))
MESH = sphere((2.3, 1.55, 1.55), 0.9, subdivisions=3)
BLUR = (0.4, 0.2, 0.2)
EXTENT = (1.2, 1.0)
OPTICS = {
    "widefield": nd.ScalarPSF(0.9, 0.52, 1.333, extent=EXTENT),
    "aberrated": nd.GibsonLanniPSF(1.1, 0.52, 1.515, 1.4, 4.0, extent=EXTENT),
    "confocal": nd.ConfocalPSF(nd.VectorialPSF(1.0, 0.52, 1.333), 0.488),
    "light sheet": nd.LightSheetPSF(nd.ScalarPSF(0.8, 0.52, 1.333, extent=EXTENT), 1.0),
    "pupil": nd.PupilPSF(0.8, 0.52, 1.333, {5: 0.4, 11: 0.3}, extent=EXTENT),
    "mixture": nd.GaussianMixturePSF([(0.3, 0.12, 0.12), (0.6, 0.3, 0.3)], [1, 0.4]),
}


def rendered(optics, accuracy, blur):
    renderer = Renderer(Scene.of(MESH, optics), GRID, accuracy, blur=blur)
    vertices = torch.tensor(MESH.vertices_numpy())
    return renderer.image(renderer.transform(vertices), renderer.otf(optics)).double(), renderer


@pytest.mark.parametrize("blur", [(0.0, 0.0, 0.0), BLUR])
@pytest.mark.parametrize("kind", OPTICS)
def test_images_keep_to_the_accuracy(kind, blur):
    exact, full = rendered(OPTICS[kind], 1e-6, blur)
    for accuracy in (1e-2, 1e-3):
        found, renderer = rendered(OPTICS[kind], accuracy, blur)
        assert float((found - exact).norm() / exact.norm()) < accuracy
        assert renderer.plan.band.count <= full.plan.band.count


def test_a_mixture_of_one_width_asks_for_no_more_than_its_gaussian():
    sigma = (0.3, 0.15, 0.15)
    one, mix = nd.GaussianPSF(sigma), nd.GaussianMixturePSF([sigma, sigma], [1, 1])
    for accuracy in (1e-2, 1e-3):
        counts = [Renderer(Scene.of(MESH, o), GRID, accuracy).plan.band.count for o in (one, mix)]
        assert counts[1] == pytest.approx(counts[0], rel=0.35)


def test_reach_grows_with_the_accuracy_and_ends_at_the_extent():
    for optics in OPTICS.values():
        coarse, fine = optics.reach(1e-1), optics.reach(1e-4)
        for a, b, end in zip(coarse, fine, optics.extent, strict=True):
            assert 0 < a <= b <= end + 1e-12


def test_rendering_is_differentiable_in_the_optics():
    na = torch.tensor(0.9, dtype=torch.float64, requires_grad=True)
    image = nd.render(MESH, GRID, nd.ScalarPSF(na, 0.52, 1.333, extent=EXTENT), 1e-4)
    (found,) = torch.autograd.grad((image**2).sum(), na)
    sums = []
    for step in (1e-3, -1e-3):
        near = nd.ScalarPSF(0.9, 0.52, 1.333, extent=EXTENT)
        moved = near._with_values({**near.values, "na": na.detach() + step})
        renderer = Renderer(Scene.of(MESH, near), GRID, 1e-4)
        box = renderer.transform(torch.tensor(MESH.vertices_numpy()))
        sums.append(float((renderer.image(box, renderer.otf(moved)) ** 2).sum()))
    assert float(found) == pytest.approx((sums[0] - sums[1]) / 2e-3, rel=2e-3)
