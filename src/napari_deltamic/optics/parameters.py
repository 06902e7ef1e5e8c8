"""Parameters of a PSF: names, units, bounds, and the unbounded numbers that a fit changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, log

import torch
from torch import Tensor

from ..errors import InputError

RANGE = log(4)  # of a parameter's logarithm, around its value at the start of a fit
_FREE_RANGE = 3.0  # the same for parameters without bounds (phases, rad)


@dataclass(frozen=True)
class Spec:
    """Properties of a parameter that do not depend on its value.

    Attributes
    ----------
    name, unit, help
        ``unit`` is "" for pure numbers.
    lower, upper
        Bounds, which a value never reaches; a name stands for the value of that parameter, None for
        no bound.
    typical
        Range; values outside are refused, as they must be in another unit.
    refused
        Why it cannot be fitted; "" where it can.
    """

    name: str
    unit: str
    help: str
    lower: float | str | None = None
    upper: float | str | None = None
    typical: tuple[float, float] = (-inf, inf)
    refused: str = ""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a PSF with its present value.

    Attributes
    ----------
    name, unit, help
        ``unit`` is "" for pure numbers.
    value
        In that unit.
    lower, upper
        Bounds of the value; None for no bound.
    fitted
        Whether a fit changes it.
    refused
        Why it cannot be fitted; "" where it can.
    """

    name: str
    unit: str
    help: str
    value: float
    lower: float | None
    upper: float | None
    fitted: bool
    refused: str


def as_value(spec: Spec, value: object) -> Tensor:
    """Return a checked float64 scalar; a tensor is kept, so that a PSF is differentiable in it.

    Raises
    ------
    InputError
        If it is not a finite number, or in another unit.
    """
    try:
        tensor = value.to(torch.float64) if isinstance(value, Tensor) else _double(value)
        number = float(tensor.detach())
    except (TypeError, ValueError, RuntimeError):
        raise InputError(f"{spec.name} takes one number, not {value!r}") from None
    if not isfinite(number):
        raise InputError(f"{spec.name} must be a finite number, not {number}")
    check_unit(spec, number)
    return tensor


def plain(value: float | Tensor) -> float:
    """Return a plain number from a number or a tensor."""
    return float(value.detach()) if isinstance(value, Tensor) else float(value)


def _double(value: object) -> Tensor:
    return torch.tensor(float(value), dtype=torch.float64)  # type: ignore[arg-type]


def check_unit(spec: Spec, number: float) -> None:
    """Raise InputError if a number is not typical; it says if the number is off by 1000."""
    low, high = spec.typical
    if low <= number <= high:
        return
    for factor in (1e-3, 1e3) if spec.unit not in ("", "rad") else ():
        if low <= number * factor <= high:
            raise InputError(
                f"{spec.name} {number:g} {spec.unit}: did you mean {number * factor:g}?"
            )
    unit = f" {spec.unit}" if spec.unit else ""
    if high == inf:
        raise InputError(f"{spec.name} must be at least {low:g}{unit}, not {number:g}")
    raise InputError(f"{spec.name} must lie between {low:g} and {high:g}{unit}, not {number:g}")


def check_fitted(specs: Sequence[Spec], fitted: Sequence[str]) -> tuple[str, ...]:
    """Return the names to fit, in the order of the specs. InputError if one cannot be fitted."""
    known = {s.name: s for s in specs}
    for name in fitted:
        if name not in known:
            raise InputError(f"no parameter '{name}' to fit: there are {', '.join(known)}")
        if known[name].refused:
            raise InputError(f"{name} cannot be fitted: {known[name].refused}")
    return tuple(name for name in known if name in set(fitted))


def encode(spec: Spec, values: Mapping[str, Tensor]) -> Tensor:
    """Return the unbounded number for a value: a log or logit, so that bounds always hold."""
    v = values[spec.name]
    low, high = bound(spec.lower, values), bound(spec.upper, values)
    if low is None and high is None:
        return v
    if (low is not None and plain(v) <= plain(low)) or (
        high is not None and plain(v) >= plain(high)
    ):
        raise InputError(f"{spec.name} is at its bound ({plain(v):g}); to be fitted, start inside")
    if low is None:
        raise NotImplementedError("an upper bound alone")
    if high is None:
        return torch.log(v - low)
    return torch.log(v - low) - torch.log(high - v)


def decode(spec: Spec, number: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Return the value for an unbounded number; ``values`` hold the parameters that bounds name."""
    low, high = bound(spec.lower, values), bound(spec.upper, values)
    if low is None:
        return number
    if high is None:
        return low + torch.exp(number)
    return low + (high - low) * torch.sigmoid(number)


def bound(given: float | str | None, values: Mapping[str, Tensor]) -> Tensor | None:
    """Return a bound as a number; None for no bound."""
    if given is None:
        return None
    return values[given] if isinstance(given, str) else torch.tensor(given, dtype=torch.float64)


def free_range(spec: Spec) -> float:
    """Return how far the unbounded number may move in a fit."""
    return _FREE_RANGE if spec.lower is None and spec.upper is None else RANGE
