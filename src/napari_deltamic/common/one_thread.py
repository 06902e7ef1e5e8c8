"""Results that are the same to the last bit for any number of threads.

Torch divides some operations among threads, such as matrix products, and their last digits depend
on where they are divided.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


@contextmanager
def one_thread() -> Iterator[None]:
    """Within the block, torch operations of this Python thread use no further threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def in_one_thread(function: Callable[..., Tensor], *given: Tensor) -> Tensor:
    """The function of these tensors, with value and gradient computed in one thread.

    Differentiable once. On devices other than the CPU, which have no such threads, the function is
    called as it is.
    """
    if any(one.device.type != "cpu" for one in given):
        return function(*given)
    found: Tensor = _InOneThread.apply(function, *given)
    return found


class _InOneThread(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, function: Callable[..., Tensor], *given: Tensor) -> Tensor:
        ctx.leaves = [one.detach().requires_grad_(one.requires_grad) for one in given]
        with torch.enable_grad(), one_thread():
            ctx.found = function(*ctx.leaves)
        found: Tensor = ctx.found.detach()
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *pull: Any) -> tuple[Tensor | None, ...]:
        asked = [one for one in ctx.leaves if one.requires_grad]
        with torch.enable_grad(), one_thread():
            # A product, since a gradient that starts from a tensor loads SymPy: half a second.
            total = (ctx.found * pull[0].conj()).real.sum()
            # A caller may ask again; what is retained is freed together with ctx.
            given = torch.autograd.grad(total, asked, retain_graph=True, allow_unused=True)
        found = iter(given)
        return (None, *(next(found) if one.requires_grad else None for one in ctx.leaves))


def product(one: Tensor, other: Tensor) -> Tensor:
    """The product of two tensors, with value and gradient computed in one thread.

    Like :func:`in_one_thread` of it, in half the time. Differentiable once.
    """
    if one.device.type != "cpu":
        return one * other
    found: Tensor = _Product.apply(one, other)
    return found


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, one: Tensor, other: Tensor) -> Tensor:
        ctx.save_for_backward(one, other)
        with one_thread():
            return one * other

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, pull: Tensor) -> tuple[Tensor | None, ...]:
        factors = ctx.saved_tensors

        def by(factor: Tensor, other: Tensor) -> Tensor:
            found = pull * other.conj()
            if not factor.is_complex():
                found = found.real
            return found.sum_to_size(factor.shape)

        with one_thread():
            given = zip(ctx.needs_input_grad, factors, factors[::-1], strict=True)
            return tuple(by(own, other) if needed else None for needed, own, other in given)
