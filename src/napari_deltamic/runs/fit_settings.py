"""How a mesh is fitted to an image: the settings that need nothing of the engine."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from ..common.choices import DensityModel, DeviceChoice, Likelihood
from ..errors import InputError

# Coarse-to-fine schedules. A first blur wider than the gap between objects makes them attract each
# other's mesh, so seeds that already lie on the membranes start near.
WIDE_LEVELS = (5.0, 3.2, 2.0, 1.35, 1.0)
NEAR_LEVELS = (1.0,)


class Settings(BaseModel):
    """Settings cannot change, and have no fields but their own."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FitSettings(Settings):
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
    smoothing: Annotated[float, Field(ge=0)] = Field(
        default=1.0,
        description="lambda of the metric (I + lambda L)^-2 of the steps at the last level; grows "
        "with the blur; it changes how fast a fit is, not where it ends",
    )
    as_in_the_paper: bool = Field(
        default=False,
        description="fit as the paper does: AdamUniform with lambda 50, plain least squares at one "
        "scale without a prior, the PSF by Adam; to compare with",
    )
    bending: Annotated[float, Field(ge=0)] = Field(
        default=9.0,
        description="weight of the bending energy, a prior on shape without unit; of 6, 7.5, 9 "
        "and 12, 9 was near the best on cow, fish and foams; an embryo wants 6; 0 is none",
    )
    reach: Annotated[float, Field(gt=0)] = Field(
        default=3.5, description="voxels count up to this many widths from the surface"
    )
    tolerance: Annotated[float, Field(gt=0)] = Field(
        default=0.02,
        description="the fit ends when no place of the surface would still move by more than this, "
        "in widths of the PSF",
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

    @model_validator(mode="before")
    @classmethod
    def _of_the_first_version(cls, values: Any) -> Any:
        """Files of the first version have a first step, which is found by itself now, and may have
        no lambda, which followed from the noise."""
        if isinstance(values, dict):
            gone = {"step"} | ({"smoothing"} if values.get("smoothing", 0) is None else set())
            values = {name: value for name, value in values.items() if name not in gone}
        return values

    @field_validator("levels")
    @classmethod
    def _ends_at_one(cls, levels: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if levels is None:
            return None
        if not levels or levels[-1] != 1 or any(a <= b for a, b in pairwise(levels)):
            raise ValueError("levels must decrease and end at 1")
        return levels


def validated(model: type[Any], values: dict[str, Any]) -> Any:
    """A settings object from plain values; InputError in one line where they are wrong."""
    try:
        return model(**values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"])
        reason = str(first["msg"]).removeprefix("Value error, ")
        raise InputError(f"{where}: {reason}" if where else reason) from None
