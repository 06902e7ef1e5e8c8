"""Whether a PSF is narrower than voxels can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class NarrowRules:
    """When a PSF is too narrow.

    Attributes
    ----------
    voxels
        Standard deviation of the narrowest PSF that an image can tell. By definition: at the
        largest wavenumber of voxels its OTF is 0.17 still, so that most of the fall of a narrower
        one lies beyond.
    """

    voxels: float = 0.6


RULES = NarrowRules()


def narrower_than_told(sigma_um: Sequence[float], voxel_size: Sequence[float]) -> bool:
    """Whether a PSF is narrower, along any axis, than an image of such voxels can tell.

    Parameters
    ----------
    sigma_um, voxel_size
        um, Z Y X.
    """
    return any(s < RULES.voxels * d for s, d in zip(sigma_um, voxel_size, strict=True))
