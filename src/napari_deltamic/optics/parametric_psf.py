"""The base class of PSF models with named parameters."""

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
    """A PSF whose named parameters are tensors; immutable, so that its OTF can be cached.

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
        """Clear everything that was cached, which belongs to the present values."""
        self._kept: tuple[Axes, Tensor] | None = None
        self._sigma: Triple | None = None
        self._reach: dict[float, Triple] = {}
        self._bands: dict[tuple, tuple[Triple, float]] = {}

    # ----------------------------------------------------------------------------- parameters

    @property
    def values(self) -> dict[str, Tensor]:
        """Values of all parameters, by name."""
        return dict(self._values)

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the parameters that a fit changes."""
        return self._fitted

    def described(self) -> tuple[Parameter, ...]:
        """Describe every parameter with its unit, value and bounds."""
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
        """Return the fitted parameters as unbounded numbers (P,)."""
        chosen = [encode(s, self._values) for s in self._specs if s.name in self._fitted]
        return torch.stack(chosen) if chosen else torch.zeros(0, dtype=torch.float64)

    def with_parameters(self, parameters: Tensor) -> Self:
        """Return the model with other values of :meth:`parameters`, differentiable in them."""
        if not torch.is_grad_enabled():  # views of a leaf ask for gradients even there
            parameters = parameters.detach()
        values = dict(self._values)
        numbers = dict(zip(self._fitted, parameters.to(torch.float64).unbind(0), strict=True))
        # Parameters that are bounds of others come first.
        ordered = sorted(self._specs, key=lambda s: isinstance(s.upper, str))
        for s in ordered:
            if s.name in numbers:
                values[s.name] = decode(s, numbers[s.name], values)
        return self._with_values(values)

    def limits(self) -> tuple[Tensor, Tensor]:
        """Return bounds (P,), (P,) of :meth:`parameters` for a fit that starts here."""
        p = self.parameters().detach()
        chosen = [free_range(s) for s in self._specs if s.name in self._fitted]
        reach = torch.tensor(chosen, dtype=torch.float64)
        return p - reach, p + reach

    def sharpened(self, factor: float) -> Self:
        """Return the sharpest PSF that a fit may reach before the band is planned anew.

        Its widths are multiplied by ``factor``. Phases come closer to 0 by the size of its
        logarithm, which is as far as one step may move them.
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
        """Return a PSF of the same kind, its variance larger by about ``by`` (um) squared."""
        values = dict(self._values)
        longer = float(np.hypot(1.0, by / geometric_mean(self.sigma_um)))
        for name, value in values.items():
            if name.startswith("sigma"):
                values[name] = torch.hypot(value, value.new_tensor(by))
            elif name in ("wavelength", "excitation"):  # all lengths are proportional to them
                values[name] = value * longer
        return self._with_values(values)

    def detach(self) -> Self:
        """Return a copy detached from any gradient."""
        return self._with_values({name: v.detach() for name, v in self._values.items()})

    def _with_values(self, values: Mapping[str, Tensor]) -> Self:
        """Return the model, on the same nodes, with other values and without cached results."""
        other = copy.copy(self)
        other._values = {s.name: values[s.name] for s in self._specs}
        other._forget()
        other._adopt(values)
        return other

    def _moving(self, names: Sequence[str]) -> Self:
        """Return the model as a part of another one, with only these parameters fitted."""
        other = self._with_values(self._values)
        other._fitted = tuple(name for name in self._values if name in names)
        return other

    def _adopt(self, values: Mapping[str, Tensor]) -> None:
        """Pass the values on to the PSFs that this one is made of."""

    def _number(self, name: str) -> float:
        return float(self._values[name].detach())

    # ------------------------------------------------------------------------------------ OTF

    @property
    def diagonal(self) -> bool:
        """Whether the axes of the PSF are those of the grid."""
        return True

    def otf(self, axes: Axes) -> Tensor:
        """Return the OTF at wavevector components (rad/um) that broadcast over a box.

        ``axes`` have the shapes (Kz, 1, 1), (1, Ky, 1) and (1, 1, Kx). The last result is kept
        while no parameter needs a gradient. The bits are the same for any number of threads.
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
        """Return the widths (um along Z, Y, X) of a Gaussian that is about as wide."""
        return self.sigma_um

    def support(self) -> tuple[float, float, float]:
        """Return wavenumbers (rad/um) along Z, Y, X beyond which the OTF is zero."""
        raise NotImplementedError

    @property
    def extent(self) -> tuple[float, float, float]:
        """Distances (um) along Z, Y, X beyond which the PSF is zero."""
        raise NotImplementedError

    def reach(self, accuracy: float) -> tuple[float, float, float]:
        """Return distances (um) by axis beyond which a PSF adds less than the accuracy."""
        if accuracy not in self._reach:
            with torch.no_grad(), one_thread():
                self._reach[accuracy] = reach(self, accuracy)
        return self._reach[accuracy]

    def cutoff(self, blur: Triple = (0.0, 0.0, 0.0)) -> Cutoff:
        """Return where the OTF ends, with a further Gaussian blur (um).

        This is :func:`napari_deltamic.optics.spectrum.band_radius` by error and falloff.
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
