"""The PSF as settings: what ``run.toml`` holds and the command line parses of it.

The engine is loaded where a PSF is built.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ..common.choices import Bead, Modality, PSFModel
from ..common.reading import read_text, toml_values
from ..errors import InputError

if TYPE_CHECKING:
    from ..optics import Optics, Parameter

Triple = tuple[float, float, float]


class _Optics(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def moved(self, parameters: Sequence[Parameter]) -> Self:
        """The settings of the same PSF with other values of its parameters."""
        return self


class GaussianOptics(_Optics):
    """A Gaussian PSF."""

    kind: Literal["gaussian"] = "gaussian"
    sigma: Triple | None = Field(default=None, description="um, Z Y X")
    covariance: tuple[Triple, Triple, Triple] | None = Field(default=None, description="um^2")

    def build(self) -> Optics:
        """The PSF. InputError where a number cannot be."""
        from ..optics import GaussianPSF

        return GaussianPSF(self.sigma, None if self.covariance is None else list(self.covariance))


class MixtureOptics(_Optics):
    """Two to four Gaussians of one centre."""

    kind: Literal["mixture"] = "mixture"
    sigmas: tuple[Triple, ...] = Field(description="um, Z Y X, of each")
    masses: tuple[float, ...] = Field(description="of each, in any unit")
    fitted: tuple[str, ...] | None = Field(default=None, description="what --fit-psf moves")

    def build(self) -> Optics:
        """The PSF. InputError where a number cannot be."""
        from ..optics import GaussianMixturePSF

        return GaussianMixturePSF(self.sigmas, self.masses, fitted=self.fitted)

    def moved(self, parameters: Sequence[Parameter]) -> Self:
        """The settings of the same PSF with other values of its parameters."""
        masses = [p.value for p in parameters if p.name.startswith("mass")]
        widths = [p.value for p in parameters if not p.name.startswith("mass")]
        sigmas = tuple(tuple(widths[k : k + 3]) for k in range(0, len(widths), 3))
        return self.model_copy(update={"sigmas": sigmas, "masses": (1.0, *masses)})


class MicroscopeOptics(_Optics):
    """A PSF from the numbers on the objective; see :func:`napari_deltamic.microscope`."""

    kind: Literal["microscope"] = "microscope"
    modality: Modality = Field(default="widefield", description="how light is seen")
    na: float = Field(description="numerical aperture")
    wavelength: float = Field(description="um, of the emitted light")
    immersion: float | str = Field(
        default="oil", description="air, water, silicone, glycerol, oil, or a refractive index"
    )
    excitation: float | None = Field(default=None, description="um, of the light that excites")
    pinhole: float = Field(default=1.0, description="diameter in Airy units")
    sheet: float | None = Field(
        default=None, description="um: full width at half maximum of the light sheet"
    )
    sample_index: float | None = Field(default=None, description="refractive index of the sample")
    depth: float = Field(default=0.0, description="um, of the structure below the coverslip")
    zernike: dict[int, float] | None = Field(
        default=None, description="Noll index -> phase, rad; for the model 'pupil'"
    )
    model: PSFModel = Field(default="vectorial", description="how the PSF is computed")
    fitted: tuple[str, ...] | None = Field(default=None, description="what --fit-psf moves")

    def build(self) -> Optics:
        """The PSF. InputError where a number cannot be."""
        from ..optics import microscope

        return microscope(**self.model_dump(exclude={"kind"}))

    def moved(self, parameters: Sequence[Parameter]) -> Self:
        """The settings of the same PSF with other values of its parameters."""
        before = {p.name: p.value for p in self.build().described()}
        changed = {p.name: p.value for p in parameters if p.value != before.get(p.name)}
        if "index" in changed:
            changed["immersion"] = changed.pop("index")
        found: dict[str, Any] = {k: v for k, v in changed.items() if k in type(self).model_fields}
        phases = {int(k[1:]): v for k, v in changed.items() if k[0] == "z" and k[1:].isdigit()}
        if phases:
            found["zernike"] = {**(self.zernike or {}), **phases}
        return self.model_copy(update=found)


class MeasuredOptics(_Optics):
    """The PSF that the image of a bead shows."""

    kind: Literal["measured"] = "measured"
    file: str = Field(description="image of one bead")
    voxel_size: Triple | None = Field(default=None, description="um, Z Y X; None: as the file says")
    bead_diameter: float = Field(default=0.0, description="um")
    bead: Bead = Field(default="solid", description="how it is stained")

    def build(self) -> Optics:
        """The PSF. InputError where the file cannot be one."""
        from ..images.stacks import read_image
        from ..optics import MeasuredPSF

        image, found = read_image(self.file)
        size = self.voxel_size or found
        if size is None:
            raise InputError(
                f"{Path(self.file).name} does not say its voxel size: give it with the PSF (um)"
            )
        try:
            return MeasuredPSF(image, size, self.bead_diameter, self.bead)
        except InputError as error:
            raise InputError(f"{self.file}: {error}") from None


OpticsSettings = Annotated[
    GaussianOptics | MixtureOptics | MicroscopeOptics | MeasuredOptics,
    Field(discriminator="kind"),
]
_ADAPTER: TypeAdapter[Any] = TypeAdapter(OpticsSettings)


def optics_from_values(values: dict[str, Any]) -> Any:
    """Settings of a PSF from plain values; InputError in one line where they are wrong."""
    try:
        return _ADAPTER.validate_python(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"][1:])
        reason = str(first["msg"]).removeprefix("Value error, ")
        raise InputError(f"optics{'.' if where else ''}{where}: {reason}") from None


def optics_from_toml(path: str | Path) -> Any:
    """Settings of a PSF from a TOML file; InputError says what is wrong."""
    try:
        values = toml_values(read_text(path))
    except InputError as error:
        raise InputError(f"cannot read optics from {path}: {error}") from None
    found = optics_from_values(values)
    if isinstance(found, MeasuredOptics):
        # A file beside the settings is named as from there.
        found = found.model_copy(update={"file": str((Path(path).parent / found.file).absolute())})
    return found
