"""Two nudges of two voxels on a fit that had converged: what is left of them once it ends again."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from napari_deltamic import GaussianPSF, Mesh, render
from napari_deltamic.measure import distance_to_surface, surface_distance

from ..clusters import foams
from ..figure import target
from ..fits import GRID, LENGTH, SIGMA, begin
from .growing import PHOTONS, noisy
from .jobs import Bench, Outcome, Pair, Side, fit_job
from .lines import Bar, Case, Line, at_most, compared

BY, BRUSH = 2.0, 6.0  # voxels: how far, and the radius of the brush
LEFT = 0.1  # voxel


def nudges(bench: Bench) -> list[Line]:
    """The worst vertex, where the surface was touched and anywhere: of a cow, and of a foam.

    In a foam two nudges are so small a part of the whole that a loss summed over all hardly falls.
    """
    truth = target(bench.data, "cow", GRID, LENGTH)
    clean = render(truth, GRID, GaussianPSF(SIGMA), 1e-5).float().numpy()
    images = {"no noise": clean, f"{PHOTONS:g} photons": noisy(clean, PHOTONS, bench.seed)}
    lines = []
    for noise, image in images.items():
        given = image, GRID.voxel_size, SIGMA, begin()
        lines += _nudged(f"cow, {noise}", given, truth, bench)
    cells = 8 if bench.quick else 32
    known = foams.scene(cells, bench.seed)
    scene = known.image, known.grid.voxel_size, foams.SIGMA, known.start
    return lines + _nudged(f"foam of {cells}, {foams.PHOTONS:g} photons", scene, known.truth, bench)


def _nudged(what: str, scene: tuple, truth: Mesh, bench: Bench) -> list[Line]:
    """Two places of the outer surface, away from each other and from junctions."""
    rng = np.random.default_rng(bench.seed)
    places = truth.vertices_numpy()
    inner = np.setdiff1d(truth.faces, truth.faces[(truth.regions > 0).all(1)])
    if len(walls := truth.faces[(truth.regions > 0).all(1)]):
        away = cKDTree(places[np.unique(walls)]).query(places[inner])[0]
        inner = inner[away > BRUSH]
    first = places[rng.choice(inner)]
    others = inner[np.linalg.norm(places[inner] - first, axis=1) > 4 * BRUSH]
    points = {"pushes": np.stack([first, places[rng.choice(others)]])}
    job = fit_job(what, *scene, arrays=points, push=BY, push_radius=BRUSH)
    return _lines(f"two nudges of {BY:g} voxels, {what}", bench.both(job))


def _lines(what: str, pair: Pair) -> list[Line]:
    def left(side: Side) -> float:
        return float(_moved(pair.each[side][0])[0].max())

    def elsewhere(side: Side) -> float:
        return float(_moved(pair.each[side][0])[1].max())

    def mean(side: Side) -> float:
        outcome = pair.each[side][0]
        if not _ran(outcome):
            return np.nan
        return surface_distance(outcome.mesh("again"), outcome.mesh()).mean

    def extra(side: Side) -> float:
        outcome = pair.each[side][0]
        if not _ran(outcome):
            return np.nan
        return float(outcome.values["again"]["evaluations"]) - outcome.number("evaluations")

    def shown(name: str, unit: str, value: object, bar: Bar | None = None) -> Line:
        return compared(f"{what}, {name}", unit, pair, value, bar)  # type: ignore[arg-type]

    return [
        shown("worst vertex there", "voxel", left, at_most(LEFT)),
        shown("worst vertex elsewhere", "voxel", elsewhere, at_most(LEFT)),
        shown("mean distance to the surface before", "voxel", mean),
        shown("evaluations until it ends again", "", extra),
    ]


def _ran(outcome: Outcome) -> bool:
    return not outcome.failed and bool(outcome.values["pushed"])


def _moved(outcome: Outcome) -> tuple[np.ndarray, np.ndarray]:
    """Distances of vertices to the surface before the nudges: where it was touched, elsewhere.

    What lies on the brush's way out, or within its radius, was touched.
    """
    if not _ran(outcome):
        return np.array([np.nan]), np.array([np.nan])
    before, moved, after = (outcome.mesh(name) for name in ("mesh", "moved", "again"))
    places = after.vertices_numpy()
    distance = distance_to_surface(places, before)
    shifted = np.linalg.norm(moved.vertices_numpy() - before.vertices_numpy(), axis=1)
    touched = before.vertices_numpy()[shifted > 0]
    near = cKDTree(touched).query(places)[0] < BY + BRUSH / 2
    return distance[near], distance[~near]


CASES: dict[str, Case] = {"nudges": nudges}
