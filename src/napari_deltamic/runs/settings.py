"""The one settings object: what a command line parses, a widget shows and ``run.toml`` holds.

Lengths are um, arrays Z, Y, X. Every field says in its description what it does, so that help texts
and tooltips need no second source.
"""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path
from typing import Any

from pydantic import Field, field_serializer, field_validator, model_validator

from ..common.reading import read_text, toml_values
from ..errors import InputError
from ..scene.effects import Effects
from .fit_settings import NEAR_LEVELS as NEAR_LEVELS
from .fit_settings import WIDE_LEVELS as WIDE_LEVELS
from .fit_settings import FitSettings as FitSettings
from .fit_settings import Settings
from .fit_settings import validated as validated
from .optics_settings import OpticsSettings

Triple = tuple[float, float, float]


class SceneSettings(Settings):
    """How the image was formed."""

    voxel_size: Triple = Field(description="um, Z Y X")
    origin: Triple = Field(
        default=(0.0, 0.0, 0.0), description="centre of the first voxel, um, Z Y X"
    )
    sigma: Triple | None = Field(
        default=None,
        description="standard deviations of the PSF, um, Z Y X; None: from the voxel size",
    )
    optics: OpticsSettings | None = Field(
        default=None,
        description="the PSF, where it is not the Gaussian of sigma: a microscope, a measured PSF, "
        "a mixture; a table with its kind",
    )
    effects: Effects = Field(
        default=Effects(), description="optional parts of image formation; names, or a table each"
    )

    @field_validator("voxel_size")
    @classmethod
    def _positive_voxels(cls, v: Triple) -> Triple:
        if not all(isfinite(d) and d > 0 for d in v):
            raise ValueError(f"voxel size must be three positive numbers (um), not {v}")
        return v

    @field_validator("origin")
    @classmethod
    def _finite_origin(cls, v: Triple) -> Triple:
        if not all(isfinite(o) for o in v):
            raise ValueError(f"origin must be three finite numbers (um), not {v}")
        return v

    @field_validator("sigma")
    @classmethod
    def _positive_sigma(cls, v: Triple | None) -> Triple | None:
        if v is not None and not all(isfinite(d) and d > 0 for d in v):
            raise ValueError(f"sigma must be positive (um), not {v}")
        return v

    @model_validator(mode="after")
    def _one_psf(self) -> SceneSettings:
        if self.sigma is not None and self.optics is not None:
            raise ValueError("sigma and optics both say what the PSF is: give one of them")
        return self

    @field_serializer("optics")
    def _given(self, optics: Any) -> dict[str, Any] | None:
        return None if optics is None else optics.model_dump(exclude_none=True)

    @field_serializer("effects")
    def _present(self, effects: Effects) -> dict[str, Any]:
        return effects.to_dict()


class RunSettings(Settings):
    """A whole run: what is fitted to what, and how. ``run.toml`` holds one."""

    image: str = Field(description="image file")
    seeds: str = Field(description="mesh file, label image, or CSV of points")
    scene: SceneSettings
    fit: FitSettings = FitSettings()

    def to_toml(self) -> str:
        """The settings as a TOML document."""
        lines: list[tuple[str, Any]] = []
        tables: list[tuple[str, dict[str, Any]]] = []
        for name, value in self.model_dump().items():
            if isinstance(value, dict):
                tables.append((name, value))
            else:
                lines.append((name, value))
        text = "".join(f"{k} = {_toml(v)}\n" for k, v in lines)
        for name, table in tables:
            text += f"\n[{name}]\n"
            text += "".join(f"{k} = {_toml(v)}\n" for k, v in table.items() if v is not None)
        return text

    @classmethod
    def from_toml(cls, path: str | Path) -> RunSettings:
        """Read a document written by :meth:`to_toml`; InputError names what is wrong."""
        try:
            values = toml_values(read_text(path))
        except InputError as error:
            raise InputError(f"cannot read settings from {path}: {error}") from None
        return validated(cls, values)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        if not value.isprintable() and any("\ud800" <= c <= "\udfff" for c in value):
            raise InputError(f"{value!r} is not a name that a text file can hold: rename it")
        # TOML's basic strings escape as JSON's do, and also the delete character.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml(str(k))} = {_toml(v)}" for k, v in value.items()) + "}"
    return "[" + ", ".join(_toml(v) for v in value) + "]"
