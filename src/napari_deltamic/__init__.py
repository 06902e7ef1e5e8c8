"""Cell shapes in 3D, as meshes, from a fluorescence stack, by inverting the microscope.

The engine: nothing here imports Qt or napari.
"""

from importlib.metadata import PackageNotFoundError, version

from . import _threads, fourier  # noqa: F401  (_threads before anything that loads torch)
from .errors import InputError
from .geometry import Mesh, load_mesh, save_mesh
from .inference import Change, FitState, fit
from .optics import (
    ConfocalPSF,
    GaussianMixturePSF,
    GaussianPSF,
    GibsonLanniPSF,
    LightSheetPSF,
    MeasuredPSF,
    PupilPSF,
    ScalarPSF,
    VectorialPSF,
    microscope,
)
from .scene import (
    Filament,
    Grid,
    Points,
    Scene,
    Solid,
    Surface,
    render,
    render_scene,
    simulate,
)

try:
    __version__ = version("napari-deltamic")
except PackageNotFoundError:  # running from a source tree that was never installed
    __version__ = "0+unknown"

__all__ = [
    "Change",
    "ConfocalPSF",
    "Filament",
    "FitState",
    "GaussianMixturePSF",
    "GaussianPSF",
    "GibsonLanniPSF",
    "Grid",
    "InputError",
    "LightSheetPSF",
    "MeasuredPSF",
    "Mesh",
    "Points",
    "PupilPSF",
    "ScalarPSF",
    "Scene",
    "Solid",
    "Surface",
    "VectorialPSF",
    "__version__",
    "fit",
    "fourier",
    "load_mesh",
    "microscope",
    "render",
    "render_scene",
    "save_mesh",
    "simulate",
]
