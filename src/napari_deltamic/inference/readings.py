"""Numbers that iterations leave on a device, read so late that the device never waits for them."""

from __future__ import annotations

from collections import deque
from typing import Any

import torch
from torch import Tensor

from ..fourier.devices import has_own_memory

LATE = 2  # iterations


def late(device: torch.device) -> int:
    """How many iterations later a number is read: on the CPU it is there at once."""
    return LATE if has_own_memory(device) else 0


class Readings:
    """A few numbers of each iteration.

    To read a number of the iteration that a GPU is at would have it wait for Python at every one.
    So they are copied aside, and read some iterations later; always equally many, so that a fit
    takes the same course every time.
    """

    def __init__(self) -> None:
        self._waiting: deque[tuple[Any, Tensor, torch.cuda.Event | None]] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, about: Any, *numbers: Tensor) -> None:
        """Numbers (0-dim tensors) of one more iteration, and what they are about."""
        if not all(n.is_cuda for n in numbers):
            # On the way to the CPU first: the GPU of a Mac has no double precision.
            there = [n.detach().cpu().to(torch.float64) for n in numbers]
            self._waiting.append((about, torch.stack(there), None))
            return
        together = torch.stack([n.detach().to(torch.float64) for n in numbers])
        aside, event = together.to("cpu", non_blocking=True), torch.cuda.Event()
        event.record(torch.cuda.current_stream(together.device))
        self._waiting.append((about, aside, event))

    def read(self, leave: int = 0) -> list[tuple[Any, list[float]]]:
        """Those of all iterations but the last few, oldest first; each is told once."""
        found = []
        while len(self._waiting) > leave:
            about, numbers, event = self._waiting.popleft()
            if event is not None:
                event.synchronize()
            found.append((about, numbers.tolist()))
        return found

    def forget(self) -> None:
        """Nobody wants to know."""
        self._waiting.clear()
