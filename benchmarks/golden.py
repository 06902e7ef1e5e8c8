"""Small images, fits, evidence and series whose numbers stay the same while code only moves.

``python -m benchmarks.golden write FILE`` keeps them, ``compare FILE`` says what has changed; both
on one machine and with one thread, since other processors round otherwise. ``--only NAME ...``
takes some, ``--list`` names them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from napari_deltamic import GaussianPSF, Grid, fit, render
from napari_deltamic.evidence.recommend import recommend
from napari_deltamic.evidence.residual import analyse_residual
from napari_deltamic.fitting import FitState
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.measure.measurements import measure
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Filament, Points, Scene, Solid, Surface, simulate
from napari_deltamic.scene.effects import Effects
from napari_deltamic.tracking import track

Found = dict[str, np.ndarray]

SAME = 1e-6  # of the largest number of an array
VOXEL = 0.2
GRID = Grid((20, 26, 26), (VOXEL,) * 3)
OPTICS = GaussianPSF((0.3, 0.26, 0.26))
MIDDLE = VOXEL * np.array([9.5, 12.5, 12.5])
BALL = sphere(MIDDLE, (1.2, 1.4, 1.5), edge_length=0.3)
START = sphere(MIDDLE + np.array([0, 0.1, -0.1]), 1.2, edge_length=0.4)
SIDE = VOXEL * np.array([0, 3.4, 1.5])
PAIR = foam(np.array([MIDDLE - SIDE, MIDDLE + SIDE]), np.array([1.2, 1.1]), 0.35)
SHORT = FitSettings(levels=(1.6, 1.0), max_iterations=24)


def photons(scene: Scene, seed: int = 0, peak: float = 60.0) -> np.ndarray:
    """A noisy image of a scene."""
    found: np.ndarray = simulate(scene, GRID, photons=peak, background=4.0, seed=seed).image
    return found.astype(np.float32)


def plain(mesh: Mesh = BALL, effects: str = "none") -> np.ndarray:
    """A noisy image of the membranes of a mesh."""
    return photons(Scene((Surface(mesh),), OPTICS, Effects.from_text(effects)))


def fitted(image: np.ndarray, mesh: Mesh = START, effects: str = "none", **more: object) -> Found:
    """The numbers of the last state of a short fit."""
    return numbers(last(image, mesh, effects, **more))


def last(image: np.ndarray, mesh: Mesh = START, effects: str = "none", **more: object) -> FitState:
    """The last state of a short fit."""
    settings = SHORT.model_copy(update=more)
    given = image, GRID, mesh, OPTICS
    *_, state = fit(*given, settings=settings, effects=Effects.from_text(effects))
    return state


def numbers(state: FitState) -> Found:
    """What of a state is a number."""
    values = [v.value for e in state.effects.present() for v in e.values()]
    return {
        "vertices": state.mesh.vertices_numpy(),
        "density": state.density,
        "optics": state.optics.parameters().detach().numpy(),
        "effects": np.array(values),
        "scalars": np.array([state.iteration, state.loss, state.amplitude, state.background]),
        "rendered": state.rendered(),
    }


# ------------------------------------------------------------------------------------------- cases


def images() -> Found:
    """Of a membrane, by both methods, with its gradient."""
    found = {}
    for method in ("closed form", "particle-mesh"):
        vertices = torch.tensor(BALL.vertices_numpy(), requires_grad=True)
        image = render(BALL.with_vertices(vertices), GRID, OPTICS, 1e-5, method=method)
        (image**2).sum().backward()
        assert vertices.grad is not None
        found[f"image, {method}"] = image.detach().numpy()
        found[f"gradient, {method}"] = vertices.grad.numpy()
    return found


def effects_on_images() -> Found:
    """Every effect that changes an image."""
    found = {}
    for text in (
        "pixel_integration",
        "attenuation=0.1",
        "bleaching=0.02",
        "illumination:coefficients=[0.1,-0.1,0.05,0,0.02]",
        "halo=0.1:width=0.6",
        "depth_psf:variance_z=0.05:variance_yx=0.02",
        "background:coefficients=[1,2,-1]",
        "attenuation=0.1,halo=0.1:width=0.6,depth_psf:variance_z=0.05,pixel_integration",
    ):
        scene = Scene((Surface(BALL),), OPTICS, Effects.from_text(text))
        found[text] = simulate(scene, GRID, accuracy=1e-4).noise_free
    return found


def structures() -> Found:
    """Surfaces, solids, filaments and points."""
    path = MIDDLE + np.array([[-1, -1, -1], [0, 1, 0.5], [1, -0.5, 1]])
    kinds = {
        "surface and inside": (Surface(BALL), Solid(BALL, 0.4)),
        "pair": (Surface(PAIR), Solid(PAIR, {1: 0.2, 2: 0.7})),
        "all": (Surface(BALL), Solid(BALL, 2.0), Filament(path, density=3.0), Points(path, 2.0)),
    }
    return {k: simulate(Scene(s, OPTICS), GRID, accuracy=1e-4).noise_free for k, s in kinds.items()}


def simulation() -> Found:
    """Noise of photons and of a camera."""
    effects = Effects.from_text("camera:gain=2:offset=100:read_noise=1.5")
    made = simulate(Scene((Surface(PAIR),), OPTICS, effects), GRID, photons=80, seed=3)
    assert made.labels is not None
    return {"image": made.image, "labels": made.labels}


def membrane() -> Found:
    """A plain fit."""
    return fitted(plain())


def psf_and_density() -> Found:
    """With the PSF and a smooth density."""
    return fitted(plain(), fit_psf=True, density="smooth")


def fitted_effects() -> Found:
    """With effects of three kinds."""
    text = "attenuation,background,halo"
    return fitted(plain(effects="attenuation=0.1,halo=0.1:width=0.6"), effects=text)


def cluster() -> Found:
    """Two cells that share a wall, densities of walls; wide levels."""
    start = foam(np.array([MIDDLE - 0.8 * SIDE, MIDDLE + SIDE]), np.array([1.1, 1.0]), 0.45)
    levels = (3.0, 1.6, 1.0)
    return fitted(plain(PAIR), start, density="interface", levels=levels, max_iterations=60)


def paper() -> Found:
    """As in the paper."""
    return fitted(plain(), as_in_the_paper=True, fit_psf=True)


def resumed() -> Found:
    """Two cells, gone on from a checkpoint."""
    start = foam(np.array([MIDDLE - 0.8 * SIDE, MIDDLE + SIDE]), np.array([1.1, 1.0]), 0.45)
    image = plain(PAIR)
    settings = SHORT.model_copy(update={"fit_psf": True, "density": "smooth"})
    given = image, GRID, start, OPTICS
    with tempfile.TemporaryDirectory() as folder:
        for state in fit(*given, settings=settings):
            if state.iteration == 9:
                state.save(Path(folder) / "kept")
                break
        *_, end = fit(*given, settings=settings, resume=Path(folder) / "kept")
    return numbers(end)


def second_view() -> Found:
    """Two images of one scene."""
    effects = Effects.from_text("second_view:sigma=[0.26,0.3,0.3]")
    given = plain(), GRID, START, OPTICS
    other = photons(Scene((Surface(BALL),), GaussianPSF((0.26, 0.3, 0.3))), seed=5)
    *_, state = fit(*given, settings=SHORT, effects=effects, second=other)
    return numbers(state)


def evidence() -> Found:
    """Which effects an image calls for, and what is left."""
    image = plain(effects="attenuation=0.15,halo=0.15:width=0.8")
    state = last(image, max_iterations=60)
    told = recommend(image, GRID, START, OPTICS, SHORT, fitted=state)
    rows = sorted(told.evidence, key=lambda e: e.name)
    found = {e.name: np.array([e.score, e.bias_nm, e.recommended]) for e in rows}
    values = [v.value for e in told.effects.present() for v in e.values()]
    left = analyse_residual(image, GRID, state)
    cells = [[c.region, np.nan if c.explained is None else c.explained, c.z] for c in left.cells]
    return {**found, "numbers": np.array(values), "map": left.map, "cells": np.array(cells)}


def series() -> Found:
    """Two cells over three frames."""
    frames = [plain(PAIR.translated((0, 0.06 * t, 0))) for t in range(3)]
    settings = FitSettings(levels=(1.0,), max_iterations=20)
    states = track(frames, GRID, PAIR, OPTICS, settings)
    done = [state.done for state in states if state.done is not None]
    found = {}
    for t, frame in enumerate(done):
        if frame.mesh is not None:
            found[f"frame {t}"] = frame.mesh.vertices_numpy()
    return found


def measurements() -> Found:
    """Tables of two cells."""
    found = {}
    for table in measure(PAIR).tables:
        for column in table.columns:
            values = table.values(column.name)
            if not any(isinstance(v, str) for v in values):
                found[f"{table.name}.{column.name}"] = np.array(values, float)  # None: NaN
    return found


CASES: dict[str, Callable[[], Found]] = {
    case.__name__: case
    for case in (
        images,
        effects_on_images,
        structures,
        simulation,
        membrane,
        psf_and_density,
        fitted_effects,
        cluster,
        paper,
        resumed,
        second_view,
        evidence,
        series,
        measurements,
    )
}


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference relative to the largest number; infinite where shapes differ."""
    if one.shape != other.shape or (np.isnan(one) != np.isnan(other)).any():
        return np.inf
    a, b = np.nan_to_num(one.astype(float)), np.nan_to_num(other.astype(float))
    if not a.size:
        return 0.0
    return float(np.abs(a - b).max() / max(np.abs(a).max(), 1e-300)) if (a != b).any() else 0.0


def compare(case: str, kept: Found, now: Found) -> list[str]:
    """What of a case has changed, a line each."""
    lines = [f"{case}: {name} is no longer there" for name in sorted(set(kept) - set(now))]
    lines += [f"{case}: {name} is new" for name in sorted(set(now) - set(kept))]
    for name in sorted(set(kept) & set(now)):
        off = difference(kept[name], now[name])
        if not off <= SAME:
            lines.append(f"{case}: {name} is another by {off:.2g}")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """1 where something has changed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden", description=__doc__)
    parser.add_argument("what", choices=("write", "compare"), nargs="?")
    parser.add_argument("file", type=Path, nargs="?")
    parser.add_argument("--only", nargs="+", choices=sorted(CASES), default=list(CASES))
    parser.add_argument("--list", action="store_true")
    chosen = parser.parse_args(arguments)
    if chosen.list or chosen.file is None:
        print("\n".join(f"{name}: {case.__doc__}" for name, case in CASES.items()))
        return 0
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    found = {name: CASES[name]() for name in chosen.only}
    if chosen.what == "write":
        flat = {f"{case}/{name}": values for case in found for name, values in found[case].items()}
        np.savez_compressed(chosen.file, **flat)  # type: ignore[arg-type]
        return 0
    with np.load(chosen.file) as held:
        kept: dict[str, Found] = {case: {} for case in found}
        for key in held.files:
            case, _, name = key.partition("/")
            if case in kept:
                kept[case][name] = held[key]
    lines = [line for case in found for line in compare(case, kept[case], found[case])]
    print("\n".join(lines) or f"{len(found)} cases are the same")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
