"""How well an image tells the parameters of a PSF that is fitted together with the shape."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import InputError
from ..fitting.state import FitState
from ..scene import Grid
from ..scene.effects import Effects
from .bead import physical_errors
from .fitted_scene import FittedScene
from .image_model import ImageModel
from .modes import ShapeModes, shape_modes

_ACCURACY = 1e-3  # of the image. Measured: half and twice change errors by 0.03 %
_MODES = 64  # of the shape of a single cell. Measured: half and twice change errors by 6 and 8 %
_LEAST_SHARE = 1e-9  # of the largest eigenvalue: less is rounding. Half and twice change nothing


def psf_standard_errors(
    state: FitState,
    grid: Grid,
    variance: float | NDArray,
    *,
    effects: Effects | None = None,
    modes: ShapeModes | None = None,
    counted: NDArray[np.bool_] | None = None,
) -> dict[str, float]:
    """Standard error of each fitted parameter of the PSF, in its unit.

    From the normal matrix of the weighted least squares (the Fisher information of Gaussian noise),
    in which what shines, the background and smooth changes of the shape are free too: what they can
    make up for, the image does not tell of the PSF.

    Parameters
    ----------
    state
        The last of a fit.
    grid
        Of the image.
    variance
        Of the noise of every voxel: one number, or (Z, Y, X).
    effects
        Those that were fitted with; held.
    modes
        Changes of shape that are free; by default the smoothest of each region.
    counted
        (Z, Y, X) bool: voxels that counted; by default all.

    Raises
    ------
    InputError
        If the PSF has no fitted parameter, or the variance is not positive.
    """
    if not len(state.optics.parameters()):
        raise InputError("this PSF has no fitted parameter")
    spread = np.broadcast_to(np.asarray(variance, np.float64), grid.shape)
    index = np.arange(spread.size) if counted is None else np.flatnonzero(counted)
    seen = spread.reshape(-1)[index]
    if not (seen > 0).all():
        raise InputError("the variance of the noise must be positive in every voxel that counts")
    scene = FittedScene.of_state(state, effects or Effects())
    model = ImageModel(scene, grid, index, _ACCURACY)
    psf = model.psf_columns(scene)
    linear = model.light_columns(scene, model.rendered(scene))
    single = len(state.mesh.region_ids()) == 1
    free = modes or shape_modes(state.mesh, count=_MODES if single else None)
    shape = model.shape_columns(scene, free)
    jacobian = np.concatenate([psf, linear, shape], 1) / np.sqrt(seen)[:, None]
    normal = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(normal)).clip(1e-300)
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), _LEAST_SHARE, hermitian=True)
    count = psf.shape[1]
    covariance = (inverse / np.outer(scale, scale))[:count, :count]
    return physical_errors(state.optics, torch.from_numpy(covariance))
