"""Cell shapes in 3D, as meshes, from a fluorescence stack, by inverting the microscope.

The engine: nothing here imports Qt or napari.
"""

from importlib.metadata import PackageNotFoundError, version

from . import _threads, fourier  # noqa: F401  (_threads before anything that loads torch)
from .errors import InputError
from .geometry import Mesh, load_mesh, save_mesh
from .inference import Change, FitState, fit
from .optics import GaussianPSF
from .scene import Grid, render

try:
    __version__ = version("napari-deltamic")
except PackageNotFoundError:  # running from a source tree that was never installed
    __version__ = "0+unknown"

__all__ = [
    "Change",
    "FitState",
    "GaussianPSF",
    "Grid",
    "InputError",
    "Mesh",
    "__version__",
    "fit",
    "fourier",
    "load_mesh",
    "render",
    "save_mesh",
]
