"""A fit of a few cells of an image: what is tried of the PSF there holds for all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from .crop import RULES, crop_of
from .fit_objective import Terms
from .fitted import Fitted


def few_cells(terms: Terms, fitted: Fitted, image: Tensor) -> tuple[Terms, Fitted, Tensor]:
    """The same of the cells in the middle and the piece of the image around them.

    Neighbours whose light reaches there stay as they are; a wall to one that is left out is too far
    away for its light to matter. All of it where there are few cells.

    Parameters
    ----------
    terms, fitted
        Of a fit at its last level.
    image
        (Z, Y, X) of all cells.
    """
    level, mesh = terms.level, fitted.mesh
    if len(mesh.region_ids()) <= RULES.cells:
        return terms, fitted, image
    counted = level.counted.cpu().numpy()
    width = np.asarray(fitted.optics.sigma_um)
    crop = crop_of(counted, level.grid, mesh, None, width)
    inside = torch.zeros(crop.grid.shape, dtype=torch.bool, device=level.device)
    inside.view(-1)[torch.from_numpy(crop.index).to(level.device)] = True
    piece = level.piece(crop.grid, crop.box, inside)
    shape = fitted.shape.part(crop.mesh, crop.faces)
    others = crop.mesh.faces[~np.isin(crop.mesh.regions, crop.cells).any(axis=1)]
    pinned = shape.pinned.copy()
    pinned[others] = True
    few = fitted.retriangulated(shape.with_pins(pinned))
    return replace(terms, level=piece), few, image[crop.box]
