"""What becomes of results when a number of the engine is half or twice what it is.

``python -m benchmarks.half_and_twice evidence.evidence_rules:SPECTRUM.rings ...`` prints, for each
number, the largest change of anything in each set of small cases: of numbers that the evidence
tells relative to themselves, of surfaces in voxels. ``--cases`` names some of them. A number of a
module is written ``fitting.objective.metric:_DENSITY``, a default of a class
``fitting.objective.schedule:Schedule.held``.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from benchmarks.golden import BALL, GRID, MIDDLE, OPTICS, PAIR, SIDE, START, VOXEL, photons, plain
from napari_deltamic import GaussianPSF, Grid, fit
from napari_deltamic.evidence.camera import camera_from_image
from napari_deltamic.evidence.first_sigma import first_sigma
from napari_deltamic.evidence.recommend import recommend
from napari_deltamic.evidence.sanity import elongation, followed, lasting, structured
from napari_deltamic.evidence.slices import drift
from napari_deltamic.fitting import FitState
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.mesh import Mesh
from napari_deltamic.measure.surface_distance import distance_to_surface
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Scene, Solid, Surface, simulate
from napari_deltamic.scene.effects import Effects

Found = dict[str, Any]
PACKAGE = "napari_deltamic."
LEAST = 1e-12  # what is shown as a change: the distance of a surface from itself is rounding


# ------------------------------------------------------------------------------------------- cases


@cache
def stacks() -> tuple[tuple[np.ndarray, Grid], ...]:
    """Membranes through six PSFs, as 30 to 120 photons show them, with a camera's noise."""
    made = []
    for k, sigma in enumerate(((0.3, 0.2, 0.2), (0.42, 0.24, 0.24), (0.6, 0.3, 0.3)) * 2):
        grid = Grid((36, 56, 56), (0.3, 0.2, 0.2))
        middle = np.array([5.3, 5.5, 5.4])
        off = np.array([0, 1.6, 0.6])
        pair = foam(np.array([middle - off, middle + off]), np.array([2.2, 2.0]), 0.4)
        mesh = pair if k % 2 else sphere(middle, (3.2, 3.6, 3.0), edge_length=0.3)
        effects = Effects.from_text("camera:gain=2:offset=100:read_noise=1.5")
        scene = Scene((Surface(mesh),), GaussianPSF(sigma), effects)
        peak = (30, 60, 120)[k % 3]
        made.append((simulate(scene, grid, photons=peak, background=4.0, seed=k).image, grid))
    return tuple(made)


def widths() -> Found:
    """Of the PSF, as the spectrum tells them."""
    found = {}
    for k, (image, grid) in enumerate(stacks()):
        told = first_sigma(image, grid.voxel_size)
        found[f"z {k}"], found[f"yx {k}"] = told.z.value, told.yx.value
    return found


def cameras() -> Found:
    """Gain, read noise and offset."""
    found = {}
    whole = [image for image, _ in stacks()]
    cut = [np.minimum(i, np.quantile(i, 0.999)) for i in whole]
    dark = [
        np.maximum(i, np.quantile(i, q)) for i, q in zip(whole[:3], (0.1, 0.3, 0.6), strict=True)
    ]
    rng = np.random.default_rng(0)
    few = [
        rng.poisson((i.astype(float) - i.min()) / np.ptp(i) * n)
        for i, n in zip(whole[:2], (1, 3), strict=True)
    ]
    for k, image in enumerate(cut + dark + few):
        told = camera_from_image(image)
        for name in ("gain", "read_noise", "offset", "saturation"):
            found[f"{name} {k}"] = getattr(told, name).value
    return found


def looks() -> Found:
    """What is looked at before a fit, and drift."""
    found = {}
    for k, (image, grid) in enumerate(stacks()):
        pixels = image.astype(np.float32)
        found[f"structured {k}"] = structured(pixels)
        found[f"elongation {k}"] = elongation(pixels, grid.voxel_size, None)
        found[f"lasting {k}"] = 1 + lasting(pixels)  # a correlation about 0
        ball = sphere((5.3, 5.5, 5.4), (2.8, 3.0, 2.8), edge_length=0.4)
        found[f"followed {k}"] = followed(pixels, grid, ball)
        found[f"drift {k}"] = drift(pixels, grid.voxel_size)[0].value
    return found


@cache
def _ended() -> tuple[np.ndarray, FitState]:
    image = plain(effects="attenuation=0.15,halo=0.15:width=0.8")
    return image, _last(image, START)


def scores() -> Found:
    """Of effects, with what they move; an effect that is taken or not counts as 1."""
    image, state = _ended()
    told = recommend(image, GRID, START, OPTICS, fitted=state)
    found: Found = {}
    for e in told.evidence:
        # Scores have a standard deviation of 1: small ones are compared with it.
        found[f"{e.name}: score"] = np.sign(e.score) * (1 + abs(e.score))
        found[f"{e.name}: taken"] = 1.0 + e.recommended
    return found


def membrane() -> Found:
    """A surface, PSF and smooth density."""
    return _fitted(plain(), START, fit_psf=True, density="smooth")


def cluster() -> Found:
    """Two cells that share a wall."""
    start = foam(np.array([MIDDLE - 0.9 * SIDE, MIDDLE + SIDE]), np.array([1.1, 1.05]), 0.35)
    return _fitted(plain(PAIR), start, density="interface")


def insides() -> Found:
    """Light inside and at the membrane; what shines is left open."""
    image = photons(Scene((Surface(BALL), Solid(BALL, 0.5)), OPTICS), seed=4)
    return _fitted(image, START, structure="auto")


CASES: dict[str, Callable[[], Found]] = {
    case.__name__: case
    for case in (
        widths,
        cameras,
        looks,
        scores,
        membrane,
        cluster,
        insides,
    )
}
EVIDENCE = ("widths", "cameras", "looks", "scores")


def _last(image: np.ndarray, mesh: Mesh, **more: object) -> FitState:
    settings = FitSettings(max_iterations=150).model_copy(update=more)
    *_, state = fit(image, GRID, mesh, OPTICS, settings=settings)
    return state


def _fitted(image: np.ndarray, mesh: Mesh, **more: object) -> Found:
    state = _last(image, mesh, **more)
    return {"surface": state.mesh, "iterations": float(state.iteration)}


# --------------------------------------------------------------------------------------- a number


@contextmanager
def changed(place: str, factor: float) -> Iterator[object]:
    """A number of the engine times a factor; tuples as a whole. place : see the module."""
    where, _, what = place.partition(":")
    module = importlib.import_module(PACKAGE + where)
    name, _, attribute = what.partition(".")
    held = getattr(module, name)
    before = getattr(held, attribute) if attribute else held
    now = _times(before, factor)
    if inspect.isclass(held):
        names = list(inspect.signature(held).parameters)
        defaults = list(held.__init__.__defaults__)
        k = names.index(attribute) - len(names)
        kept, defaults[k] = tuple(defaults), now
        held.__init__.__defaults__ = tuple(defaults)
        undo = lambda: setattr(held.__init__, "__defaults__", kept)  # noqa: E731
    elif attribute:
        object.__setattr__(held, attribute, now)
        undo = lambda: object.__setattr__(held, attribute, before)  # noqa: E731
    else:
        known = [m for m in list(sys.modules.values()) if getattr(m, name, None) is before]
        known = [m for m in known if m.__name__.startswith(PACKAGE)]
        for one in known:
            setattr(one, name, now)
        undo = lambda: [setattr(one, name, before) for one in known]  # noqa: E731
    try:
        yield now
    finally:
        undo()


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_times(v, factor) for v in value)
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def change(before: Any, now: Any) -> float:
    """Of numbers, relative; of surfaces, root mean square of the distance in voxels."""
    if isinstance(before, Mesh):
        away = distance_to_surface(now.vertices_numpy(), before)
        return float(np.sqrt(np.mean(away**2))) / VOXEL
    if before is None or now is None:
        return 0.0 if before is now else np.inf
    return abs(now - before) / max(abs(before), 1e-300)


def main(arguments: list[str] | None = None) -> None:
    """Prints a line for each number and factor."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.half_and_twice")
    parser.add_argument("numbers", nargs="+")
    parser.add_argument("--cases", nargs="+", default=EVIDENCE, choices=CASES)
    parser.add_argument("--factors", nargs="+", type=float, default=(0.5, 2.0))
    chosen = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    usual = {case: CASES[case]() for case in chosen.cases}
    for place in chosen.numbers:
        for factor in chosen.factors:
            began, told = time.perf_counter(), []
            with changed(place, factor) as now:
                for case in chosen.cases:
                    try:
                        found = CASES[case]()
                    except Exception as error:
                        told.append(f"{case}: {type(error).__name__}")
                        continue
                    each = {k: change(v, found.get(k)) for k, v in usual[case].items()}
                    most = sorted(each, key=lambda k: -each[k])[:2]
                    shown = ", ".join(f"{k} {each[k]:.2g}" for k in most if each[k] > LEAST)
                    told.append(f"{case}: {shown or 'nothing'}")
            seconds = time.perf_counter() - began
            print(f"{place} = {now}: {'; '.join(told)}  [{seconds:.0f} s]", flush=True)


if __name__ == "__main__":
    main()
