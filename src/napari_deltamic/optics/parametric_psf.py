"""What the PSF models with named parameters have in common."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from math import log
from typing import Self

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import softshrink

from ..common.one_thread import in_one_thread, one_thread
from ..common.triple import Triple, geometric_mean
from ..fourier.falloff import Falloff
from ..fourier.plan import Cutoff
from .parameters import Parameter, Spec, as_value, bound, check_fitted, decode, encode, free_range
from .spectrum import band_radius, reach

Axes = tuple[Tensor, Tensor, Tensor]


class ParametricPSF:
    """A PSF whose named parameters are tensors; immutable, so that its OTF is kept.

    Subclasses compute the OTF in :meth:`_otf` from :attr:`values`.
    """

    def __init__(
        self, specs: Sequence[Spec], values: Mapping[str, object], fitted: Sequence[str]
    ) -> None:
        self._specs = tuple(specs)
        self._values = {s.name: as_value(s, values[s.name]) for s in self._specs}
        self._fitted = check_fitted(self._specs, fitted)
        self._forget()

    def _forget(self) -> None:
        """What is kept belongs to these values only."""
        self._kept: tuple[Axes, Tensor] | None = None
        self._sigma: Triple | None = None
        self._reach: dict[float, Triple] = {}
        self._bands: dict[tuple, tuple[Triple, float]] = {}

    # ----------------------------------------------------------------------------- parameters

    @property
    def values(self) -> dict[str, Tensor]:
        """Name -> value of every parameter."""
        return dict(self._values)

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the parameters that a fit moves."""
        return self._fitted

    def described(self) -> tuple[Parameter, ...]:
        """Every parameter with its unit, value and bounds."""
        found = []
        for s in self._specs:
            low, high = bound(s.lower, self._values), bound(s.upper, self._values)
            found.append(
                Parameter(
                    s.name,
                    s.unit,
                    s.help,
                    float(self._values[s.name].detach()),
                    None if low is None else float(low.detach()),
                    None if high is None else float(high.detach()),
                    s.name in self._fitted,
                    s.refused,
                )
            )
        return tuple(found)

    def parameters(self) -> Tensor:
        """The fitted parameters as unbounded numbers (P,)."""
        chosen = [encode(s, self._values) for s in self._specs if s.name in self._fitted]
        return torch.stack(chosen) if chosen else torch.zeros(0, dtype=torch.float64)

    def with_parameters(self, parameters: Tensor) -> Self:
        """The same model with other values of :meth:`parameters`; differentiable."""
        if not torch.is_grad_enabled():  # views of a leaf ask for gradients even there
            parameters = parameters.detach()
        values = dict(self._values)
        numbers = dict(zip(self._fitted, parameters.to(torch.float64).unbind(0), strict=True))
        # What bounds another comes first.
        ordered = sorted(self._specs, key=lambda s: isinstance(s.upper, str))
        for s in ordered:
            if s.name in numbers:
                values[s.name] = decode(s, numbers[s.name], values)
        return self._with_values(values)

    def limits(self) -> tuple[Tensor, Tensor]:
        """Range (P,), (P,) of :meth:`parameters` that a fit started here stays within."""
        p = self.parameters().detach()
        chosen = [free_range(s) for s in self._specs if s.name in self._fitted]
        reach = torch.tensor(chosen, dtype=torch.float64)
        return p - reach, p + reach

    def sharpened(self, factor: float) -> Self:
        """What a fit may make of the PSF before a band is planned anew: widths times ``factor``.

        Phases come closer to 0 by its logarithm, which is as far as one step may move them.
        """
        values = dict(self._values)
        for name in self._fitted:
            if name == "na":
                values[name] = torch.minimum(values[name] / factor, 0.999 * values["index"])
            elif name in ("wavelength", "excitation") or name.startswith("sigma"):
                values[name] = values[name] * factor
            elif name == "spherical":
                values[name] = softshrink(values[name], -log(factor))
        return self._with_values(values) if self._fitted else self

    def widened(self, by: float) -> Self:
        """A PSF of the same kind whose variance is larger by about the square of ``by`` (um)."""
        values = dict(self._values)
        longer = float(np.hypot(1.0, by / geometric_mean(self.sigma_um)))
        for name, value in values.items():
            if name.startswith("sigma"):
                values[name] = torch.hypot(value, value.new_tensor(by))
            elif name in ("wavelength", "excitation"):  # all lengths are proportional to them
                values[name] = value * longer
        return self._with_values(values)

    def detach(self) -> Self:
        """A copy that is no part of any gradient."""
        return self._with_values({name: v.detach() for name, v in self._values.items()})

    def _with_values(self, values: Mapping[str, Tensor]) -> Self:
        """The same model, on the same nodes, with other values; what is kept is forgotten."""
        other = copy.copy(self)
        other._values = {s.name: values[s.name] for s in self._specs}
        other._forget()
        other._adopt(values)
        return other

    def _moving(self, names: Sequence[str]) -> Self:
        """The same model as part of another, of which a fit moves parameters of these names."""
        other = self._with_values(self._values)
        other._fitted = tuple(name for name in self._values if name in names)
        return other

    def _adopt(self, values: Mapping[str, Tensor]) -> None:
        """Hand the values on to the PSFs that this one is made of."""

    def _number(self, name: str) -> float:
        return float(self._values[name].detach())

    # ------------------------------------------------------------------------------------ OTF

    @property
    def diagonal(self) -> bool:
        """Whether the axes of the PSF are those of the grid."""
        return True

    def otf(self, axes: Axes) -> Tensor:
        """Optical transfer function at wavevector components that broadcast over a box (rad/um).

        ``axes`` have the shapes (Kz, 1, 1), (1, Ky, 1) and (1, 1, Kx). The last result is kept
        while no parameter asks for a gradient. The bits are the same for any number of threads.
        """
        if self._differentiable():
            return in_one_thread(lambda *v: self._of(v)._otf(axes), *self._values.values())
        kept = self._kept
        if kept is not None and all(a is b for a, b in zip(kept[0], axes, strict=True)):
            return kept[1]
        with one_thread():
            otf = self._otf(axes)
        self._kept = (axes, otf)
        return otf

    def _of(self, values: Sequence[Tensor]) -> Self:
        return self._with_values(dict(zip(self._values, values, strict=True)))

    def _differentiable(self) -> bool:
        return any(v.requires_grad for v in self._values.values())

    def _otf(self, axes: Axes) -> Tensor:
        raise NotImplementedError

    def width(self) -> tuple[float, float, float]:
        """um along Z, Y, X: of a Gaussian that is about as wide."""
        return self.sigma_um

    def support(self) -> tuple[float, float, float]:
        """rad/um along Z, Y, X: the OTF is zero beyond."""
        raise NotImplementedError

    @property
    def extent(self) -> tuple[float, float, float]:
        """um along Z, Y, X: the PSF is zero beyond."""
        raise NotImplementedError

    def reach(self, accuracy: float) -> tuple[float, float, float]:
        """um along Z, Y, X: what lies beyond adds less than the accuracy to an image."""
        if accuracy not in self._reach:
            with torch.no_grad(), one_thread():
                self._reach[accuracy] = reach(self, accuracy)
        return self._reach[accuracy]

    def cutoff(self, blur: Triple = (0.0, 0.0, 0.0)) -> Cutoff:
        """Where the OTF ends, with a further Gaussian blur (um) on top.

        The function of :func:`napari_deltamic.optics.spectrum.band_radius`.
        """

        def found(error: float, falloff: Falloff) -> tuple[Triple, float]:
            key = (blur, error, falloff)
            if key not in self._bands:
                with torch.no_grad(), one_thread():
                    self._bands[key] = band_radius(self, blur, error, falloff)
            return self._bands[key]

        return found

    @property
    def sigma_um(self) -> tuple[float, float, float]:
        """Effective widths in space along Z, Y, X (um)."""
        if self._sigma is None:
            with torch.no_grad(), one_thread():
                self._sigma = self._widths()
        return self._sigma

    def _widths(self) -> tuple[float, float, float]:
        raise NotImplementedError

    def __repr__(self) -> str:
        shown = ", ".join(f"{p.name}={p.value:.4g}" for p in self.described())
        return f"{type(self).__name__}({shown})"
