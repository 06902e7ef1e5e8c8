"""Whether a PSF is too narrow for the voxels to determine it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class NarrowRules:
    """Numbers that decide whether a PSF is too narrow.

    Attributes
    ----------
    voxels
        Standard deviation of the narrowest PSF that an image can determine, in voxels. By
        definition: at the largest wavenumber of voxels its OTF is still 0.17, so that most of the
        fall of a narrower one lies beyond.
    """

    voxels: float = 0.6


RULES = NarrowRules()


def narrower_than_told(sigma_um: Sequence[float], voxel_size: Sequence[float]) -> bool:
    """Whether a PSF is narrower, along any axis, than an image of such voxels can determine.

    Parameters
    ----------
    sigma_um, voxel_size
        um, Z Y X.
    """
    return any(s < RULES.voxels * d for s, d in zip(sigma_um, voxel_size, strict=True))
