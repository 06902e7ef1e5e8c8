"""AdamUniform: Adam whose second moment is one number for each connected piece of the mesh."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

# Of the moments of before, at every step. Chosen, not measured: Adam's own are 0.9 and 0.999.
_KEPT = (0.9, 0.99)


class AdamUniform:
    """Steps of one size for all vertices of a piece, so that the direction field stays smooth.

    From Nicolet et al. 2021 (see :class:`Preconditioner`), who take the largest squared gradient of
    the whole mesh; here each connected piece has its own, so that a large cell does not hold back a
    small one. The moments live on the device of the gradients.

    Parameters
    ----------
    pieces
        (V,) piece of each vertex.
    columns
        Numbers per vertex.
    """

    def __init__(self, pieces: np.ndarray, columns: int) -> None:
        self.count = 0
        self._pieces = torch.as_tensor(pieces.astype(np.int64))
        self.first = torch.zeros(len(pieces), columns, dtype=torch.float64)
        number = int(pieces.max()) + 1 if len(pieces) else 0
        self.second = torch.zeros(number, dtype=torch.float64)

    def step(self, gradient: Tensor) -> Tensor:
        """(V, C) gradient -> (V, C) step of size about 1, to be subtracted, where that one is."""
        if self.first.device != gradient.device:
            self._pieces, self.first, self.second = (
                t.to(gradient.device) for t in (self._pieces, self.first, self.second)
            )
        b1, b2 = _KEPT
        self.count += 1
        largest = torch.zeros_like(self.second)
        if len(gradient):
            largest.scatter_reduce_(0, self._pieces, (gradient**2).amax(1), "amax")
        self.first = b1 * self.first + (1 - b1) * gradient
        self.second = b2 * self.second + (1 - b2) * largest
        scale = torch.sqrt(self.second / (1 - b2**self.count))
        scale = torch.where(scale > 0, scale, 1.0)
        return self.first / (1 - b1**self.count) / scale[self._pieces, None]
