"""How well an image tells the parameters of a PSF that is fitted together with the shape."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from napari_deltamic.evidence.fitted_scene import FittedScene
from napari_deltamic.evidence.image_model import ImageModel
from napari_deltamic.evidence.modes import shape_modes
from napari_deltamic.fitting.model.state import FitState
from napari_deltamic.scene import Grid
from napari_deltamic.scene.effects import Effects

from .bead_fit import physical_errors

_ACCURACY = 1e-3  # of the image. Measured: half and twice change errors by 0.03 %
_MODES = 64  # of the shape of a single cell. Measured: half and twice change errors by 6 and 8 %
_LEAST_SHARE = 1e-9  # of the largest eigenvalue: less is rounding. Half and twice change nothing


def psf_standard_errors(state: FitState, grid: Grid, variance: NDArray) -> dict[str, float]:
    """Standard error of each fitted parameter of the PSF, in its unit.

    From the normal matrix of the weighted least squares (the Fisher information of Gaussian noise),
    in which what shines, the background and smooth changes of the shape are free too: what they can
    make up for, the image does not tell of the PSF.

    Parameters
    ----------
    state
        The last of a fit of one cell without effects.
    grid
        Of the image.
    variance
        (Z, Y, X) of the noise, positive.
    """
    scene = FittedScene.of_state(state, Effects())
    model = ImageModel(scene, grid, np.arange(variance.size), _ACCURACY)
    psf = model.psf_columns(scene)
    linear = model.light_columns(scene, model.rendered(scene))
    shape = model.shape_columns(scene, shape_modes(state.mesh, count=_MODES))
    jacobian = np.concatenate([psf, linear, shape], 1) / np.sqrt(variance.reshape(-1, 1))
    normal = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(normal)).clip(1e-300)
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), _LEAST_SHARE, hermitian=True)
    count = psf.shape[1]
    covariance = (inverse / np.outer(scale, scale))[:count, :count]
    return physical_errors(state.optics, torch.from_numpy(covariance))
