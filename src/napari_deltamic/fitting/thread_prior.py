"""What is thought of the shape of threads before an image is seen: that they bend like polymers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..geometry.connected import connected
from ..geometry.mesh import FloatArray, IntArray

# Persistence length where none is given, in widths of the PSF: 17 um, that of actin, for 170 nm.
# Measured: of 3 to 300, 100 and 300 were the best for a straight thread, a wave, one with a kink
# and a spiral bent to 2.5 widths, at 10, 40 and 200 photons; at 10 widths the error was 1.3 to 2
# times as large.
PERSISTENCE = 100.0
# Standard deviation of the log lengths of segments, against those at the start. An image of an even
# thread does not say where along it vertices lie, and so none is wrong. Measured: half and twice
# move threads by less than 0.001 voxel; twice takes a fifth more iterations.
_SPACING = 0.05


@dataclass(frozen=True, eq=False)
class ThreadPrior:
    """The prior on the vertices of a filament: bent like a polymer, its vertices spaced as before.

    Bending is that of the worm-like chain of statistical physics: half the persistence length times
    the integral of the squared curvature, in nats. Branches bend freely, and each thread between
    branches and ends may become longer or shorter as a whole.

    Attributes
    ----------
    segments
        (S, 2) vertices that each joins.
    joints
        (J, 3) vertices of each joint, where exactly two segments meet: before, at and after it.
    threads
        (S,) which thread, from 0 on, each segment is of.
    lengths
        (S,) um at the start.
    persistence
        um.
    """

    segments: IntArray
    joints: IntArray
    threads: Tensor
    lengths: Tensor
    persistence: float

    @classmethod
    def of(cls, vertices: FloatArray, segments: np.ndarray, persistence: float) -> ThreadPrior:
        """The prior of a filament as it is at the start."""
        meeting: dict[int, list[tuple[int, int]]] = {}
        for number, (a, b) in enumerate(segments.tolist()):
            meeting.setdefault(a, []).append((number, b))
            meeting.setdefault(b, []).append((number, a))
        joints, joined = [], []
        for at, met in meeting.items():
            if len(met) == 2:
                (one, before), (other, after) = met
                joints.append((before, at, after))
                joined.append((one, other))
        three, two = (np.array(n, np.int64) for n in (joints, joined))
        threads = torch.from_numpy(connected(two.reshape(-1, 2), len(segments)))
        lengths = _lengths(torch.from_numpy(vertices), segments)
        return cls(segments, three.reshape(-1, 3), threads, lengths, persistence)

    def nats(self, vertices: Tensor) -> Tensor:
        """Minus its logarithm, differentiable in the vertices (V, 3) um."""
        first, second = (_lengths(vertices, self.joints[:, k : k + 2]) for k in range(2))
        before, at, after = (vertices[self.joints[:, k]] for k in range(3))
        turn = (after - at) / second[:, None] - (at - before) / first[:, None]
        bending = self.persistence * (turn.square().sum(1) / (first + second)).sum()
        grown = torch.log(_lengths(vertices, self.segments) / self.lengths)
        sums = grown.new_zeros(int(self.threads.max()) + 1).index_add(0, self.threads, grown)
        mean = (sums / torch.bincount(self.threads))[self.threads]
        return bending + 0.5 * ((grown - mean) / _SPACING).square().sum()


def _lengths(vertices: Tensor, segments: np.ndarray) -> Tensor:
    ends = vertices[torch.from_numpy(segments)]
    return torch.linalg.vector_norm(ends[:, 1] - ends[:, 0], dim=1)
