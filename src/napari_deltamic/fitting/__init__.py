"""From an image back to the mesh, the scene and the PSF."""

from .change import Change
from .fit import fit
from .scene_fit import SceneFit, fit_scene
from .state import FitState
from .voxel_ownership import counted_voxels

__all__ = ["Change", "FitState", "SceneFit", "counted_voxels", "fit", "fit_scene"]
