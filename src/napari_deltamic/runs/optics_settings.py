"""The PSF as settings, as ``run.toml`` holds them and the command line parses them.

The engine is loaded only when a PSF is built.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ..common.choices import IMMERSIONS, Bead, Modality, PSFModel
from ..common.description import setting
from ..common.reading import read_text, reading, toml_values
from ..common.triple import Triple
from ..common.wrong_value import first_wrong_value
from ..errors import InputError

if TYPE_CHECKING:
    from ..optics import Optics, Parameter


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
        """The PSF. InputError if a number is not possible."""
        from ..optics import GaussianPSF

        return GaussianPSF(self.sigma, None if self.covariance is None else list(self.covariance))


class MixtureOptics(_Optics):
    """A PSF of two to four Gaussians with one centre."""

    kind: Literal["mixture"] = "mixture"
    sigmas: tuple[Triple, ...] = Field(description="um, Z Y X, of each")
    masses: tuple[float, ...] = Field(description="of each, in any unit")
    fitted: tuple[str, ...] | None = Field(default=None, description="what --fit-psf moves")

    def build(self) -> Optics:
        """The PSF. InputError if a number is not possible."""
        from ..optics import GaussianMixturePSF

        return GaussianMixturePSF(self.sigmas, self.masses, fitted=self.fitted)

    def moved(self, parameters: Sequence[Parameter]) -> Self:
        """The settings of the same PSF with other values of its parameters."""
        masses = [p.value for p in parameters if p.name.startswith("mass")]
        widths = [p.value for p in parameters if not p.name.startswith("mass")]
        sigmas = tuple(tuple(widths[k : k + 3]) for k in range(0, len(widths), 3))
        return self.model_copy(update={"sigmas": sigmas, "masses": (1.0, *masses)})


class MicroscopeOptics(_Optics):
    """A PSF computed from the microscope's data; see :func:`napari_deltamic.microscope`."""

    kind: Literal["microscope"] = "microscope"
    modality: Modality = setting("widefield", title="modality", tip="type of microscope")
    na: float = setting(title="NA", tip="numerical aperture", metavar="NA", start=1.2, step=0.05)
    wavelength: float = setting(
        title="emission",
        tip="wavelength of the emitted light",
        unit="um",
        metavar="WAVELENGTH",
        start=0.52,
        step=0.01,
    )
    immersion: float | str = setting(
        "oil",
        title="immersion",
        tip=f"{', '.join(IMMERSIONS)}, or a refractive index",
        known=IMMERSIONS,
    )
    excitation: float | None = setting(
        None,
        title="excitation",
        tip="wavelength of the excitation light",
        unit="um",
        step=0.01,
    )
    pinhole: float = setting(
        1.0, title="pinhole", tip="diameter in Airy units", unit="Airy units", step=0.1
    )
    sheet: float | None = setting(
        None,
        title="sheet FWHM",
        tip="full width at half maximum of the light sheet",
        unit="um",
        start=2.0,
        step=0.1,
    )
    sample_index: float | None = setting(
        None,
        title="sample index",
        tip="refractive index of the sample",
        step=0.005,
        automatic="as the immersion",
        advanced=True,
    )
    depth: float = setting(
        0.0,
        title="depth",
        tip="depth of the structure below the coverslip",
        unit="um",
        step=1.0,
        advanced=True,
    )
    zernike: dict[int, float] | None = Field(
        default=None, description="Noll index -> phase, rad; for the model 'pupil'"
    )
    spherical: float = setting(
        0.0,
        title="spherical aberration",
        tip="root mean square over the pupil, of either sign; for the model 'scalar'",
        unit="rad",
        ge=-10,
        le=10,
        step=0.1,
        advanced=True,
    )
    model: PSFModel = setting(
        "vectorial",
        title="model",
        tip="how the PSF is computed",
        flag="--psf-model",
        advanced=True,
    )
    fitted: tuple[str, ...] | None = Field(default=None, description="what --fit-psf moves")

    def build(self) -> Optics:
        """The PSF. InputError if a number is not possible."""
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
    """A PSF measured as the image of a bead."""

    kind: Literal["measured"] = "measured"
    file: str = setting(
        title="bead", tip="image of one bead, .tif or .npy", flag="--psf", metavar="FILE"
    )
    voxel_size: Triple | None = setting(
        None,
        title="voxel size",
        tip="voxel size of the image of the bead, Z Y X; default: from its file",
        unit="um",
        flag="--psf-voxel-size",
    )
    bead_diameter: float = setting(
        0.0,
        title="diameter",
        tip="diameter of the bead; 0 for one much smaller than the PSF",
        unit="um",
        metavar="D",
        step=0.05,
    )
    bead: Bead = setting("solid", title="stained", tip="stained throughout, or on its surface")

    def build(self) -> Optics:
        """The PSF. InputError if the file cannot be read, or does not show one."""
        from ..images.stacks import read_image
        from ..optics import MeasuredPSF

        image, found = read_image(self.file)
        size = self.voxel_size or found
        if size is None:
            raise InputError(
                f"{Path(self.file).name} does not say its voxel size: give that of the bead "
                "(--psf-voxel-size Z Y X, um)"
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
    """Settings of a PSF from plain values; InputError in one line if they are wrong."""
    try:
        return _ADAPTER.validate_python(values)
    except ValidationError as error:
        raise InputError(f"optics: {first_wrong_value(error, skip=1)}") from None


def optics_from_toml(path: str | Path) -> Any:
    """Settings of a PSF from a TOML file; InputError says what is wrong."""
    with reading("optics", path):
        found = optics_from_values(toml_values(read_text(path)))
    if isinstance(found, MeasuredOptics):
        # Its path is relative to the folder of the settings file.
        found = found.model_copy(update={"file": str((Path(path).parent / found.file).absolute())})
    return found
