"""The loss and the widths of the PSF against the iterations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import log10, nan

from qtpy.QtWidgets import QWidget

from ...timeline import Moment
from .plots import Line, Plot, spread

_LOSS = "#ffb000"
_AXES = (("Z", "#4f8fe0"), ("Y", "#3fae6b"), ("X", "#e0564f"))


class LossCurve(Plot):
    """A small logarithmic plot; a vertical line where a new level begins."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(
            "loss",
            "Loss (logarithmic): the weighted residual, as a share of the variance of the voxels "
            "that count. Lines show where the blur is reduced; there the loss starts anew.",
            parent,
        )

    def show_losses(self, loss: Sequence[float], level: Sequence[int], first: int = 1) -> None:
        """Show the course of a fit, from its iteration ``first`` on."""
        n = min(len(loss), len(level))
        kept = spread(n)
        values = [log10(loss[k]) if loss[k] > 0 else nan for k in kept]
        marks = [first + b for a, b in pairwise(kept) if level[a] != level[b]]
        text = f"{loss[n - 1]:.3g}" if n else ""
        self.show_lines([Line(_LOSS, text, [first + k for k in kept], values)], marks)


class SigmaCurve(Plot):
    """The widths of the PSF along Z, Y and X."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(
            "PSF", "Widths of the PSF (sigma, um) along Z, Y and X over the iterations.", parent
        )
        self._known: dict[Moment, tuple[float, float, float]] = {}

    @property
    def varies(self) -> bool:
        """Whether the widths shown are not all the same."""
        return len(set(self._known.values())) > 1

    def show_moments(self, moments: Sequence[Moment]) -> None:
        """Show the course of a fit."""
        known = self._known
        self._known = {m: known.get(m) or m.optics.sigma_um for m in moments}
        sigmas = list(self._known.values())
        x = [float(moment.iteration) for moment in moments]
        self.show_lines(
            [
                Line(colour, name, x, [sigma[k] for sigma in sigmas])
                for k, (name, colour) in enumerate(_AXES)
            ]
        )
