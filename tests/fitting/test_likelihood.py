import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from napari_deltamic import render
from napari_deltamic.fitting.model.likelihood import ImageNoise, match, noise_ratio, solve_scale
from napari_deltamic.geometry import sphere
from synthetic import CENTER, GRID, OPTICS, RADIUS


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def tensors(rng, n=500):
    """Rendered, measured and weights of n voxels."""
    rendered, noise, weights = torch.from_numpy(rng.random((3, n)))
    return rendered, 3 * rendered + 7 + noise, weights + 0.1


def test_solve_scale_is_exact(rng):
    rendered, _, weights = tensors(rng)
    amplitude, background, bounded = solve_scale(rendered, 2.5 * rendered + 40, weights)
    assert_allclose([amplitude, background], [2.5, 40], rtol=1e-12)
    assert not bounded


def test_solve_scale_is_the_weighted_least_squares(rng):
    rendered, measured, weights = tensors(rng)
    root = weights.sqrt()[:, None]
    columns = torch.stack([rendered, torch.ones_like(rendered)], 1)
    expected = torch.linalg.lstsq(columns * root, measured[:, None] * root).solution[:, 0]
    assert_allclose(solve_scale(rendered, measured, weights)[:2], expected, rtol=1e-10)


@pytest.mark.parametrize("offset", [1e3, 1e6, 1e8])
def test_an_offset_costs_no_digits(rng, offset):
    rendered, _, weights = tensors(rng)
    amplitude, background, bounded = solve_scale(rendered, 3 * rendered + offset, weights)
    assert_allclose([amplitude, background], [3, offset], rtol=1e-16 * offset + 1e-12)
    assert not bounded
    amplitude, _, bounded = solve_scale(rendered + offset, 3 * rendered, weights)
    assert_allclose(amplitude, 3, rtol=1e-15 * offset + 1e-12)
    assert not bounded


def test_a_voxel_that_outweighs_all_others_costs_no_digits(rng):
    rendered, _, weights = tensors(rng)
    measured = 2 * rendered + 1 + 0.1 * torch.sin(99 * rendered)
    weights[5] = 1e15
    # It fixes the line at its place; the others tell the slope.
    x, y, w = rendered - rendered[5], measured - measured[5], weights.clone()
    slope = float((w * x * y).sum() / (w * x * x).sum())
    assert_allclose(solve_scale(rendered, measured, weights)[0], slope, rtol=1e-9)


def test_amplitude_stays_positive_where_the_images_disagree(rng):
    rendered, _, weights = tensors(rng)
    amplitude, _, bounded = solve_scale(rendered, 10 - 3 * rendered, weights)
    assert amplitude > 0
    assert bounded


@pytest.mark.parametrize("sign", [1, -1])  # the second meets the bound
def test_gradient_of_the_match(rng, sign):
    rendered, measured, weights = tensors(rng, 30)
    measured = sign * measured
    leaf = rendered.clone().requires_grad_()
    squares, found = match(leaf, measured, weights)
    squares.backward()
    assert found.bounded == (sign == -1)
    way = torch.from_numpy(rng.normal(size=30))
    step = 1e-6

    def value(image):
        # Where the bound holds, the amplitude is held by design: the gradient is that.
        if sign == 1:
            return match(image, measured, weights)[0]
        return weights @ (found.amplitude * image + found.background - measured) ** 2

    slope = (value(rendered + step * way) - value(rendered - step * way)) / (2 * step)
    assert_allclose(float(leaf.grad @ way), float(slope), rtol=1e-6)


def test_squares_are_those_of_the_weighted_residuals(rng):
    rendered, measured, weights = tensors(rng)
    squares, found = match(rendered, measured, weights)
    residual = found.amplitude * rendered + found.background - measured
    assert_allclose(float(squares), float(weights @ residual**2), rtol=1e-12)
    assert found.squares == float(squares)
    mean = (weights @ measured) / weights.sum()
    assert_allclose(found.loss, float(squares / (weights @ (measured - mean) ** 2)), rtol=1e-12)
    assert type(found.amplitude) is type(found.background) is float
    assert found.bounded is False


def test_loss_is_one_where_nothing_is_explained(rng):
    rendered, measured, weights = tensors(rng)
    assert_allclose(match(0 * rendered, measured, weights)[1].loss, 1)
    assert match(measured, measured, weights)[1].loss < 1e-20


def test_loss_does_not_depend_on_gain_and_offset(rng):
    rendered, measured, weights = tensors(rng)
    one = match(rendered, measured, weights)[1].loss
    assert_allclose(match(rendered, 100 * measured + 1000, weights)[1].loss, one)


def test_a_region_without_contrast_gives_no_nan():
    flat = torch.zeros(100, dtype=torch.float32)
    rendered = torch.linspace(0, 1, 100).requires_grad_()
    squares, found = match(rendered, flat, torch.ones(100))
    squares.backward()
    assert np.isfinite([found.squares, found.loss]).all()
    assert torch.isfinite(rendered.grad).all()


def test_mixed_precision(rng):
    rendered, measured, weights = tensors(rng)
    expected = match(rendered, measured, weights)[1].loss
    found = match(rendered, measured.float(), weights.float())[1]
    assert_allclose(found.loss, expected, rtol=1e-4)


# --------------------------------------------------------------------------------- weights


def test_weights():
    measured = torch.linspace(10, 110, 1000)
    poisson = ImageNoise(measured, "poisson").weights(measured, None)
    assert (poisson > 0).all()
    assert (poisson.diff() <= 0).all()
    assert torch.equal(ImageNoise(measured, "gaussian").weights(measured, None), 0 * poisson + 1)
    paper = ImageNoise(measured, "paper").weights(measured, None)
    assert (paper >= 0).all()
    assert paper.argmax() == 999


def test_poisson_weights_are_one_over_the_variance():
    model = torch.tensor([1.0, 10.0, 100.0])
    measured = torch.linspace(0, 100, 1000)
    noise = ImageNoise(measured, "poisson")
    weights = noise.weights(model, model)
    variance = model - noise.dark + noise.floor
    assert_allclose(weights * variance, noise.floor, rtol=1e-5)


def radii(kind, draws=40):
    """Radius and background fitted to Poisson draws of a sphere, linearised about the truth."""

    def image(radius):
        mesh = sphere(CENTER, radius, subdivisions=4)
        return render(mesh, GRID, OPTICS, 1e-4).double().reshape(-1)

    step = 0.01
    truth = image(RADIUS)
    gain = 30 / truth.max()
    slope = gain * (image(RADIUS + step) - image(RADIUS - step)) / (2 * step)
    truth = gain * truth.clamp(min=0)
    model = truth + 2
    near = truth > 0.01 * truth.max()
    columns = torch.stack([slope, truth, torch.ones_like(truth)], 1)[near]
    rng = np.random.default_rng(1)
    fits = []
    for _ in range(draws):
        measured = torch.from_numpy(rng.poisson(model.numpy()).astype(float))
        noise = ImageNoise(measured, kind)
        root = noise.weights(measured, model if kind == "poisson" else None)[near].sqrt()[:, None]
        residual = (measured - model)[near, None] * root
        fits.append(torch.linalg.lstsq(columns * root, residual).solution[:, 0])
    return torch.stack(fits)


def test_poisson_weights_need_fewer_photons_than_the_papers():
    poisson, plain, paper = (radii(kind) for kind in ("poisson", "gaussian", "paper"))
    assert poisson[:, 0].std() < plain[:, 0].std() < paper[:, 0].std()
    assert poisson[:, 0].std() < 0.75 * paper[:, 0].std()
    # The paper's weights prefer the brighter draws: the background comes out a photon too high.
    assert abs(poisson[:, 2].mean()) < 0.1
    assert_allclose(paper[:, 2].mean(), 1, atol=0.35)


# ----------------------------------------------------------------------------------- noise


def test_noise_ratio_measures_the_noise(rng):
    image = np.zeros((10, 40, 40), np.float32)
    image[3:7, 10:30, 10:30] = 100
    known = np.ones(image.shape, bool)
    assert noise_ratio(image, known) == 0
    noisy = image + rng.normal(0, 2, image.shape).astype(np.float32)
    assert_allclose(noise_ratio(noisy, known), 0.02, rtol=0.15)


def test_noise_ratio_ignores_missing_voxels(rng):
    image = rng.normal(0, 1, (10, 40, 40)).astype(np.float32)
    known = np.ones(image.shape, bool)
    one = noise_ratio(image, known)
    known[:5] = False
    image[:5] = 1e6
    assert_allclose(noise_ratio(image, known), one, rtol=0.1)
    assert noise_ratio(image, np.zeros(image.shape, bool)) == 0
