"""Settings of how a mesh is fitted to an image; they need nothing of the engine."""

from __future__ import annotations

from itertools import pairwise
from math import inf
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from ..common.choices import (
    RENDERED_ACCURACY,
    DensityModel,
    DeviceChoice,
    Likelihood,
    StructureChoice,
)
from ..common.description import setting
from ..common.wrong_value import first_wrong_value
from ..errors import InputError

# Coarse-to-fine schedules. If the first blur is wider than the gap between objects, each attracts
# the other's mesh; so seeds that already lie on the membranes use the near one.
WIDE_LEVELS = (5.0, 3.2, 2.0, 1.35, 1.0)
NEAR_LEVELS = (1.0,)


# Names that the dial offers; it also takes a length.
SHAPE_CHOICES = ("quick", "normal", "careful")
_LENGTHS = {"nm": 1e-3, "um": 1.0, "µm": 1.0}


def asked_error(choice: str) -> float | None:
    """A length such as 20nm or 0.02um in um; None for a name. InputError for anything else."""
    if choice in SHAPE_CHOICES:
        return None
    for unit, size in _LENGTHS.items():
        try:
            found = float(choice.removesuffix(unit)) * size if choice.endswith(unit) else 0.0
        except ValueError:
            found = 0.0
        if 0 < found < inf:
            return found
    names = ", ".join(SHAPE_CHOICES)
    raise InputError(f"the shape error must be {names}, or a length such as 20nm, not '{choice}'")


class Settings(BaseModel):
    """Base of all settings: they cannot be changed, and unknown fields are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FitSettings(Settings):
    """How a mesh is fitted to an image."""

    model_config = ConfigDict(allow_inf_nan=False)

    shape_error: str = setting(
        "normal",
        title="shape",
        tip="how close to the true shape: quick, normal, careful, or a length such as 20nm; "
        "sets edges, flatness, accuracy, tolerance and trials unless these are given",
        known=SHAPE_CHOICES,
        metavar="E",
        advanced=True,
    )
    accuracy: float | None = setting(
        None,
        title="accuracy",
        tip="requested relative L2 error of the rendered image; 0 is the closed form; "
        "default: from the noise of the image",
        automatic="from the noise",
        live=True,
        ge=0,
        lt=1,
    )
    fit_psf: bool = setting(
        True,
        title="estimate the PSF from the image",
        tip="fit the PSF together with the shape; otherwise it is kept fixed",
        live=True,
    )
    density: DensityModel = setting(
        "smooth",
        title="brightness",
        tip="fluorophores per um^2: uniform, one value per interface, or varying smoothly "
        "over the surface, as far as the image supports it",
        words={"interface": "one for each wall"},
        live=True,
    )
    structure: StructureChoice = setting(
        "auto",
        title="what is labelled",
        tip="membranes, the interior of cells (nuclei, cytoplasm), or both; auto decides from the "
        "image, and also recognises dark cells in a brighter medium",
        words={"auto": "automatic"},
    )
    likelihood: Likelihood = setting(
        "poisson",
        title="noise",
        tip="noise model, by which voxels are weighted",
        words={
            "poisson": "photon noise",
            "gaussian": "the same everywhere",
            "paper": "as in the paper",
        },
        advanced=True,
        live=True,
    )
    levels: tuple[Annotated[float, Field(ge=1)], ...] | None = setting(
        None,
        title="levels",
        tip="blur of both images at each level, in widths of the PSF; the last is 1; default: "
        "near for seeds found in the image or made from labels, wide for all others",
        advanced=True,
        metavar="B",
    )
    smoothing: float = setting(
        1.0,
        title="smoothing of the steps",
        tip="lambda of the metric (I + lambda L)^-2 of the steps at the last level; grows "
        "with the blur; it affects how long a fit takes, not its result",
        advanced=True,
        live=True,
        ge=0,
    )
    as_in_the_paper: bool = setting(
        False,
        title="as in the paper",
        tip="fit as the paper does: AdamUniform with lambda 50, plain least squares at one "
        "scale without a prior, the PSF by Adam; for comparison",
        advanced=True,
    )
    bending: float = setting(
        9.0,
        title="weight of bending",
        tip="weight of the bending energy, the prior on shape (no unit); 0 switches it off; of 6, "
        "7.5, 9 and 12, 9 was near the best on test shapes and simulated foams, 6 on an embryo",
        advanced=True,
        live=True,
        ge=0,
    )
    reach: float = setting(
        3.5,
        title="reach",
        tip="only voxels within this many widths of the PSF from the surface are used",
        unit="widths",
        advanced=True,
        live=True,
        gt=0,
    )
    tolerance: float = setting(
        0.02,
        title="tolerance",
        tip="the fit ends when no part of the surface would still move by more than this, "
        "in widths of the PSF",
        unit="widths",
        advanced=True,
        live=True,
        gt=0,
    )
    remesh: bool = setting(
        True,
        title="keep triangles regular",
        tip="remesh when triangles become slivers or too long for a curved surface",
        advanced=True,
        live=True,
    )
    flatness: float | None = setting(
        None,
        title="flatness",
        tip="how far flat triangles may lie from a curved surface: where it is more curved, edges "
        "get shorter; default: from the noise of the image",
        automatic="from the noise",
        unit="um",
        advanced=True,
        live=True,
        gt=0,
    )
    collisions: bool = setting(
        True,
        title="surfaces never cross",
        tip="surfaces never cross themselves or each other: vertices stop before they would",
        advanced=True,
        live=True,
    )
    topology: bool = setting(
        True,
        title="cells may change neighbours",
        tip="cells may come to touch, part and exchange neighbours while the fit runs, and "
        "surfaces that cross at the start are repaired; needs collisions",
        advanced=True,
        live=True,
    )
    trials: bool = setting(
        True,
        title="try other neighbours at the end",
        tip="once the fit is at rest, try other neighbours where walls are small, gaps "
        "narrow or pieces tiny, and keep what explains the image better; fits of many cells take "
        "twice as long",
        advanced=True,
        live=True,
    )
    max_iterations: int = setting(
        3000,
        title="maximum iterations",
        tip="the fit gives up after this many iterations",
        advanced=True,
        live=True,
        metavar="N",
        ge=1,
    )
    device: DeviceChoice = setting(
        "auto",
        title="device",
        tip="where to compute: cpu, cuda (an NVIDIA GPU), or mps (the GPU of a Mac); auto takes "
        "the CPU, and an NVIDIA GPU for images of 100^3 voxels and more, where it is faster",
        words={"auto": "automatic", "cpu": "CPU", "cuda": "NVIDIA GPU", "mps": "GPU of a Mac"},
        advanced=True,
    )

    @property
    def image_accuracy(self) -> float:
        """``accuracy``, or if that is left to the noise, the default for renderings."""
        return RENDERED_ACCURACY if self.accuracy is None else self.accuracy

    @field_validator("shape_error", mode="before")
    @classmethod
    def _a_choice(cls, choice: Any) -> str:
        plain = str(choice).strip().lower().replace(" ", "")
        try:
            asked_error(plain)
        except InputError as error:
            raise ValueError(str(error)) from None
        return plain

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


def validated(model: type[Any], values: dict[str, Any]) -> Any:
    """A settings object from plain values; InputError in one line if they are wrong."""
    try:
        return model(**values)
    except ValidationError as error:
        raise InputError(first_wrong_value(error)) from None
