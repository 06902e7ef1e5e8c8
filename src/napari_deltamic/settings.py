"""The one settings object: what a command line parses, a widget shows and ``run.toml`` holds.

Lengths are um, arrays Z, Y, X. Every field says in its description what it does, so that help texts
and tooltips need no second source.
"""

from __future__ import annotations

import json
import tomllib
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_serializer,
    field_validator,
    model_validator,
)

from .errors import InputError
from .fourier.devices import DeviceChoice
from .optics_settings import OpticsSettings
from .scene.effects import KINDS, Effects

Likelihood = Literal["poisson", "gaussian", "paper"]
DensityModel = Literal["uniform", "interface", "smooth"]
Triple = tuple[float, float, float]
# Coarse-to-fine schedules. A first blur wider than the gap between objects makes them attract each
# other's mesh, so seeds that already lie on the membranes start near.
WIDE_LEVELS = (5.0, 3.2, 2.0, 1.35, 1.0)
NEAR_LEVELS = (1.5, 1.0)
EFFECTS: tuple[str, ...] = tuple(KINDS)


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class FitSettings(_Model):
    """How a mesh is fitted to an image."""

    model_config = ConfigDict(allow_inf_nan=False)

    accuracy: Annotated[float, Field(ge=0, lt=1)] | None = Field(
        default=None,
        description="requested relative L2 error of the rendered image; 0 is the closed form; "
        "where not given, it follows from the noise of the image",
    )
    fit_psf: bool = Field(default=False, description="also fit the widths of the PSF")
    density: DensityModel = Field(
        default="uniform",
        description="fluorophores per um^2: the same everywhere, one per interface, or smooth over "
        "the surface",
    )
    likelihood: Likelihood = Field(default="poisson", description="how voxels are weighted")
    levels: tuple[Annotated[float, Field(ge=1)], ...] | None = Field(
        default=None,
        description="blur of both images at each level, in widths of the PSF; the last is 1; "
        "None: wide for seeds of any kind, near for seeds taken from the image or from labels",
    )
    smoothing: Annotated[float, Field(ge=0)] | None = Field(
        default=None,
        description="lambda of the preconditioner at the last level; grows with the blur; None: "
        "from the noise of the image",
    )
    step: Annotated[float, Field(gt=0)] = Field(
        default=0.3, description="first step of a level, in widths of the blurred PSF"
    )
    reach: Annotated[float, Field(gt=0)] = Field(
        default=3.5, description="voxels count up to this many widths from the surface"
    )
    tolerance: Annotated[float, Field(gt=0)] = Field(
        default=1e-2,
        description="the last level ends when its loss falls by less than this over a dozen "
        "iterations (or its vertices lie still)",
    )
    remesh: bool = Field(
        default=True,
        description="remesh where triangles become slivers, at the edge length of the start",
    )
    collisions: bool = Field(
        default=True,
        description="no surface comes to cross itself or another: vertices stop before that",
    )
    topology: bool = Field(
        default=True,
        description="cells may come to touch, part and exchange neighbours while the fit runs, and "
        "surfaces that cross at the start are repaired; needs collisions",
    )
    max_iterations: Annotated[int, Field(ge=1)] = Field(
        default=3000, description="the fit gives up after this many iterations"
    )
    device: DeviceChoice = Field(
        default="auto",
        description="what computes: cpu, cuda (an NVIDIA GPU), mps (the GPU of a Mac); auto: an "
        "NVIDIA GPU that can be used, else the CPU",
    )

    @property
    def image_accuracy(self) -> float:
        """``accuracy``, or that of a rendering without an image where it is left to the noise."""
        return 1e-3 if self.accuracy is None else self.accuracy

    @field_validator("accuracy", mode="before")
    @classmethod
    def _auto(cls, accuracy: Any) -> Any:
        return None if accuracy == "auto" else accuracy

    @field_validator("levels")
    @classmethod
    def _ends_at_one(cls, levels: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if levels is None:
            return None
        if not levels or levels[-1] != 1 or any(a <= b for a, b in pairwise(levels)):
            raise ValueError("levels must decrease and end at 1")
        return levels


class SceneSettings(_Model):
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


class RunSettings(_Model):
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
            return validated(cls, tomllib.loads(Path(path).read_text(encoding="utf-8")))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(f"cannot read settings from {path}: {error}") from None


def validated(model: type[Any], values: dict[str, Any]) -> Any:
    """A settings object from plain values; InputError in one line where they are wrong."""
    try:
        return model(**values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"])
        reason = str(first["msg"]).removeprefix("Value error, ")
        raise InputError(f"{where}: {reason}" if where else reason) from None


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
