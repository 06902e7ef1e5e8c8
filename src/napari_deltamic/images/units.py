"""Units of length in the metadata of images."""

from __future__ import annotations

_UNITS_UM = {
    "pm": 1e-6,
    "picometer": 1e-6,
    "å": 1e-4,
    "angstrom": 1e-4,
    "nm": 1e-3,
    "nanometer": 1e-3,
    "um": 1.0,
    "micron": 1.0,
    "micrometer": 1.0,
    "mm": 1e3,
    "millimeter": 1e3,
    "cm": 1e4,
    "centimeter": 1e4,
    "inch": 2.54e4,
    "m": 1e6,
    "meter": 1e6,
}


def unit_um(name: str) -> float | None:
    """Length of a unit in um; None if it is not a length ('pixel')."""
    # ImageJ writes the micro sign escaped; there are two characters for it.
    plain = name.replace("\\u00B5", "µ").strip().lower()
    plain = plain.replace("µ", "u").replace("μ", "u")
    one = plain.removesuffix("s").replace("metre", "meter")  # microns, nanometres
    return _UNITS_UM.get(plain, _UNITS_UM.get(one))
