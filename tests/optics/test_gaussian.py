"""The Gaussian PSF: its OTF, its parameters, and what it refuses."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import napari_deltamic as nd
from napari_deltamic.fourier import Band

SHAPE, VOXEL = (48, 42, 45), (0.11, 0.09, 0.1)
TILTED = np.array([[0.09, 0.03, -0.02], [0.03, 0.05, 0.01], [-0.02, 0.01, 0.06]])


def sampled_transform(covariance):
    """FFT of the PSF, sampled in space around voxel 0 of a periodic grid; half of it along X."""
    axes = [np.fft.fftfreq(n) * n * d for n, d in zip(SHAPE, VOXEL, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    power = np.einsum("...i,ij,...j", x, np.linalg.inv(covariance), x)
    density = np.exp(-power / 2) / np.sqrt((2 * np.pi) ** 3 * np.linalg.det(covariance))
    return np.fft.rfftn(density * np.prod(VOXEL))


def otf_on_grid(psf):
    band = Band.full(SHAPE, VOXEL)
    box = psf.otf(band.axes())
    order = [np.fft.fftfreq(n, 1 / n).astype(int) + n // 2 for n in SHAPE[:2]]
    return box.detach().numpy()[np.ix_(*order, np.arange(SHAPE[2] // 2 + 1))]


@pytest.mark.parametrize("sigma", [(0.3, 0.2, 0.25), (0.22, 0.22, 0.22)])
def test_otf_is_the_transform_of_the_sampled_psf(sigma):
    found = otf_on_grid(nd.GaussianPSF(sigma))
    assert_allclose(found, sampled_transform(np.diag(sigma) ** 2), atol=1e-5)
    assert found[0, 0, 0] == 1


def test_otf_of_a_full_covariance():
    # Signs of the off-diagonal terms show: they differ, and none is zero.
    assert_allclose(
        otf_on_grid(nd.GaussianPSF(covariance=TILTED)), sampled_transform(TILTED), atol=1e-5
    )


def test_one_number_is_the_same_along_each_axis():
    for sigma in (0.2, np.float32(0.2), np.array(0.2), torch.tensor(0.2), 1):
        assert_allclose(nd.GaussianPSF(sigma).sigma_um, float(sigma), rtol=1e-6)


def test_diagonal_covariance_is_the_same_as_sigma():
    sigma = (0.3, 0.2, 0.25)
    a, b = nd.GaussianPSF(sigma), nd.GaussianPSF(covariance=np.diag(sigma) ** 2)
    assert_allclose(otf_on_grid(a), otf_on_grid(b), atol=1e-14)
    assert_allclose(a.covariance, b.covariance, atol=1e-16)
    assert a.sigma_um == pytest.approx(b.sigma_um)
    assert a.diagonal
    assert not b.diagonal


def test_sigma_of_a_covariance_is_the_width_in_space():
    assert_allclose(nd.GaussianPSF(covariance=TILTED).sigma_um, np.sqrt(np.diag(TILTED)))


@pytest.mark.parametrize("covariance", [np.diag([0.09, 0.04, 0.01]), TILTED])
def test_width_bounds_the_otf(covariance):
    """Along each axis the OTF is above t only where |xi| < sqrt(2 ln(1/t)) / width, and just so."""
    psf, t = nd.GaussianPSF(covariance=covariance), 1e-3
    rng = np.random.default_rng(0)
    direction = torch.from_numpy(rng.normal(size=(20000, 3)))
    # On the surface where the OTF is t.
    power = torch.einsum("ki,ij,kj->k", direction, torch.from_numpy(covariance), direction)
    xi = direction * torch.sqrt(2 * np.log(1 / t) / power)[:, None]
    assert_allclose(psf.otf(tuple(xi.T)), t, rtol=1e-10)
    bound = np.sqrt(2 * np.log(1 / t)) / np.array(psf.width())
    farthest = xi.abs().amax(0).numpy()
    assert (farthest <= bound * (1 + 1e-12)).all()
    assert (farthest > bound * 0.99).all()


# ---------------------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    "psf", [nd.GaussianPSF((0.3, 0.2, 0.25)), nd.GaussianPSF(covariance=TILTED)]
)
def test_parameters_round_trip(psf):
    again = psf.with_parameters(psf.parameters())
    assert_allclose(again.covariance, psf.covariance, rtol=1e-12)
    assert again.diagonal == psf.diagonal
    assert len(psf.parameters()) == (3 if psf.diagonal else 6)


numbers = st.floats(-6, 6)


@settings(max_examples=60, deadline=None)
@given(st.lists(numbers, min_size=6, max_size=6), st.booleans())
def test_any_parameters_give_a_psf(values, full):
    start = nd.GaussianPSF(covariance=TILTED) if full else nd.GaussianPSF(0.2)
    psf = start.with_parameters(torch.tensor(values[: 6 if full else 3], dtype=torch.float64))
    covariance = psf.covariance.numpy()
    assert_allclose(covariance, covariance.T)
    # Products of the Cholesky factor's pivots: positive without rounding getting in the way.
    assert np.linalg.slogdet(covariance)[0] == 1 or np.linalg.cond(covariance) > 1e14
    assert (np.diag(covariance) > 0).all()
    assert all(w > 0 for w in psf.sigma_um)
    otf = psf.otf(Band.full((4, 4, 4), (1.0, 1.0, 1.0)).axes())
    assert ((otf >= 0) & (otf <= 1)).all()


def test_parameters_change_what_they_say():
    psf = nd.GaussianPSF((0.3, 0.2, 0.25))
    wider = psf.with_parameters(psf.parameters() + torch.tensor([np.log(2), 0, 0]))
    assert wider.sigma_um == pytest.approx((0.6, 0.2, 0.25))


# ----------------------------------------------------------------------------------- gradients


def some_axes():
    return Band.full((6, 5, 4), (0.2, 0.25, 0.3)).axes()


def test_gradient_in_sigma():
    sigma = torch.tensor([0.3, 0.2, 0.25], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda s: nd.GaussianPSF(s).otf(some_axes()), (sigma,))
    one = torch.tensor(0.2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda s: nd.GaussianPSF(s).otf(some_axes()), (one,))


def test_gradient_in_covariance():
    factor = torch.linalg.cholesky(torch.from_numpy(TILTED)).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda f: nd.GaussianPSF(covariance=f @ f.T).otf(some_axes()), (factor,)
    )


@pytest.mark.parametrize(
    "psf", [nd.GaussianPSF((0.3, 0.2, 0.25)), nd.GaussianPSF(covariance=TILTED)]
)
def test_gradient_in_parameters(psf):
    p = psf.parameters().requires_grad_()
    assert torch.autograd.gradcheck(lambda p: psf.with_parameters(p).otf(some_axes()), (p,))


def test_detach():
    sigma = torch.tensor([0.3, 0.2, 0.25], requires_grad=True)
    psf = nd.GaussianPSF(sigma)
    assert psf.otf(some_axes()).requires_grad
    copy = psf.detach()
    assert not copy.otf(some_axes()).requires_grad
    assert copy.sigma_um == psf.sigma_um
    assert copy.diagonal


def test_precision_follows_the_axes():
    axes = tuple(a.to(torch.float32) for a in some_axes())
    for psf in (nd.GaussianPSF(0.2), nd.GaussianPSF(covariance=TILTED)):
        assert psf.otf(axes).dtype == torch.float32
        assert_allclose(psf.otf(axes), psf.otf(some_axes()), rtol=1e-5)


# -------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "either sigma or a covariance"),
        ({"sigma": 0.2, "covariance": TILTED}, "either sigma or a covariance"),
        ({"sigma": 0.0}, "sigma must be positive"),
        ({"sigma": (0.2, -0.1, 0.2)}, r"sigma must be positive \(um\), not \(0.2, -0.1, 0.2\)"),
        ({"sigma": (0.2, float("nan"), 0.2)}, "sigma must be positive"),
        ({"sigma": float("inf")}, "sigma must be positive"),
        ({"sigma": (0.2, 0.3)}, "one number or three"),
        ({"sigma": [[0.2, 0.2, 0.2]]}, "one number or three"),
        ({"sigma": ()}, "one number or three"),
        ({"covariance": np.eye(2)}, r"shape \(3, 3\)"),
        ({"covariance": np.ones(3)}, r"shape \(3, 3\)"),
        ({"covariance": np.triu(np.ones((3, 3))) + np.eye(3)}, "symmetric"),
        ({"covariance": -np.eye(3)}, "positive definite"),
        ({"covariance": np.ones((3, 3))}, "positive definite"),
        ({"covariance": np.full((3, 3), np.nan)}, "covariance"),
        ({"covariance": np.diag([np.inf, 1, 1])}, "covariance"),
        ({"sigma": "wide"}, "sigma"),
        ({"covariance": [[1, 0, 0], [0, 1]]}, "covariance"),
    ],
)
def test_what_is_refused(arguments, message):
    with pytest.raises(nd.InputError, match=message):
        nd.GaussianPSF(**arguments)


def test_widened():
    plain = nd.GaussianPSF((0.4, 0.3, 0.2)).widened(0.3)
    assert plain.diagonal
    assert_allclose(plain.sigma_um, np.hypot((0.4, 0.3, 0.2), 0.3))
    tilted = nd.GaussianPSF(covariance=[[0.2, 0.05, 0], [0.05, 0.1, 0], [0, 0, 0.1]])
    found = tilted.widened(0.3).covariance - tilted.covariance
    assert_allclose(found, 0.09 * np.eye(3), atol=1e-12)
