"""A mixture of Gaussians with one centre: a narrow core and broad tails."""

from __future__ import annotations

from collections.abc import Sequence
from math import log, sqrt

import torch
from torch import Tensor

from ..errors import InputError
from .parameters import Spec, plain
from .parametric_psf import Axes, ParametricPSF

_MOST = 4
_AXES = ("z", "y", "x")


class GaussianMixturePSF(ParametricPSF):
    """A sum of two to four Gaussians with one centre and a total mass of 1.

    For PSFs with broad tails: spinning disk, widefield of low NA. The parameters are
    ``sigma1_z`` ... ``sigma4_x`` (um) and ``mass2`` ... ``mass4``, the mass of a component relative
    to that of the first.

    Parameters
    ----------
    sigmas
        (C, 3) um along Z, Y, X of the components, or (C,) one number for each.
    masses
        (C,) masses of the components, on any scale.
    fitted
        Names of the parameters to fit; by default all.

    Raises
    ------
    InputError
        If there are not two to four components, or a number is not positive.
    """

    def __init__(
        self,
        sigmas: Sequence[float | Sequence[float] | Tensor],
        masses: Sequence[float | Tensor] | Tensor,
        *,
        fitted: Sequence[str] | None = None,
    ) -> None:
        if not 2 <= len(sigmas) <= _MOST or len(sigmas) != len(masses):
            raise InputError(f"a mixture takes two to {_MOST} Gaussians, each with its mass")
        specs: list[Spec] = []
        values: dict[str, object] = {}
        for c, (sigma, mass) in enumerate(zip(sigmas, masses, strict=True), 1):
            three = torch.as_tensor(sigma, dtype=torch.float64).expand(3)
            for axis, s in zip(_AXES, three.unbind(0), strict=True):
                name = f"sigma{c}_{axis}"
                if not plain(s) > 0:
                    raise InputError(f"{name} must be positive (um), not {plain(s):g}")
                specs.append(Spec(name, "um", f"width of Gaussian {c} along {axis.upper()}", 0.0))
                values[name] = s
            if not plain(mass) > 0:
                raise InputError(f"the mass of Gaussian {c} must be positive, not {plain(mass):g}")
            if c > 1:
                specs.append(Spec(f"mass{c}", "", f"mass of Gaussian {c} over the first's", 0.0))
                values[f"mass{c}"] = mass / masses[0]
        self._count = len(sigmas)
        super().__init__(specs, values, [s.name for s in specs] if fitted is None else fitted)

    def _components(self) -> list[tuple[Tensor, list[Tensor]]]:
        v = self._values
        masses = [v[f"mass{c}"] if c > 1 else torch.ones_like(v["mass2"])
                  for c in range(1, self._count + 1)]  # fmt: skip
        total = torch.stack(masses).sum()
        return [
            (m / total, [v[f"sigma{c}_{axis}"] for axis in _AXES]) for c, m in enumerate(masses, 1)
        ]

    def _otf(self, axes: Axes) -> Tensor:
        found = None
        for mass, sigma in self._components():
            part = mass.to(axes[0].dtype)
            for s, k in zip(sigma, axes, strict=True):
                part = part * torch.exp(-0.5 * (s.to(k.dtype) * k) ** 2)
            found = part if found is None else found + part
        assert found is not None
        return found

    def support(self) -> tuple[float, float, float]:
        """Return wavenumbers (rad/um) along Z, Y, X beyond which the OTF is below 1e-12."""
        reach = sqrt(2 * log(1e12))
        z, y, x = (reach / min(plain(s[i]) for _, s in self._components()) for i in range(3))
        return z, y, x

    @property
    def extent(self) -> tuple[float, float, float]:
        """Distances (um) along Z, Y, X beyond which the PSF is practically zero."""
        z, y, x = (7.5 * max(plain(s[i]) for _, s in self._components()) for i in range(3))
        return z, y, x

    def _widths(self) -> tuple[float, float, float]:
        parts = [(plain(m), [plain(s) for s in sigma]) for m, sigma in self._components()]
        found = []
        for i in range(3):
            # Along the line through the middle; see otf_table.l2_width.
            line = [(m / (s[0] * s[1] * s[2]) * s[i], s[i]) for m, s in parts]
            first = sum(a for a, _ in line)
            second = sum(a * b / sqrt(s * s + t * t) for a, s in line for b, t in line)
            found.append(first**2 / second / sqrt(2))
        z, y, x = found
        return z, y, x
