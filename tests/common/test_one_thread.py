"""The same bits for any number of threads."""

from __future__ import annotations

from contextlib import nullcontext

import pytest
import torch

from napari_deltamic.common import one_thread as module
from napari_deltamic.common.one_thread import in_one_thread, one_thread, product


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_the_number_of_threads_is_given_back(two_threads):
    with one_thread():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2
    with pytest.raises(ZeroDivisionError), one_thread():
        raise ZeroDivisionError
    assert torch.get_num_threads() == 2


def test_a_function_and_its_gradient_run_in_one_thread(two_threads):
    threads = []

    class Told(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            threads.append(torch.get_num_threads())
            return x.clone()

        @staticmethod
        def backward(ctx, pull):
            threads.append(torch.get_num_threads())
            return pull

    x = torch.ones(3, requires_grad=True)
    in_one_thread(Told.apply, x).sum().backward()
    assert threads == [1, 1]
    assert torch.get_num_threads() == 2


def test_gradients_are_those_of_the_function():
    a, b = (torch.randn(4, 4, dtype=torch.complex128, requires_grad=True) for _ in range(2))
    assert torch.autograd.gradcheck(lambda *given: in_one_thread(torch.matmul, *given), (a, b))
    held = a.detach()
    assert torch.autograd.gradcheck(lambda one: in_one_thread(torch.matmul, held, one), (b,))
    assert not in_one_thread(torch.matmul, held, held).requires_grad


def test_a_gradient_may_be_asked_for_twice():
    x = torch.tensor([2.0, 3.0], requires_grad=True)
    found = in_one_thread(torch.square, x).sum()
    first, second = (torch.autograd.grad(found, x, retain_graph=True)[0] for _ in range(2))
    assert torch.equal(first, second)
    assert torch.equal(first, 2 * x)


@pytest.mark.parametrize("kinds", [("cdouble", "cdouble"), ("cdouble", "double")])
@pytest.mark.parametrize("shapes", [((4, 3), (4, 3)), ((2, 4, 3), (4, 3)), ((4, 1), (2, 1, 3))])
def test_gradients_of_a_product_are_right(kinds, shapes):
    a, b = (
        torch.randn(shape, dtype=getattr(torch, kind), requires_grad=True)
        for shape, kind in zip(shapes, kinds, strict=True)
    )
    assert torch.equal(product(a, b), a * b)
    assert torch.autograd.gradcheck(product, (a, b))
    assert torch.autograd.gradcheck(lambda one: product(a.detach(), one), (b,))
    assert not product(a.detach(), b.detach()).requires_grad


def test_a_product_runs_in_one_thread(two_threads, monkeypatch):
    threads = []
    monkeypatch.setattr(module, "one_thread", lambda: threads.append(1) or nullcontext())
    x = torch.ones(3, requires_grad=True)
    product(x, x.detach()).sum().backward()
    assert threads == [1, 1]
