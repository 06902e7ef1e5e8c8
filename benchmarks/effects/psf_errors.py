"""How well an image tells the parameters of a PSF that is fitted together with the shape."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from napari_deltamic.evidence.crop import Crop
from napari_deltamic.evidence.modes import shape_modes
from napari_deltamic.evidence.part_model import PartModel
from napari_deltamic.fitting.model.state import FitState
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Grid

from .bead_fit import physical_errors

_MODES = 64  # of the shape of a single cell. Measured: half and twice change errors by 6 and 8 %
_LEAST_SHARE = 1e-9  # of the largest eigenvalue: less is rounding. Half and twice change nothing


def psf_standard_errors(
    image: NDArray, state: FitState, grid: Grid, variance: NDArray
) -> dict[str, float]:
    """Standard error of each fitted parameter of the PSF, in its unit.

    From the normal matrix of the weighted least squares (the Fisher information of Gaussian noise),
    in which what shines, the background and smooth changes of the shape are free too: what they can
    make up for, the image does not tell of the PSF.

    Parameters
    ----------
    image, grid
        (Z, Y, X) what was fitted, and where its voxels lie.
    state
        The last of a fit of one cell without effects.
    variance
        (Z, Y, X) of the noise, positive.
    """
    box = slice(None), slice(None), slice(None)
    mesh, cells = state.mesh, state.mesh.region_ids()
    part = Crop(grid, box, mesh, None, cells[cells != 0], np.arange(variance.size), 1)
    settings = FitSettings(fit_psf=True, density="uniform")
    model = PartModel(part, image, grid, lambda _: variance.reshape(-1), settings)
    model.modes = shape_modes(mesh, count=_MODES)
    jacobian = model.begun(state).linearised.columns
    normal = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(normal)).clip(1e-300)
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), _LEAST_SHARE, hermitian=True)
    count = len(state.optics.parameters())
    covariance = (inverse / np.outer(scale, scale))[-count:, -count:]
    return physical_errors(state.optics, torch.from_numpy(covariance))
