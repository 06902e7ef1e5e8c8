"""Changes of topology while a fit runs: cells that come to touch, part, or exchange neighbours."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.mesh import Mesh
from ..geometry.topology.rearranging import give_way
from ..geometry.topology.small_pieces import small_pieces
from ..geometry.topology.thin_places import ThinPlace, short_junctions, small_walls, thin_places
from .local_misfit import local_misfit
from .upkeep import median_edge

if TYPE_CHECKING:
    from .run import Run

# As shares of the median edge:
_THIN = 0.25  # what is thinner may give way
_SMALL = 0.5  # walls smaller than this, of an edge length squared, may go
# At the end of a fit, what is larger is tried too: necks and holes up to a width, walls to an area
# and junctions to a length.
_NARROW, _SMALL_AT_END = 1.6, 1.0
_CLOSE = 0.5  # parts of a wall nearer to each other than this go together
_SAME = 2.5  # places nearer to each other than this are the same place
# Counts and others:
_WIDENS = 1.2  # a place that has become this much wider since it was last seen is left alone
_TRIAL = 18  # iterations after which a change is judged
_MEAN = 4  # losses that are averaged before and after
_WORSE = 1.002  # times the loss before: a change that leaves more is undone
# Nats: a change that is only tried stays where the image near it is explained better by more; a
# piece smaller than the PSF vanishes unless that explains it worse by more. Noise makes about one.
_DOUBT, _PIECE_DOUBT = 0.5, 6.0
# Widths of the PSF: radius of such a piece, how far around it a change is judged, and how far apart
# changes are that are judged together.
_PIECE, _BEYOND, _ALONE = 2.0, 2.0, 3.0
_SHARP = 2.0  # blur, in widths of the PSF, up to which images can tell what touches what
_OFTEN = 3  # changes at one place in a fit
_ALL = 10**6  # places at a time
_SETTLED = 2  # halvings of the step after which the end of a fit is near
_AT_REST = 23  # losses: with the next one, two windows in which nothing is gained
_LATE = 3  # times that a change puts off the end of a fit


@dataclass(frozen=True, eq=False)
class _Before:
    """What a fit was before a change."""

    mesh: Mesh
    carried: np.ndarray
    count: int
    log: np.ndarray
    pinned: np.ndarray
    loss: float
    level: int
    iteration: int
    places: list[ThinPlace]
    misfits: np.ndarray
    events: tuple[str, ...]
    tried: bool


# What a checkpoint keeps of the keeper and of what was before a change, by kind:
_PLACES = ("seen", "past", "left_alone")
_MEMORY = ("late", "most", "looked", "loss", "events")
_SCALARS = ("count", "loss", "level", "iteration", "events", "tried")
_ARRAYS = ("carried", "log", "pinned", "misfits")


class TopologyKeeper:
    """Lets thin places of a mesh give way where the fit presses their sides together.

    A place counts that is seen twice, some iterations apart, and has not become wider: two
    surfaces that the guard against collisions keeps apart. A change stays if the loss, after some
    iterations, is not larger than before; else it is undone, and the place is left alone.

    When a fit has nearly settled, it tries what presses nowhere: the narrowest neck or hole goes,
    neighbours are exchanged at small walls and short junctions, and pieces vanish that are smaller
    than the PSF, such as gaps that cells enclose. All are tried at once, as far apart as the PSF
    reaches, and each is judged by the likelihood of the image around it.

    Only meshes of several closed regions are changed; surfaces must be kept from crossing.
    """

    def __init__(self) -> None:
        self._seen: list[ThinPlace] = []
        self._past: list[ThinPlace] = []
        self._left_alone: list[ThinPlace] = []
        self._before: _Before | None = None
        self._late = 0
        self._most = _ALL
        self._looked = -1  # the last iteration in which it looked
        self._loss = np.inf  # before the last change, or the last halving of the step
        self._events: list[str] = []

    def restart(self) -> None:
        """Go on with a mesh that was changed from outside."""
        self._seen, self._before = [], None

    def forgets(self, losses: list[float]) -> None:
        """The losses that a fit is about to forget: a change right then is compared with them."""
        self._loss = float(np.mean(losses[-_MEAN:]))

    def events(self) -> tuple[str, ...]:
        """What has happened since this was last asked."""
        told, self._events = tuple(self._events), []
        return told

    def look(self, run: Run) -> None:
        """Change the mesh of a run, or judge the last change, if it is time to."""
        if not applies(run) or run.iteration == self._looked:
            return
        self._looked = run.iteration
        just: list[ThinPlace] = []
        if self._before is not None:
            if run.iteration - self._before.iteration < _TRIAL:
                return
            just = self._before.places
            self._judge(run)
        found = self._candidates(run, _THIN, _SMALL)
        edge = median_edge(run.mesh)
        lasting = [p for p in found if any(_lasts(p, q, edge) for q in self._seen)]
        lasting = [p for p in lasting if not any(_meet(p, q, edge) for q in just)]
        self._seen = found
        if not self._try(run, lasting, just) and lasting:
            self._change(run, lasting)

    def holds_up(self, run: Run) -> bool:
        """Whether a fit that is about to end goes on from a change instead."""
        if not applies(run) or self._before is not None:
            return False
        return self._try(run, self._candidates(run, _THIN, _SMALL), [])

    def _try(self, run: Run, others: list[ThinPlace], just: list[ThinPlace]) -> bool:
        """Change what only a trial can tell, and others; whether it did.

        Nothing where a trial has ``just`` been: the fit has not come to rest there.
        """
        if self._late >= _LATE or run.halvings < _SETTLED:
            return False
        trial = self._worth_a_trial(run, [*others, *just])
        places = others + trial
        if not places or not self._change(run, places, tried=bool(trial)):
            return False
        self._late += 1
        _settle_again(run, min(self._late, _SETTLED))
        return True

    def level_ends(self, run: Run) -> None:
        """Judge a change before the images become sharper."""
        if self._before is not None and run.iteration - self._before.iteration >= _TRIAL:
            self._judge(run)
        self._before = None
        self._loss = np.inf  # images of the next level have other losses

    # ------------------------------------------------------------------------- checkpoints

    def state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        before = self._before
        memory: dict[str, Any] = {k: _lists(getattr(self, f"_{k}")) for k in _PLACES}
        memory |= {k: getattr(self, f"_{k}") for k in _MEMORY}
        arrays = dict.fromkeys(("vertices", "faces", "regions", *_ARRAYS), np.zeros(0))
        if before is not None:
            memory["before"] = {k: getattr(before, k) for k in _SCALARS}
            memory["before"]["places"] = _lists(before.places)
            mesh = before.mesh
            arrays = {k: getattr(before, k) for k in _ARRAYS} | {
                "vertices": mesh.vertices_numpy(),
                "faces": mesh.faces,
                "regions": mesh.regions,
            }
        return {"memory": np.array(json.dumps(memory)), **arrays}

    def load(self, found: dict[str, np.ndarray]) -> None:
        """Take over what a checkpoint has kept."""
        memory = json.loads(str(found["memory"]))
        for name in _PLACES:
            setattr(self, f"_{name}", _places(memory[name]))
        for name in _MEMORY:
            setattr(self, f"_{name}", memory[name])
        self._before = None
        if "before" in memory:
            before = memory["before"]
            before["places"], before["events"] = _places(before["places"]), tuple(before["events"])
            mesh = Mesh(found["vertices"], found["faces"], found["regions"])
            before |= {k: found[k] for k in _ARRAYS}
            self._before = _Before(mesh, **before)

    # ------------------------------------------------------------------------------ places

    def _candidates(self, run: Run, thin: float, small: float) -> list[ThinPlace]:
        edge = median_edge(run.mesh)
        places = thin_places(run.mesh, thin * edge, apart=_SAME * edge)
        if run.level.factor > 1:  # else the image tells, at the end
            places += small_walls(run.mesh, small * edge**2)
        return self._free(run, places)

    def _worth_a_trial(self, run: Run, others: list[ThinPlace]) -> list[ThinPlace]:
        """Where another shape might explain the image, none near others or each other."""
        width, edge = float(max(run.optics.sigma_um)), median_edge(run.mesh)
        size = max(_SMALL_AT_END * edge, width)
        places = small_pieces(run.mesh, 4 / 3 * np.pi * (_PIECE * width) ** 3)
        places += _narrowest(thin_places(run.mesh, _NARROW * edge, apart=_SAME * edge))
        walls = small_walls(run.mesh, size**2, _CLOSE * edge)
        places += sorted([*walls, *short_junctions(run.mesh, size)], key=lambda p: p.width)
        chosen = others.copy()
        for place in self._free(run, places):
            if any(_reverts(place, q, edge) for q in self._past):
                continue
            near = (cKDTree(p.points).query(place.points)[0].min() for p in chosen)
            if min(near, default=np.inf) > _ALONE * width:
                chosen.append(place)
        return chosen[len(others) :]

    def _free(self, run: Run, places: list[ThinPlace]) -> list[ThinPlace]:
        """Those that are neither pinned nor known to stay."""
        edge = median_edge(run.mesh)
        pins = run.mesh.vertices_numpy()[run.pinned]
        found = []
        for place in places:
            pinned = len(pins) and cKDTree(pins).query(place.points)[0].min() < _SAME * edge
            alone = any(_same(place, q, edge) for q in self._left_alone)
            again = sum(_meet(place, q, edge) for q in self._past) >= _OFTEN
            if not (pinned or alone or again):
                found.append(place)
        return found

    # ----------------------------------------------------------------------------- changes

    def _change(self, run: Run, places: list[ThinPlace], tried: bool = False) -> bool:
        places = sorted(places, key=lambda p: p.width)[: self._most]
        made = give_way(run.mesh, places, median_edge(run.mesh))
        self._left_alone += made.hopeless
        if made.mesh is run.mesh:
            # Some spoil it for the others: fewer at the next look.
            self._most = max(1, len(places) // 2)
            return False
        self._most = _ALL
        self._before = _Before(
            run.mesh,
            run.adam.carried(),
            run.adam.count,
            run.density.log,
            run.pinned,
            float(np.mean(run.losses[-_MEAN:])) if run.losses else self._loss,
            run.level_number,
            run.iteration,
            places,
            _misfits(run, places) if tried else np.zeros(0),
            made.events,
            tried,
        )
        self._past += places
        _go_on(run, made.mesh)
        if not tried:
            self._events += made.events
        return True

    def _judge(self, run: Run) -> bool:
        """Undo the last change where it has made the fit worse; whether anything was undone."""
        before, self._before = self._before, None
        assert before is not None
        self._loss = before.loss
        same_level = before.level == run.level_number
        past = run.iteration - before.iteration
        if not same_level or past < _TRIAL or len(run.losses) < _MEAN:
            return False
        worse = float(np.mean(run.losses[-_MEAN:])) > _WORSE * before.loss
        kept = before.places
        if len(before.misfits):
            gain = before.misfits - _misfits(run, before.places)
            least = [_least(place, before.tried) for place in before.places]
            kept = [p for p, g, x in zip(before.places, gain, least, strict=True) if g >= x]
        if not worse and len(kept) == len(before.places):
            self._events += before.events if before.tried else ()
            return False
        self._left_alone += before.places if worse else [p for p in before.places if p not in kept]
        self._undo(run, before)
        if kept and not worse:
            made = give_way(run.mesh, kept, median_edge(run.mesh))
            if made.mesh is not run.mesh:
                _go_on(run, made.mesh)
                self._events += made.events if before.tried else ()
        elif not before.tried:
            self._events.append("undone, as the image speaks against it")
        if before.tried:
            _settle_again(run, _SETTLED)
            if not kept or worse:  # it had settled there
                run.losses = [before.loss] * _AT_REST
        return True

    def _undo(self, run: Run, before: _Before) -> None:
        run.retriangulate(before.mesh, before.log if len(before.log) else None)
        run.adam.count = before.count
        run.adam.carry_on(run.pieces, before.carried)
        run.pinned = before.pinned
        _renew(run)


def _misfits(run: Run, places: list[ThinPlace]) -> np.ndarray:
    reach = _BEYOND * float(max(run.optics.sigma_um))
    return local_misfit(run, [place.points for place in places], reach)


def _least(place: ThinPlace, tried: bool) -> float:
    """Nats by which the image near a change must be explained better.

    Sides that press against each other say enough themselves.
    """
    if not tried or (place.is_thin and len(place.sides) > 1):
        return -np.inf
    return -_PIECE_DOUBT if place.volume else _DOUBT


def _settle_again(run: Run, halvings: int) -> None:
    """Put the end of the fit off; steps are not so large that they shake what has settled."""
    run.halvings, run.step_factor, run.losses = halvings, 0.5 ** (halvings - 1), []
    run.window_start = np.zeros((0, 3))


def applies(run: Run) -> bool:
    """Whether the topology of this run's mesh may change."""
    settings = run.settings
    return (
        settings.topology
        and settings.collisions
        and run.level.factor <= _SHARP
        and len(run.mesh.region_ids()) > 1
        and run.mesh.is_closed()
    )


def _go_on(run: Run, mesh: Mesh) -> None:
    """Go on with a mesh of other topology; what vertices carry comes from the nearest old one."""
    old, past, count = run.mesh, run.adam.carried(), run.adam.count
    log, pinned = run.density.per_vertex, run.pinned
    places = mesh.vertices_numpy().copy()
    nearest = cKDTree(old.vertices_numpy()).query(places)[1]
    pins = np.zeros(len(places), bool)
    if pinned.any():
        held = old.vertices_numpy()[pinned]
        rows = cKDTree(places).query(held)[1]
        places[rows], pins[rows] = held, True
    places.setflags(write=False)  # states share it
    run.retriangulate(mesh.with_vertices(places), None if log is None else log[nearest])
    run.adam.count = count
    run.adam.carry_on(run.pieces, past[nearest])
    run.pinned = pins
    _renew(run)


def _renew(run: Run) -> None:
    run.growth = type(run.growth)(run.mesh)
    run.window_start = np.zeros((0, 3))
    run.level.renew()
    run.hold()


def _narrowest(places: list[ThinPlace]) -> list[ThinPlace]:
    """The narrowest neck or hole."""
    alike = [p for p in places if len(p.sides) == 1]
    # The flanks of a neck look like a hole, not the other way round.
    alike = [p for p in alike if p.regions[0]] or alike
    return sorted(alike, key=lambda p: p.width)[:1]


def _lists(places: list[ThinPlace]) -> list[list[Any]]:
    return [
        [list(map(int, p.regions)), list(map(int, p.sides)), p.points.tolist(), p.width, p.volume]
        for p in places
    ]


def _places(lists: list[list[Any]]) -> list[ThinPlace]:
    return [ThinPlace(tuple(r), tuple(s), np.array(p), *rest) for r, s, p, *rest in lists]


def _lasts(now: ThinPlace, before: ThinPlace, edge: float) -> bool:
    return _same(now, before, edge) and now.width < _WIDENS * before.width


def _same(one: ThinPlace, other: ThinPlace, edge: float) -> bool:
    alike = one.regions == other.regions and one.sides == other.sides
    return alike and _meet(one, other, edge)


def _reverts(now: ThinPlace, before: ThinPlace, edge: float) -> bool:
    """Whether a flip would take back another."""
    turned = set(now.regions) == set(before.sides) or set(now.sides) == set(before.regions)
    return turned and len(now.regions) > 1 and _meet(now, before, edge)


def _meet(one: ThinPlace, other: ThinPlace, edge: float) -> bool:
    return bool(cKDTree(one.points).query(other.points)[0].min() < _SAME * edge)
