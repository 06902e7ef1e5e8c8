"""Limited-memory BFGS: directions from the last steps, in the metric of the unknowns."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...geometry.mesh import FloatArray

Solve = Callable[[FloatArray, float], FloatArray]

# Pairs kept: the prototypes' number; 6 took a tenth more evaluations, 24 none less.
_PAIRS = 12
# A pair whose curvature is less than this share of |s| |y| says nothing (J. Nocedal, S. J. Wright,
# "Numerical Optimization", 2006, section 7.2).
_LEAST_CURVATURE = 1e-8


@dataclass(frozen=True, eq=False)
class Learnt:
    """What steps have told about an objective.

    Attributes
    ----------
    pairs
        Steps and changes of the gradient (n,), single precision: they are only a guess.
    scale
        Of the metric.
    """

    pairs: tuple[tuple[np.ndarray, np.ndarray], ...]
    scale: float

    def fits(self, count: int) -> bool:
        """Whether it is about so many unknowns."""
        return bool(self.pairs) and len(self.pairs[0][0]) == count

    def saved(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        if not self.pairs:
            return {}
        steps, changes = (np.stack(of_all) for of_all in zip(*self.pairs, strict=True))
        return {"steps": steps, "changes": changes, "scale": np.array(self.scale)}

    @classmethod
    def loaded(cls, found: dict[str, np.ndarray]) -> Learnt | None:
        """What :meth:`saved` kept; None where it kept nothing."""
        if "steps" not in found:
            return None
        pairs = tuple(zip(found["steps"], found["changes"], strict=True))
        return cls(pairs, float(found["scale"]))


class Memory:
    """The last steps, and what they changed the gradient by.

    Parameters
    ----------
    metric
        ``metric(g, scale)``: the inverse Hessian that is guessed at first, applied to a gradient
        (n,). ``scale`` multiplies what the last pair measures.
    learnt
        What is known from before.
    """

    def __init__(self, metric: Solve, scale: float, learnt: Learnt | None = None) -> None:
        self._metric = metric
        self._pairs: deque[tuple[np.ndarray, np.ndarray, float]] = deque(maxlen=_PAIRS)
        self.scale = scale if learnt is None else learnt.scale
        for step, change in learnt.pairs if learnt else ():
            self._pairs.append((step, change, dot(step, change)))

    def __len__(self) -> int:
        return len(self._pairs)

    def forget(self) -> None:
        """Begin again; the scale stays."""
        self._pairs.clear()

    def learnt(self) -> Learnt:
        """What another memory of the same unknowns may begin with."""
        return Learnt(tuple((step, change) for step, change, _ in self._pairs), self.scale)

    def add(self, step: FloatArray, change: FloatArray, free: np.ndarray) -> None:
        """A step that was taken (n,), and the change of the gradient (n,).

        ``free`` (n,) bool: the unknowns whose curvature the scale of the metric follows.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            rounded = step.astype(np.float32), change.astype(np.float32)
            # What is rounded to nothing, or to infinity, says nothing either.
            curvature = dot(*rounded)
            much = np.sqrt(dot(rounded[0], rounded[0]) * dot(rounded[1], rounded[1]))
        if not curvature > _LEAST_CURVATURE * much:
            return
        self._pairs.append((*rounded, curvature))
        own = np.where(free, change, 0.0)
        measured = dot(own, self._metric(own, 1.0))
        along = dot(step, own)
        if measured > 0 and along > 0:
            self.scale = along / measured

    def direction(self, gradient: FloatArray) -> FloatArray:
        """Where to go (n,): the two-loop recursion of Nocedal (1980)."""
        q = gradient.copy()
        shares = []
        for step, change, curvature in reversed(self._pairs):
            share = dot(step, q) / curvature
            q -= share * change
            shares.append(share)
        r = self._metric(q, self.scale)
        for (step, change, curvature), share in zip(self._pairs, reversed(shares), strict=True):
            r += (share - dot(change, r) / curvature) * step
        return -r


def dot(one: np.ndarray, other: np.ndarray) -> float:
    """Dot product of (n,) in double precision; the same bits for any number of threads.

    Libraries of linear algebra cut long ones where threads meet.
    """
    return float(np.add.reduce(one.astype(np.float64, copy=False) * other))
