"""The compiled loops explain an image as the plain operations of torch do."""

import numpy as np
import pytest
import torch

from napari_deltamic.fitting.model.likelihood import centred_products, explained, match, products

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


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("count", [1, 3, 4096, 9001])  # also less than a lane, and blocks
def test_products_are_those_of_numpy(dtype, count):
    columns = RNG.normal(5, 1, (3, count))
    weights = RNG.uniform(0, 1, count)
    given = [torch.tensor(c, dtype=dtype) for c in (*columns, weights)]
    *own, w = (t.double().numpy() for t in given)
    wanted = np.einsum("in,jn,n->ij", own, own, w)
    np.testing.assert_allclose(products(given[:-1], given[-1]), wanted, rtol=1e-12)


@pytest.mark.parametrize("level", [0.0, 1e2])  # deviations
def test_centred_products_are_those_of_numpy(level, monkeypatch):
    columns, weights = RNG.normal(level, 1, (2, 9001)), RNG.uniform(0, 1, 9001)
    given = [torch.tensor(c, dtype=torch.float64) for c in (*columns, weights)]
    away = columns - np.average(columns, axis=1, weights=weights)[:, None]
    wanted = np.einsum("in,jn,n->ij", away, away, weights)
    scale = wanted.max()
    found = centred_products(given[:-1], given[-1])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * scale)
    monkeypatch.setattr("napari_deltamic.fitting.model.likelihood.compiled", lambda device: False)
    found = centred_products(given[:-1], given[-1])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * scale)


def test_products_of_any_number_of_threads_have_the_same_bits():
    columns = [torch.tensor(RNG.normal(0, 1, 50_001), dtype=torch.float32) for _ in range(3)]
    before = torch.get_num_threads()
    found = set()
    for threads in (1, 2, 3):
        torch.set_num_threads(threads)
        found.add(products(columns[:2], columns[2]).tobytes())
    torch.set_num_threads(before)
    assert len(found) == 1


def test_products_refuse_what_does_not_fit():
    some = np.ones(5)
    for columns, words in (([], "1 to 64"), ([np.ones(4)], "shape"), ([some] * 65, "1 to 64")):
        with pytest.raises(ValueError, match=words):
            loops.products_f64(columns, some, [0.0] * len(columns), 1)
    with pytest.raises(ValueError, match="one number per column"):
        loops.products_f64([some], some, [0.0, 0.0], 1)
