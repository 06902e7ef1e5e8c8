"""What a fit explains, and the widths of the PSF, against the iterations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from qtpy.QtWidgets import QWidget

from ...results.timeline import Moment
from .plots import Line, Plot, spread

_EXPLAINED = "#ffb000"
_AXES = (("Z", "#4f8fe0"), ("Y", "#3fae6b"), ("X", "#e0564f"))


def explained(loss: float) -> float:
    """Per cent of the variation of the voxels that count; NaN where a loss is not known."""
    return 100 * (1 - loss)


class ExplainedCurve(Plot):
    """What the fit explains; a line for each level, as each looks at a sharper image."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(
            "explained, noise included",
            "Share of the signal near the surfaces that the cells explain, noise included, over "
            "the iterations. Each line is a level: the image gets sharper, and its noise counts "
            "more, so that a new line begins lower.",
            parent,
        )

    def show_losses(self, loss: Sequence[float], level: Sequence[int], first: int = 1) -> None:
        """Show the course of a fit, from its iteration ``first`` on."""
        n = min(len(loss), len(level))
        kept = spread(n)
        starts = [k for a, k in pairwise(kept) if level[a] != level[k]]
        parts = [[k for k in kept if a <= k < b] for a, b in pairwise([0, *starts, n])] if n else []
        text = f"{explained(loss[n - 1]):.1f} %" if n else ""
        lines = [
            Line(
                _EXPLAINED,
                text if number == len(parts) else "",
                [first + k for k in part],
                [explained(loss[k]) for k in part],
            )
            for number, part in enumerate(parts, 1)
        ]
        self.show_lines(lines, [first + k for k in starts])


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
