"""Limited-memory BFGS: directions from the last steps, in the metric of the unknowns."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from ..geometry.mesh import FloatArray

Solve = Callable[[FloatArray, float], FloatArray]

# Pairs kept: the prototypes' number; 6 took a tenth more evaluations, 24 none less.
_PAIRS = 12
# A pair whose curvature is less than this share of |s| |y| says nothing (J. Nocedal, S. J. Wright,
# "Numerical Optimization", 2006, section 7.2).
_LEAST_CURVATURE = 1e-8


class Memory:
    """The last steps, and what they changed the gradient by.

    Parameters
    ----------
    metric
        ``metric(g, scale)``: the inverse Hessian that is guessed at first, applied to a gradient
        (n,). ``scale`` multiplies what the last pair measures.
    """

    def __init__(self, metric: Solve, scale: float) -> None:
        self._metric = metric
        self._pairs: deque[tuple[FloatArray, FloatArray, float]] = deque(maxlen=_PAIRS)
        self.scale = scale

    def __len__(self) -> int:
        return len(self._pairs)

    def forget(self) -> None:
        """Begin again; the scale stays."""
        self._pairs.clear()

    def take_over(self, other: Memory) -> None:
        """Go on with what another has learnt of unknowns that are the same."""
        self._pairs.extend(other._pairs)
        self.scale = other.scale

    def add(self, step: FloatArray, change: FloatArray, free: np.ndarray) -> None:
        """A step that was taken (n,), and the change of the gradient (n,).

        ``free`` (n,) bool: the unknowns whose curvature the scale of the metric follows.
        """
        curvature = float(step @ change)
        if curvature <= _LEAST_CURVATURE * float(np.linalg.norm(step) * np.linalg.norm(change)):
            return
        self._pairs.append((step, change, curvature))
        own = np.where(free, change, 0.0)
        measured = float(own @ self._metric(own, 1.0))
        along = float(step @ own)
        if measured > 0 and along > 0:
            self.scale = along / measured

    def direction(self, gradient: FloatArray) -> FloatArray:
        """Where to go (n,): the two-loop recursion of Nocedal (1980)."""
        q = gradient.copy()
        shares = []
        for step, change, curvature in reversed(self._pairs):
            share = float(step @ q) / curvature
            q -= share * change
            shares.append(share)
        r = self._metric(q, self.scale)
        for (step, change, curvature), share in zip(self._pairs, reversed(shares), strict=True):
            r += (share - float(change @ r) / curvature) * step
        return -r
