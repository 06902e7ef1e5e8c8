"""Bessel functions and their gradients."""

import numpy as np
import pytest
import scipy.special
import torch
from numpy.testing import assert_allclose

from napari_deltamic.optics.bessel import j0, j1, j2, jinc

X = np.concatenate([[0.0, 1e-8, 1e-4], np.linspace(0.01, 60, 997)])


@pytest.mark.parametrize(("function", "order"), [(j0, 0), (j1, 1), (j2, 2)])
def test_values_and_gradients(function, order):
    x = torch.tensor(X, requires_grad=True)
    value = function(x)
    assert_allclose(value.detach(), scipy.special.jv(order, X), atol=1e-14)
    (gradient,) = torch.autograd.grad(value.sum(), x)
    assert_allclose(gradient, scipy.special.jvp(order, X), atol=1e-13)


def test_transform_of_a_disc():
    x = torch.tensor(X, requires_grad=True)
    value = jinc(x)
    assert float(value[0].detach()) == 1
    assert_allclose(value.detach()[3:], 2 * scipy.special.j1(X[3:]) / X[3:], atol=1e-15)
    (gradient,) = torch.autograd.grad(value.sum(), x)
    assert_allclose(gradient[3:], -2 * scipy.special.jv(2, X[3:]) / X[3:], atol=1e-13)
    assert float(gradient[0]) == 0
