"""Settings of an image and its PSF; they need nothing of the engine."""

from __future__ import annotations

from math import isfinite
from typing import Any, Self

from pydantic import field_serializer, field_validator, model_validator

from ..common.description import setting
from ..common.triple import Triple
from .fit_settings import Settings
from .optics_settings import OpticsSettings

# The PSF where neither user nor image tells: 2.8 voxels wide at half its maximum; chosen, as
# microscopes are set to two to three (Nyquist's rule).
SIGMA_IN_VOXELS = 1.2


class SceneFields(Settings):
    """How the image was formed, except for the effects, which need the engine."""

    voxel_size: Triple = setting(
        title="voxel size", tip="size of a voxel, Z Y X; default: from the image file", unit="um"
    )
    origin: Triple = setting(
        (0.0, 0.0, 0.0),
        title="origin",
        tip="centre of the first voxel, Z Y X",
        unit="um",
        flag=None,
        advanced=True,
    )
    sigma: Triple | None = setting(
        None,
        title="widths of the PSF",
        tip="standard deviations of the PSF, Z Y X; default: estimated from the image by a fit, "
        "if possible, else 1.2 voxels",
        unit="um",
        live=True,
    )
    optics: OpticsSettings | None = setting(
        None,
        title="PSF",
        tip="the PSF, if it is not the Gaussian of sigma: a microscope, a measured PSF or "
        "a mixture; a table with its kind",
        metavar="FILE.toml",
        live=True,
    )
    effects: Any = setting(
        None,
        title="corrections",
        tip="imaging effects, optional parts of image formation: names, or a table for each",
        live=True,
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
    def _one_psf(self) -> Self:
        if self.sigma is not None and self.optics is not None:
            raise ValueError("sigma and optics both say what the PSF is: give one of them")
        return self

    @field_serializer("optics")
    def _given(self, optics: Any) -> dict[str, Any] | None:
        return None if optics is None else optics.model_dump(exclude_none=True)


class RunFields(Settings):
    """What is fitted to what."""

    image: str = setting(title="image", tip="image file, .tif, .npy or .zarr", flag=None)
    channel: str | None = setting(
        None,
        title="channel",
        tip="which channel to use: its number, counting from 1, or its name in the file; "
        "needed only if the image has more than one",
        metavar="N",
        automatic="the only one",
    )
    seeds: str = setting(
        title="cells",
        tip="where the fit starts: a mesh, a label image, a CSV (z,y,x or z,y,x,radius; um; or a "
        "Points layer that napari saved), or auto, which looks for the cells of the image (auto:12 "
        "for cells of about 12 um; auto@2 where nuclei in channel 2 mark them)",
        metavar="FILE",
    )

    @field_validator("channel", mode="before")
    @classmethod
    def _counted_from_one(cls, channel: Any) -> Any:
        if isinstance(channel, bool) or not isinstance(channel, int | str):
            return channel
        text = str(channel).strip()
        if not text:
            raise ValueError("a number, from 1, or a name is needed")
        if text.lstrip("+-").isdecimal() and int(text) < 1:
            raise ValueError(f"the first is 1, as in Fiji: there is no channel {text}")
        return text
