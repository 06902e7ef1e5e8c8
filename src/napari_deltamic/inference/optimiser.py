"""AdamUniform: Adam whose second moment is one number for each connected piece of the mesh."""

from __future__ import annotations

import numpy as np


class AdamUniform:
    """Steps of one size for all vertices of a piece, so that the direction field stays smooth.

    From Nicolet et al. 2021 (see :class:`Preconditioner`), who take the largest squared gradient of
    the whole mesh; here each connected piece has its own, so that a large cell does not hold back a
    small one.

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
        self._pieces = pieces
        self._betas = betas
        self.count = 0
        self.first = np.zeros((len(pieces), columns))
        self.second = np.zeros(int(pieces.max()) + 1 if len(pieces) else 0)

    def step(self, gradient: np.ndarray) -> np.ndarray:
        """(V, C) gradient -> (V, C) step of size about 1, to be subtracted."""
        b1, b2 = self._betas
        self.count += 1
        largest = np.zeros_like(self.second)
        np.maximum.at(largest, self._pieces, (gradient**2).max(1))
        self.first = b1 * self.first + (1 - b1) * gradient
        self.second = b2 * self.second + (1 - b2) * largest
        scale = np.sqrt(self.second / (1 - b2**self.count))
        scale = np.where(scale > 0, scale, 1.0)
        return self.first / (1 - b1**self.count) / scale[self._pieces, None]

    def restart(self) -> None:
        """Forget the past: the loss has changed."""
        self.count = 0
        self.first[:] = 0
        self.second[:] = 0

    def carried(self) -> np.ndarray:
        """(V, C + 1) what vertices have to take along where their number changes."""
        return np.column_stack([self.first, self.second[self._pieces]])

    def carry_on(self, pieces: np.ndarray, carried: np.ndarray) -> None:
        """Go on with other vertices, and what they took along."""
        self._pieces = pieces
        self.first = carried[:, :-1].copy()
        self.second = np.bincount(pieces, carried[:, -1]) / np.bincount(pieces)

    def state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        return {"count": np.array(self.count), "first": self.first, "second": self.second}

    def load(self, state: dict[str, np.ndarray]) -> None:
        """Take over what a checkpoint kept."""
        self.count = int(state["count"])
        self.first, self.second = state["first"].copy(), state["second"].copy()
