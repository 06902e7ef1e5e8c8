"""The PSFs that a fit may find in place of the Gaussian that it was given, as plain values."""

from __future__ import annotations

from typing import Any

from ...common.triple import Triple
from ...optics import ConfocalPSF, GaussianMixturePSF, GaussianPSF, Optics, ScalarPSF
from ...runs.optics_settings import MicroscopeOptics, MixtureOptics

FoundPSF = ScalarPSF | ConfocalPSF | GaussianMixturePSF | GaussianPSF


def same_kind(optics: Optics, other: Optics) -> bool:
    """Whether a fit moves the same numbers of two PSFs; a tilted Gaussian is another kind."""
    return type(optics) is type(other) and optics.diagonal == other.diagonal


def values_of(optics: Optics) -> dict[str, Any] | None:
    """What makes a PSF that a fit has found; None for one of another kind.

    A Gaussian is found where it is tilted.
    """
    if isinstance(optics, GaussianPSF):
        return None if optics.diagonal else {"covariance": optics.covariance.detach().tolist()}
    if not isinstance(optics, ScalarPSF | ConfocalPSF | GaussianMixturePSF):
        return None
    numbers = {name: float(value.detach()) for name, value in optics.values.items()}
    return {**numbers, "fitted": list(optics.fitted)}


def held_of(values: dict[str, Any] | None) -> dict[str, Any] | None:
    """What a fit does not move of them, by name; what it moves has no number."""
    if values is None:
        return None
    moved = values.get("fitted", ["covariance"])
    return {name: None if name in moved else value for name, value in values.items()}


def psf_from(values: dict[str, Any]) -> FoundPSF:
    """The PSF that :func:`values_of` wrote."""
    values = dict(values)
    if "covariance" in values:
        return GaussianPSF(covariance=values["covariance"])
    fitted = values.pop("fitted")
    if "mass2" in values:
        widths, masses = _widths_and_masses(values)
        return GaussianMixturePSF(widths, masses, fitted=fitted)
    lit = {name: values.pop(name) for name in ("excitation", "pinhole") if name in values}
    if not lit:
        return ScalarPSF(**values, fitted=fitted)
    return ConfocalPSF(ScalarPSF(**values), **lit, fitted=fitted)


def settings_of(optics: Optics) -> MicroscopeOptics | MixtureOptics | None:
    """The settings of a PSF that a fit has found; None for one of another kind."""
    found = None if isinstance(optics, GaussianPSF) else values_of(optics)
    if found is None:
        return None
    fitted = tuple(found["fitted"])
    if isinstance(optics, GaussianMixturePSF):
        widths, masses = _widths_and_masses(found)
        return MixtureOptics(sigmas=widths, masses=masses, fitted=fitted)
    return MicroscopeOptics(
        modality="widefield" if isinstance(optics, ScalarPSF) else "confocal",
        na=found["na"],
        wavelength=found["wavelength"],
        immersion=found["index"],
        excitation=found.get("excitation"),
        model="scalar",
        spherical=found["spherical"],
        fitted=fitted,
    )


def _widths_and_masses(values: dict[str, Any]) -> tuple[tuple[Triple, ...], tuple[float, ...]]:
    """Widths and masses of the Gaussians of a mixture."""
    count = 1 + sum(name.startswith("mass") for name in values)
    widths = tuple(
        (values[f"sigma{n}_z"], values[f"sigma{n}_y"], values[f"sigma{n}_x"])
        for n in range(1, count + 1)
    )
    return widths, (1.0, *(values[f"mass{n}"] for n in range(2, count + 1)))
