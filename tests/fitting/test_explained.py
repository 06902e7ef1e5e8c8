"""The compiled loops explain an image as the plain operations of torch do."""

import numpy as np
import pytest
import torch

from napari_deltamic.fitting.likelihood import explained, match

loops = pytest.importorskip("napari_deltamic.fourier._mesh_ft")
RNG = np.random.default_rng(4)


def scene(dtype, level=300.0, slope=500.0):
    image = torch.tensor(RNG.random((17, 30, 40)), dtype=dtype, requires_grad=True)
    index = torch.from_numpy(np.flatnonzero(RNG.random(image.numel()) < 0.6))
    seen = level + slope * image.detach().reshape(-1)[index]
    noise = torch.from_numpy(30 * RNG.standard_normal(len(index)))
    weights = torch.from_numpy(RNG.uniform(0.2, 1, len(index))).float()
    return image, index, (seen + noise).float(), weights


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("slope", [500.0, -500.0, 0.0])  # the amplitude's bound is met
@pytest.mark.parametrize("level", [300.0, 6e4])
def test_as_by_torch(dtype, slope, level):
    image, index, measured, weights = scene(dtype, level, slope)
    squares, found = explained(image, index, measured, weights)
    squares.backward()
    by_loops, image.grad = image.grad, None
    wanted, told = match(image.reshape(-1)[index], measured, weights)
    wanted.backward()
    scale = float(image.grad.abs().max())
    torch.testing.assert_close(by_loops, image.grad, rtol=1e-4, atol=1e-5 * scale)
    for name in ("squares", "loss", "amplitude", "background"):
        assert getattr(found, name) == pytest.approx(getattr(told, name), rel=1e-6)
    assert found.bounded == told.bounded


def test_an_image_that_is_flat_explains_nothing():
    _, index, measured, weights = scene(torch.float32)
    flat = torch.full((17, 30, 40), 0.3)
    _, found = explained(flat, index, measured, weights)
    assert found.bounded
    assert found.amplitude == 0
    assert found.loss == pytest.approx(1)


def test_threads_change_no_bit():
    given = scene(torch.float32)
    before = torch.get_num_threads()
    told = []
    for threads in (1, 2, 3):
        torch.set_num_threads(threads)
        given[0].grad = None
        squares, found = explained(*given)
        squares.backward()
        told.append((found, given[0].grad.numpy().tobytes()))
    torch.set_num_threads(before)
    assert told[0] == told[1] == told[2]


def test_voxels_that_cannot_be_are_refused():
    image, index, measured, weights = scene(torch.float32)
    for wrong in (index.flip(0), index * 0, index - 1_000_000, index + 1_000_000):
        with pytest.raises(ValueError, match="once, in their order"):
            explained(image, wrong, measured, weights)
