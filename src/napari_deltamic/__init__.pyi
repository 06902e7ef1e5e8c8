from . import fourier
from .common.version import __version__
from .errors import InputError
from .fitting import Change, FitState, SceneFit, fit, fit_scene
from .geometry import Mesh, load_mesh, save_mesh
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
    "SceneFit",
    "Solid",
    "Surface",
    "VectorialPSF",
    "__version__",
    "fit",
    "fit_scene",
    "fourier",
    "load_mesh",
    "microscope",
    "render",
    "render_scene",
    "save_mesh",
    "simulate",
]
