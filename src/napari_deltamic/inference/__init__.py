"""From an image back to the mesh and the PSF."""

from .fit import fit
from .state import FitState
from .territory import counted_voxels

__all__ = ["FitState", "counted_voxels", "fit"]
