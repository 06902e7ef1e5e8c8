"""Changes of topology while a fit runs: cells that come to touch, part, or exchange neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ...geometry.mesh import OUTSIDE, Mesh
from ...geometry.remeshing import can_remesh
from ...geometry.topology.small_pieces import small_pieces
from ...geometry.topology.thin_places import ThinPlace, short_junctions, small_walls, thin_places
from ..model.fitted import Fitted
from ..model.shape import Shape
from .local_misfit import Gap, Misfit

_ALL = 10**6  # more places than there are: no limit
_KEPT = ("seen", "past", "left_alone", "hopeless", "futile")  # lists of places in a checkpoint


@dataclass(frozen=True)
class TopologyRules:
    """When the topology may change, and when a change stays.

    Attributes
    ----------
    thin
        Median edges: what is thinner may give way. The guard holds surfaces apart at a thousandth;
        a quarter is what triangles of that size can no longer show.
    narrow, small_at_end
        Median edges: what is tried at the end of a fit, when nothing presses: necks and holes as
        narrow, walls and junctions as small. Two rows of triangles face each other there.
    close, same
        Median edges: parts of a wall nearer to each other go together; places nearer to each other
        are the same place, which remeshing would otherwise make another one.
    widens
        A place that has become this much wider since it was last seen is left alone: it opens by
        itself.
    patience, patience_tried
        Iterations after which a change is judged, if the fit has not come to rest before; more
        where the image alone decides, since what has not relaxed tells too little.
    certain
        Standard errors of their log likelihood gap by which two shapes must differ: at three, one
        change of 740 that nothing speaks for would stay by chance.
    piece, beyond, alone
        Widths of the PSF: radius of a piece that may vanish, how far around a change it is judged,
        and how far apart changes are that are judged together: so far that their images hardly
        overlap.
    slit
        Widths squared: area of the sides of a slit that is worth a trial; chosen on foams
        (``python -m benchmarks.clusters``).
    one_peak
        Widths: distance of two membranes below which they have one peak (Sparrow's criterion).
    sharp
        Blur, in widths of the PSF, up to which images can tell what touches what: with more, two
        membranes four widths of the PSF apart would have one peak.
    often
        Changes at one place in a fit: what flips back and forth would go on for ever.
    late
        Times that trials of which nothing came put off the end of a fit; each costs ``patience``
        iterations. Measured: two and three found no contact more in ten foams of 16 and 32 cells,
        and took a fifth and a third longer.
    rounds
        Of trials in a fit, also of those of which something came. Measured: of 771 contacts in
        nine foams, 35 were wrong with two, 34 without a bound, with errors alike; an embryo's fit
        takes a tenth less.
    """

    thin: float = 0.25
    narrow: float = 1.6
    small_at_end: float = 1.0
    close: float = 0.5
    same: float = 2.5
    widens: float = 1.2
    patience: int = 12
    patience_tried: int = 40
    certain: float = 3.0
    piece: float = 2.0
    beyond: float = 2.0
    alone: float = 3.0
    slit: float = 10.0
    one_peak: float = 2.0
    sharp: float = 2.0
    often: int = 3
    late: int = 1
    rounds: int = 2

    def patience_for(self, trial: Trial) -> int:
        """Iterations until a change is judged."""
        return self.patience_tried if trial.tried else self.patience


RULES = TopologyRules()


@dataclass(frozen=True, eq=False)
class Trial:
    """A change that is to be judged.

    Attributes
    ----------
    before
        The fit that it began from.
    misfit
        How that explains the image.
    places
        Where it was changed.
    events
        What happened there, a sentence each.
    iteration
        Of the change.
    tried
        Whether nothing pressed there: the image alone decides.
    """

    before: Fitted
    misfit: Misfit
    places: tuple[ThinPlace, ...]
    events: tuple[str, ...]
    iteration: int
    tried: bool


@dataclass(frozen=True)
class Judgement:
    """What becomes of a change.

    kept, undone : places. undecided : those of the undone where the image says neither.
    """

    kept: tuple[ThinPlace, ...]
    undone: tuple[ThinPlace, ...]
    undecided: tuple[ThinPlace, ...]


@dataclass(frozen=True, eq=False)
class TopologyPolicy:
    """Where the topology of a mesh may change, and whether a change stays.

    A place counts that is seen twice, some iterations apart, and has not become wider: two
    surfaces that the guard against collisions keeps apart. Such a change stays unless the image
    near it is explained worse.

    When a fit has settled, it tries what presses nowhere: the narrowest neck or hole goes, slits
    between cells close that look like one wall, neighbours are exchanged at small walls and short
    junctions, and pieces vanish that are smaller than the PSF, such as gaps that cells enclose. All
    are tried at once, as far apart as the PSF reaches. A wall, slit or neck stays changed only
    where the image is explained better by three standard errors; where it says neither, the present
    shape stays and the place is undecided.

    It changes nothing itself: each method gives the policy to go on with.

    Attributes
    ----------
    seen, past, left_alone
        Places of the last look, of all changes, and those that are not changed again.
    hopeless, futile
        Places that could not be changed as they were: of those that press, until the level ends,
        and of trials, until a trial is made.
    late, rounds
        How often trials put off the end in vain, and at all.
    most
        Places that are changed at a time.
    """

    seen: tuple[ThinPlace, ...] = ()
    past: tuple[ThinPlace, ...] = ()
    left_alone: tuple[ThinPlace, ...] = ()
    hopeless: tuple[ThinPlace, ...] = ()
    futile: tuple[ThinPlace, ...] = ()
    late: int = 0
    rounds: int = 0
    most: int = _ALL

    def pressing(self, shape: Shape) -> tuple[TopologyPolicy, list[ThinPlace]]:
        """Places that have been thin for a while, narrowest first.

        Small walls are none: those that a blurred level took for nothing were half of the large
        contacts that foams of 16 cells lost. The image tells, at the end.
        """
        edge = shape.mesh.median_edge()
        places = thin_places(shape.mesh, RULES.thin * edge, apart=RULES.same * edge)
        found = self._free(shape, places, self.hopeless)
        lasting = [p for p in found if any(_lasts(p, q, edge) for q in self.seen)]
        lasting = sorted(lasting, key=lambda p: p.width)[: self.most]
        return replace(self, seen=tuple(found)), lasting

    def candidates(self, shape: Shape, width: float) -> list[ThinPlace]:
        """Where another shape might explain the image; width : um, largest of the PSF."""
        if self.late >= RULES.late or self.rounds >= RULES.rounds:
            return []
        mesh, edge = shape.mesh, shape.mesh.median_edge()
        size = max(RULES.small_at_end * edge, width)
        places = small_pieces(mesh, 4 / 3 * np.pi * (RULES.piece * width) ** 3)
        reach = max(RULES.narrow * edge, RULES.one_peak * width)
        thin = thin_places(mesh, reach, RULES.same * edge, _neck_or_slit)
        places += _narrowest([p for p in thin if p.width < RULES.narrow * edge])
        places += _slits(thin, RULES.one_peak * width, seen=RULES.slit * width**2 / edge**2)
        walls = small_walls(mesh, size**2, RULES.close * edge)
        return places + sorted([*walls, *short_junctions(mesh, size)], key=lambda p: p.width)

    def worth_a_trial(
        self, candidates: Sequence[ThinPlace], shape: Shape, width: float
    ) -> list[ThinPlace]:
        """The candidates that are tried now, none near another."""
        edge, chosen = shape.mesh.median_edge(), list[int]()
        free = self._free(shape, candidates, self.futile)
        near = _near(free, free, RULES.alone * width)
        for k, place in enumerate(free):
            if any(_reverts(place, q, edge) for q in self.past):
                continue
            if near[k].isdisjoint(chosen):
                chosen.append(k)
        return sorted((free[k] for k in chosen), key=lambda p: p.width)[: self.most]

    def changed(self, places: Sequence[ThinPlace], tried: bool) -> TopologyPolicy:
        """Go on after a change."""
        past, futile = (*self.past, *places), () if tried else self.futile
        late, rounds = self.late + tried, self.rounds + tried
        return replace(self, past=past, futile=futile, most=_ALL, late=late, rounds=rounds)

    def unlimited(self) -> TopologyPolicy:
        """Go on with other places: that some of those before could not be changed together says
        nothing of them."""
        return replace(self, most=_ALL)

    def refused(
        self, places: Sequence[ThinPlace], hopeless: Sequence[ThinPlace], tried: bool
    ) -> TopologyPolicy:
        """Go on after a change that could not be made: some spoil it for the others."""
        most = max(1, len(places) // 2)
        if tried:
            return replace(self, futile=(*self.futile, *hopeless), most=most)
        return replace(self, hopeless=(*self.hopeless, *hopeless), most=most)

    def judged(self, trial: Trial, gaps: Sequence[Gap]) -> tuple[TopologyPolicy, Judgement]:
        """What becomes of a change, from how much better the image near its places is explained."""
        kept, undone, undecided = [], [], []
        for place, gap in zip(trial.places, gaps, strict=True):
            clear = RULES.certain * gap.error
            if gap.nats >= (clear if _needs_evidence(place, trial.tried) else -clear):
                kept.append(place)
                continue
            undone.append(place)
            if gap.nats > -clear:
                undecided.append(place)
        late = self.late - (trial.tried and bool(kept))  # what was worth it does not count
        policy = replace(self, left_alone=(*self.left_alone, *undone), late=late)
        return policy, Judgement(tuple(kept), tuple(undone), tuple(undecided))

    def restarted(self) -> TopologyPolicy:
        """Go on at another level, or with a mesh that was changed from outside."""
        return replace(self, seen=(), hopeless=(), futile=())

    def _free(
        self, shape: Shape, places: Sequence[ThinPlace], given_up: Sequence[ThinPlace]
    ) -> list[ThinPlace]:
        """The places that are neither pinned nor known to stay."""
        reach = RULES.same * shape.mesh.median_edge()
        pins = cKDTree(shape.mesh.vertices_numpy()[shape.pinned])
        stay = (*self.left_alone, *given_up)
        beside, before = _near(places, stay, reach), _near(places, self.past, reach)
        found = []
        for k, place in enumerate(places):
            pinned = pins.n and pins.query(place.points)[0].min() < reach
            alone = any(_alike(place, stay[q]) for q in beside[k])
            if not (pinned or alone or len(before[k]) >= RULES.often):
                found.append(place)
        return found

    # ------------------------------------------------------------------------- checkpoints

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        lists = {name: _lists(getattr(self, name)) for name in _KEPT}
        counts = {"late": self.late, "rounds": self.rounds, "most": self.most}
        return {**lists, **counts}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> TopologyPolicy:
        """What :meth:`to_dict` gave."""
        lists = {name: _places(values[name]) for name in _KEPT}
        late, rounds, most = (int(values[name]) for name in ("late", "rounds", "most"))
        return cls(**lists, late=late, rounds=rounds, most=most)


def may_change(mesh: Mesh) -> bool:
    """Whether a mesh has several closed regions, and the compiled extension can change them."""
    return len(mesh.region_ids()) > 1 and mesh.is_closed() and can_remesh()


def _needs_evidence(place: ThinPlace, tried: bool) -> bool:
    """Whether the image must speak for a change: sides that press against each other say enough,
    and a piece smaller than the PSF has none to speak for it."""
    return tried and not place.volume


def _narrowest(places: list[ThinPlace]) -> list[ThinPlace]:
    """The narrowest neck or hole."""
    alike = [p for p in places if len(p.sides) == 1]
    # The flanks of a neck look like a hole, not the other way round.
    alike = [p for p in alike if p.regions[0]] or alike
    return sorted(alike, key=lambda p: p.width)[:1]


def _neck_or_slit(region: int, sides: tuple[int, ...]) -> bool:
    return len(sides) == 1 or region == OUTSIDE


def _slits(places: list[ThinPlace], width: float, seen: float) -> list[ThinPlace]:
    """Gaps between two cells with so many points (about one for each edge squared of a side)."""
    pairs = [p for p in places if len(p.sides) == 2]
    found = [p for p in pairs if p.width < width and len(p.points) > seen]
    return sorted(found, key=lambda p: -len(p.points))


def _lists(places: Sequence[ThinPlace]) -> list[list[Any]]:
    return [
        [list(map(int, p.regions)), list(map(int, p.sides)), p.points.tolist(), p.width, p.volume]
        for p in places
    ]


def _places(lists: list[list[Any]]) -> tuple[ThinPlace, ...]:
    return tuple(ThinPlace(tuple(r), tuple(s), np.array(p), *rest) for r, s, p, *rest in lists)


def _lasts(now: ThinPlace, before: ThinPlace, edge: float) -> bool:
    alike = _alike(now, before) and now.width < RULES.widens * before.width
    return alike and _meet(now, before, edge)


def _alike(one: ThinPlace, other: ThinPlace) -> bool:
    return one.regions == other.regions and one.sides == other.sides


def _reverts(now: ThinPlace, before: ThinPlace, edge: float) -> bool:
    """Whether a flip would take back another."""
    turned = set(now.regions) == set(before.sides) or set(now.sides) == set(before.regions)
    return turned and len(now.regions) > 1 and _meet(now, before, edge)


def _near(places: Sequence[ThinPlace], others: Sequence[ThinPlace], reach: float) -> list[set[int]]:
    """For each place, which of the others have a point within ``reach`` um of one of its."""
    if not others:
        return [set() for _ in places]
    owner = np.repeat(np.arange(len(others)), [len(place.points) for place in others])
    tree = cKDTree(np.concatenate([place.points for place in others]))
    found = []
    for place in places:
        rows = set(chain.from_iterable(tree.query_ball_point(place.points, reach)))
        found.append(set(owner[list(rows)].tolist()))
    return found


def _meet(one: ThinPlace, other: ThinPlace, edge: float) -> bool:
    return bool(cKDTree(one.points).query(other.points)[0].min() < RULES.same * edge)
