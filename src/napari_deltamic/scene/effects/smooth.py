"""Effects that vary smoothly over the field of view: background and illumination."""

from __future__ import annotations

from itertools import product
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import torch
from numpy.polynomial import legendre
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor

from ..grid import Grid
from .base import Bounds, Effect, GainEffect, OffsetEffect, relative


def _orders(order: int, axes: int) -> list[tuple[int, ...]]:
    """Return exponents of degree 1 to ``order``; constants belong to amplitude or background."""
    found = [k for k in product(range(order + 1), repeat=axes) if 1 <= sum(k) <= order]
    return sorted(found, key=lambda k: (sum(k), tuple(-n for n in k)))


def _polynomial(
    coefficients: tuple[float, ...], orders: list[tuple[int, ...]], along: list[Tensor]
) -> Tensor:
    """Sum products of Legendre polynomials, which are independent of each other over the image."""
    most = max(max(order) for order in orders)
    total = torch.zeros([most + 1] * len(along), dtype=torch.float64)
    for coefficient, order in zip(coefficients, orders, strict=True):
        total[order] = coefficient
    # Axis by axis, the first one last: only the sum is as large as the image.
    for axis in reversed(range(len(along))):
        values = torch.as_tensor(_legendre(along[axis], most))
        total = torch.tensordot(values, total, ([1], [axis])).movedim(0, axis)
    return total.reshape(np.broadcast_shapes(*(t.shape for t in along)))


def _legendre(at: Tensor, most: int) -> NDArray[np.float64]:
    """Return (N, most + 1) Legendre polynomials along an axis."""
    found: NDArray[np.float64] = legendre.legvander(at.reshape(-1).numpy(), most)
    return found


class _Polynomial(Effect):
    """The coefficients of a polynomial, filled up with zeros."""

    axes: ClassVar[str] = "zyx"

    order: Annotated[int, Field(ge=1, le=3)] = Field(default=1, description="largest degree")
    coefficients: tuple[float, ...] = Field(
        default=(), description="of the Legendre polynomials over the image; empty: zeros"
    )

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, values: Any) -> Any:
        if isinstance(values, dict):
            order = values.get("order", cls.model_fields["order"].default)
            if isinstance(order, int) and 1 <= order <= 3 and not values.get("coefficients"):
                n = len(_orders(order, len(cls.axes)))
                return {**values, "coefficients": (0.0,) * n}
        return values

    @model_validator(mode="after")
    def _one_number_a_term(self) -> Self:
        n = len(self._orders())
        if len(self.coefficients) != n:
            raise ValueError(
                f"a polynomial of order {self.order} along {', '.join(self.axes)} has {n} "
                f"coefficients, not {len(self.coefficients)}"
            )
        return self

    def _orders(self) -> list[tuple[int, ...]]:
        return _orders(self.order, len(self.axes))

    def names_of(self, field: str) -> tuple[str, ...]:
        """Return the axes along which terms vary: ``z``, ``yy`` (second degree), ``yx``."""
        return tuple(
            "".join(a * n for a, n in zip(self.axes, k, strict=True)) for k in self._orders()
        )

    def _values(self, grid: Grid, frame: Grid) -> Tensor:
        along = [relative(grid, frame, "zyx".index(a)) for a in self.axes]
        return _polynomial(self.coefficients, self._orders(), along)


class Background(_Polynomial, OffsetEffect):
    """A background that changes slowly over the image, on top of the constant one."""

    name: ClassVar[str] = "background"
    of_one_image: ClassVar[bool] = True
    title: ClassVar[str] = "uneven background"
    help: ClassVar[str] = (
        "the background rises or falls slowly over the image; left out, it pulls the surface and "
        "widens the PSF where it is fitted"
    )
    bounds: ClassVar[dict[str, Bounds]] = {
        "coefficients": Bounds("intensity", float("-inf"), float("inf"), 1.0)
    }

    def offset(self, grid: Grid, frame: Grid) -> Tensor:
        """Return the polynomial, of arguments that run from -1 to 1 over the image."""
        return self._values(grid, frame)

    def summed(self, image: Tensor, grid: Grid, frame: Grid) -> Tensor:
        """See ``OffsetEffect``."""
        sums = image.to(torch.float64).numpy()
        for axis in (2, 1, 0):
            values = _legendre(relative(grid, frame, axis), self.order)
            # einsum adds in one order for any number of threads.
            sums = np.einsum("...n,nk->k...", sums, values)
        return torch.tensor([sums[order] for order in self._orders()])


class Illumination(_Polynomial, GainEffect):
    """Uneven illumination of the field of view: a factor that varies along y and x."""

    name: ClassVar[str] = "illumination"
    axes: ClassVar[str] = "yx"
    title: ClassVar[str] = "uneven illumination"
    help: ClassVar[str] = (
        "the field of view is lit unevenly; left out, at 10 %, surfaces shift by less than 1 nm, "
        "but densities are wrong"
    )
    bounds: ClassVar[dict[str, Bounds]] = {"coefficients": Bounds("log", -2.0, 2.0, 0.1)}

    order: Annotated[int, Field(ge=1, le=3)] = Field(default=2, description="largest degree")

    def gain(self, grid: Grid, frame: Grid) -> Tensor:
        """Return the exponential of the polynomial, which is always positive."""
        return torch.exp(self._values(grid, frame))
