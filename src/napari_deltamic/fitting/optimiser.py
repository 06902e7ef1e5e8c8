"""AdamUniform: Adam whose second moment is one number for each connected piece of the mesh."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


class AdamUniform:
    """Steps of one size for all vertices of a piece, so that the direction field stays smooth.

    From Nicolet et al. 2021 (see :class:`Preconditioner`), who take the largest squared gradient of
    the whole mesh; here each connected piece has its own, so that a large cell does not hold back a
    small one. The moments live on the device of the gradients; what is carried along and kept in
    checkpoints are arrays of the host.

    Parameters
    ----------
    pieces
        (V,) piece of each vertex.
    columns
        Numbers per vertex.
    """

    def __init__(
        self, pieces: np.ndarray, columns: int, betas: tuple[float, float] = (0.9, 0.99)
    ) -> None:
        self._betas = betas
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
        b1, b2 = self._betas
        self.count += 1
        largest = torch.zeros_like(self.second)
        if len(gradient):
            largest.scatter_reduce_(0, self._pieces, (gradient**2).amax(1), "amax")
        self.first = b1 * self.first + (1 - b1) * gradient
        self.second = b2 * self.second + (1 - b2) * largest
        scale = torch.sqrt(self.second / (1 - b2**self.count))
        scale = torch.where(scale > 0, scale, 1.0)
        return self.first / (1 - b1**self.count) / scale[self._pieces, None]

    def restart(self) -> None:
        """Forget the past: the loss has changed."""
        self.count = 0
        self.first = torch.zeros_like(self.first)
        self.second = torch.zeros_like(self.second)

    def carried(self) -> np.ndarray:
        """(V, C + 1) what vertices have to take along where their number changes."""
        each = torch.cat([self.first, self.second[self._pieces, None]], 1)
        return each.cpu().numpy()

    def carry_on(self, pieces: np.ndarray, carried: np.ndarray) -> None:
        """Go on with other vertices, and what they took along."""
        self._pieces = torch.as_tensor(pieces.astype(np.int64))
        self.first = torch.tensor(carried[:, :-1])
        self.second = torch.from_numpy(np.bincount(pieces, carried[:, -1]) / np.bincount(pieces))

    def state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        moments = {"first": self.first.cpu().numpy(), "second": self.second.cpu().numpy()}
        return {"count": np.array(self.count), **moments}

    def load(self, state: dict[str, np.ndarray]) -> None:
        """Take over what a checkpoint kept."""
        self.count = int(state["count"])
        self.first, self.second = torch.tensor(state["first"]), torch.tensor(state["second"])
