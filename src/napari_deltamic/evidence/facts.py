"""What is known about a fit when it has ended: plain numbers, from which its verdict follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from statistics import median

from .dents import Dent
from .left_out import Place
from .predicted_error import PredictedError
from .slices_apart import SlicesApart


@dataclass(frozen=True)
class CellFacts:
    """What is known about one cell.

    Attributes
    ----------
    region
        The cell.
    explained
        Share of the signal around it; None where nothing varies beyond noise.
    stray
        Light of the clearest spot of the residual near it, over the light of the cell.
    growth
        Volume over that of the start; None where the start had no such cell.
    cut
        Whether the border of the image cuts it (:func:`~.geometry.border.cut_cells`).
    inside
        Brightness deep inside less that outside, over that of the surface; None where the cell is
        too small to have a deep inside.
    compact
        How round it is, over how round its start was; None where the start had no such cell.
    small
        Whether what is labelled was not given, and it is too small for the image to tell.
    outgrowth
        Where its thin outgrowth ends, um, Z Y X (:func:`~.outgrowths.outgrowths`); None without.
    dent
        Its deepest thin dent (:func:`~.dents.dents`); None without one.
    beyond_neck
        The middle of a thick part that its start did not have, um, Z Y X
        (:func:`~..fitting.voxels.necks.beyond_necks`); None without one.
    uneven
        Standard deviation of the relative brightness deep inside
        (:func:`~.uneven_insides.uneven_insides`).
    inside_share
        Brightness of its inside over that and the peak of its membrane; 1 without a membrane.
    lit
        Share of its surface that shines; 1 where only insides do.
    medium
        How much of the difference by which the model has its inside darker than the medium the
        image shows; 1 where the model has no such difference.
    seen
        Share of its surface where the image is not missing.
    counted
        Share of its surface where the image counted: neither missing nor left to other light.
    fold
        Where its surface is folded (:func:`~.folds.folds`), um, Z Y X; None where it is not.
    unseen_wall
        A neighbour with which it may be one cell: the image hardly shows the wall between them
        (:func:`~.unseen_walls.unseen_walls`). None without one.
    left_out
        Light of bright parts beside it that belong to no cell, over its own, and where they are
        brightest, um, Z Y X (:func:`~.left_out.left_out`); None without any, or where membranes
        shine, as those of neighbours without a label would.
    enclosed
        How many times as bright as its surface a membrane is that encloses it and belongs to no
        cell (:func:`~.enclosing.enclosing_membranes`); None without one, or where only insides
        shine.
    slices
        Its height along Z in slices; infinite where a second view shows that direction, too.
    crowded
        Whether several points were placed in it.
    point
        Whether it is no more than a point compared with the PSF (:func:`~.growth_alarm.shrunken`).
    shown
        Standard deviations of noise by which the image shows it (:class:`~.residual.CellFit`).
    """

    region: int
    explained: float | None = None
    stray: float = 0.0
    growth: float | None = None
    cut: bool = False
    inside: float | None = None
    compact: float | None = None
    small: bool = False
    outgrowth: Place | None = None
    dent: Dent | None = None
    beyond_neck: Place | None = None
    uneven: float = 0.0
    inside_share: float = 1.0
    lit: float = 1.0
    medium: float = 1.0
    seen: float = 1.0
    counted: float = 1.0
    slices: float = inf
    crowded: bool = False
    point: bool = False
    fold: Place | None = None
    unseen_wall: int | None = None
    left_out: tuple[float, Place] | None = None
    enclosed: float | None = None
    shown: float = inf


@dataclass(frozen=True)
class Facts:
    """What is known when a fit has ended.

    Attributes
    ----------
    finished
        Whether its iterations came to an end, and it was not stuck.
    explained
        Share of the signal around all surfaces; None where nothing varies beyond noise.
    widths
        Width of the blur that the image shows over that of the PSF used, "across" and "along Z", as
        far as it can be told: where insides shine only values below 1, and along Z only for a
        Gaussian PSF.
    narrow
        Whether a fitted PSF became narrower than an image can tell.
    cells
        The facts of each cell.
    error
        Predicted errors of the shapes.
    voxel
        Geometric mean of the sides of a voxel, um.
    cut
        Share of the bright voxels that are cut off at the largest value.
    compressed
        Whether intensities look like logarithms.
    slices
        How far slices are shifted against each other, and how unevenly bright they are.
    dome
        Height of a dome of haze that the fit took for background, over the brightest light of the
        model.
    sharpened
        Whether insides shine in an image that looks deconvolved.
    unsure
        Whether membranes may shine as well, with surfaces further in.
    alone
        Whether insides alone may explain as much as both, with surfaces further out.
    nuclei
        Whether dim middles were taken for dark nuclei.
    lit
        Whether a local background was subtracted.
    leans
        Whether, through a tilted PSF, insides shine alone, or both do and its tails are not
        known, and nobody said what is labelled.
    blurred_deep
        Whether insides shine alone through a widefield PSF, and nobody said what is labelled.
    accuracy
        Relative error that the rendered images might have.
    followed
        Share of the image's variance around the surfaces that the distance to them explains, if the
        distance to the seeds explained hardly any (:func:`~.sanity.followed`); None if it did.
    single
        Whether only one slice holds an image (:func:`~.sanity.single_slice`).
    missing
        Numbers of a user's points for which there is no cell.
    by_hand
        Whether the shapes were changed by hand after the fit.
    doubts
        What speaks against the voxel size or the axes (:func:`~.sanity.doubted_scale`).
    """

    finished: bool
    explained: float | None
    widths: Mapping[str, float] = field(default_factory=dict)
    narrow: bool = False
    cells: tuple[CellFacts, ...] = ()
    error: PredictedError = field(default_factory=PredictedError)
    voxel: float = 1.0
    cut: float = 0.0
    compressed: bool = False
    dome: float = 0.0
    slices: SlicesApart = field(default_factory=SlicesApart)
    sharpened: bool = False
    unsure: bool = False
    alone: bool = False
    nuclei: bool = False
    lit: bool = False
    leans: bool = False
    blurred_deep: bool = False
    accuracy: float = 0.0
    followed: float | None = None
    single: bool = False
    missing: tuple[int, ...] = ()
    by_hand: bool = False
    doubts: tuple[str, ...] = ()

    @cached_property
    def usual_growth(self) -> float:
        """Median growth of the cells; 1 if they do not tell."""
        # A cell may be gone: the least is chosen, so that nothing is divided by 0.
        return max(median(self._growths), 1e-9) if self.growth_compares else 1.0

    @property
    def growth_compares(self) -> bool:
        """Whether growth is known for four cells or more: else the median could be a wrong one.

        Four: chosen.
        """
        return len(self._growths) >= 4

    @cached_property
    def _growths(self) -> list[float]:
        return [cell.growth for cell in self.cells if cell.growth is not None]
