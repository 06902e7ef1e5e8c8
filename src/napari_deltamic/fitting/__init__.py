"""From an image back to the mesh and the PSF."""

from .change import Change
from .fit import fit
from .state import FitState
from .voxel_ownership import counted_voxels

__all__ = ["Change", "FitState", "counted_voxels", "fit"]
