"""From an image back to the mesh, the scene and the PSF."""

from .fit import fit
from .model.change import Change
from .model.state import FitState
from .scene_fit import SceneFit, fit_scene
from .voxels.voxel_ownership import counted_voxels

__all__ = ["Change", "FitState", "SceneFit", "counted_voxels", "fit", "fit_scene"]
