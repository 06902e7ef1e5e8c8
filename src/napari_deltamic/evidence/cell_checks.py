"""Checks of one cell: each looks at one fact about it, and returns a reason or None.

The facts are measured elsewhere (:class:`~.facts.CellFacts` says where), and the thresholds are in
:mod:`.verdict_rules`. Reasons are told in the order of ``CELL_CHECKS``. NaN is never a reason.
"""

from __future__ import annotations

from collections.abc import Callable

from ..fitting.objective.deep_insides import RULES as DEEP
from .facts import CellFacts, Facts
from .fainter_membranes import NAME as LIGHT_OF_MEMBRANES
from .left_out import Place
from .reason import Reason, fair_if, unexplained
from .verdict_rules import RULES

CellCheck = Callable[[CellFacts, Facts], Reason | None]
_PARTS = {
    "noise": "the noise",
    "settling": "too few iterations",
    "prior": "the prior on its shape",
    "triangles": "triangles that are too large",
    "alternative": "what the model lacks ({lacks})",
}


# How well it is told --------------------------------------------------------------------------


def _unseen(cell: CellFacts, fit: Facts) -> Reason | None:
    """Where the image is missing at its surface, or else left to other objects."""
    if cell.seen < RULES.seen:
        text = f"the image is missing at {1 - cell.seen:.0%} of its surface: what lies there is a"
        return Reason("missing", fair_if(cell.seen >= RULES.unseen), f"{text} guess")
    if cell.counted < RULES.seen:
        text = f"{1 - cell.counted:.0%} of its surface lies in light assigned to other objects"
        grade = fair_if(cell.counted >= RULES.unseen)
        return Reason("others' light", grade, f"{text}: is its seed in the right place?")
    return None


def _off(cell: CellFacts, fit: Facts) -> Reason | None:
    """Whether the predicted error of its shape, in voxels, is too large."""
    predicted = fit.error.cells.get(cell.region)
    off = 0.0 if predicted is None else predicted.total / fit.voxel
    if predicted is None or off <= RULES.error_good:
        return None
    shares = predicted.shares()
    most = max(shares, key=lambda name: shares[name])
    part = _PARTS[most].format(lacks=fit.error.lacks)
    text = f"its surface is off by about {off:.2g} voxels, mainly due to {part}"
    if most == "alternative" and fit.error.lacks == LIGHT_OF_MEMBRANES:
        text += ": if membranes do not shine, say so (try --structure interior)"
    return Reason("off", fair_if(off <= RULES.error_fair), text)


def _slices(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.slices < RULES.slices:
        return None
    text = f"it is only {cell.slices:.1f} slices high: its height is poorly determined"
    return Reason("slices", "fair", text)


def _cut(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.cut:
        return None
    return Reason("cut", "fair", "the border of the image cuts it: what lies beyond is a guess")


# Light ----------------------------------------------------------------------------------------


def _dark(cell: CellFacts, fit: Facts) -> Reason | None:
    told = cell.explained is not None and cell.explained >= RULES.fair
    if told or not cell.shown < RULES.shown:  # few voxels may tell no more, but all there is
        return None
    text = "the image hardly shows it: its shape follows noise"
    return Reason("dark", "poor", f"{text}; if there is no cell, fit without it")


def _explained(cell: CellFacts, fit: Facts) -> Reason | None:
    return unexplained(cell.explained, RULES.good, RULES.fair, "it")


def _stray(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.stray > RULES.stray:
        return None
    text = f"unexplained light beside it, {_of_its_light(cell.stray)}: light inside, haze or a"
    return Reason("stray", "fair", f"{text} neighbour (--effects auto)")


def _left_out(cell: CellFacts, fit: Facts) -> Reason | None:
    if cell.left_out is None or not cell.left_out[0] > RULES.left_out:
        return None
    share, place = cell.left_out
    text = f"bright parts beside it, {_of_its_light(share)}, brightest at {_um(place)}, belong to"
    return Reason("left out", "fair", f"{text} no cell: are they arms of it?")


def _enclosed(cell: CellFacts, fit: Facts) -> Reason | None:
    if cell.enclosed is None:
        return None
    text = f"a membrane {cell.enclosed:.2g} times as bright encloses it: is its label that of the"
    return Reason("enclosed", "fair", f"{text} nucleus?")


def _inside(cell: CellFacts, fit: Facts) -> Reason | None:
    if cell.inside is None or not abs(cell.inside) > RULES.inside:
        return None
    where = "inside it" if cell.inside > 0 else "around it"
    much = f"{abs(cell.inside):.0%} as bright as" if abs(cell.inside) < 1 else "brighter than"
    text = f"light {where}, {much} its surface, is not in the model"
    return Reason("inside", "fair", f"{text} (--structure both)")


def _medium(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.medium < DEEP.shown:
        return None
    text = "the model assumes that its inside is darker than the medium, but it is not: is this a"
    return Reason("medium", "fair", f"{text} thick bright layer?")


def _small(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.small:
        return None
    text = "it is so small that membrane and interior look the same through the PSF: say which is"
    return Reason("small", "fair", f"{text} labelled (--structure)")


def _uneven(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.uneven * cell.inside_share > RULES.uneven:
        return None
    text = f"its interior brightness varies by {cell.uneven:.0%}: the border may be off where it is"
    return Reason("uneven", "fair", f"{text} dim or bright")


def _lit(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.lit < RULES.lit:
        return None
    text = f"only {cell.lit:.0%} of its surface is bright: the rest is a guess"
    return Reason("lit", fair_if(cell.lit >= RULES.dark), text)


# Shape ----------------------------------------------------------------------------------------


def _crumpled(cell: CellFacts, fit: Facts) -> Reason | None:
    if cell.compact is None or not cell.compact < RULES.compact:
        return None
    text = "it is much less round than its start: has it fins or arms, or has it crumpled or leaked"
    return Reason("crumpled", "fair", f"{text} into a neighbour?")


def _growth(cell: CellFacts, fit: Facts) -> Reason | None:
    """Growth relative to that of the other cells."""
    growth = 1.0 if cell.growth is None else cell.growth / fit.usual_growth
    if growth > RULES.grown:
        text = f"it has grown to {growth:.2g} times its volume: has it swallowed a neighbour?"
        return Reason("grown", fair_if(not fit.growth_compares or growth <= RULES.outgrown), text)
    if growth < RULES.shrunk:
        return Reason("shrunk", "poor", f"it has shrunk to {growth:.0%} of its volume")
    return None


def _point(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.point:
        return None
    text = "it has shrunk to a point: give it a new seed, or leave it out"
    return Reason("point", "poor", text)


def _crowded(cell: CellFacts, fit: Facts) -> Reason | None:
    if not cell.crowded:
        return None
    text = "several points lie in it: are there several cells? Then give each a radius"
    return Reason("crowded", "fair", text)


def _dented(cell: CellFacts, fit: Facts) -> Reason | None:
    """Whether it has a thin dent, or else a fold."""
    if cell.dent is not None:
        text = f"a thin dent reaches to {_um(cell.dent.end)}: is something bright there, inside the"
        text += " cell, or two cells under one label?" if cell.dent.wall else " cell?"
        return Reason("dent", "fair", text)
    if cell.fold is not None:
        text = f"its surface is folded at {_um(cell.fold)}: are these two cells?"
        return Reason("fold", "fair", text)
    return None


def _unseen_wall(cell: CellFacts, fit: Facts) -> Reason | None:
    if cell.unseen_wall is None:
        return None
    text = f"the image hardly shows its wall with cell {cell.unseen_wall}: they may be one cell"
    return Reason("unseen wall", "fair", text)


def _outgrowth(cell: CellFacts, fit: Facts) -> Reason | None:
    if cell.outgrowth is None:
        return None
    text = f"a thin outgrowth reaches to {_um(cell.outgrowth)}: is it part of the cell, or"
    return Reason("outgrowth", "fair", f"{text} something bright beside it?")


def _neck(cell: CellFacts, fit: Facts) -> Reason | None:
    if cell.beyond_neck is None:
        return None
    text = f"it has grown through a neck to {_um(cell.beyond_neck)}: if another cell is there, give"
    return Reason("neck", "fair", f"{text} it a seed")


def _of_its_light(share: float) -> str:
    return f"{share:.0%} of its light" if share < 1 else "more than its light"


def _um(place: Place) -> str:
    z, y, x = place
    return f"({z:.1f}, {y:.1f}, {x:.1f}) um"


CELL_CHECKS: tuple[CellCheck, ...] = (
    _dark,
    _unseen,
    _off,
    _explained,
    _stray,
    _left_out,
    _enclosed,
    _inside,
    _medium,
    _crumpled,
    _growth,
    _point,
    _small,
    _crowded,
    _slices,
    _dented,
    _unseen_wall,
    _outgrowth,
    _neck,
    _uneven,
    _lit,
    _cut,
)
