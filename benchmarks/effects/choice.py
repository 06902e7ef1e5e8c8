"""Does the software see which effects a scene calls for? Simulated scenes, and real stacks.

``python -m benchmarks.effects.choice --scenes 200 --results build/effects.jsonl`` simulates scenes
with effects drawn at random, asks for recommendations, and fits with no effects, with those
recommended, with the true ones and with all. Each scene is a line of the results, so a run that was
broken off goes on where it was. ``--real`` makes the table for real stacks.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from napari_deltamic import FitState, GaussianPSF, Grid, Mesh, fit
from napari_deltamic.evidence import recommend
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import NEAR_LEVELS, FitSettings
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.effects import (
    Attenuation,
    Background,
    Bleaching,
    DepthPSF,
    Effect,
    Effects,
    Halo,
    Illumination,
    PixelIntegration,
)
from napari_deltamic.scene.light import Light

from ..figure import Row, at_least, at_most, default_data_folder

SHAPE, VOXEL = (32, 48, 48), (0.3, 0.2, 0.2)
SIGMA = (0.42, 0.25, 0.25)
PEAK, BACKGROUND = 40.0, 5.0
MATTERS = 0.05  # voxels: effects that move the shape by more must be found
# Two that pass for each other are drawn, and counted, as one.
GROUPS = {"attenuation": "fading", "bleaching": "fading"}
_SAMPLES = 5000


@dataclass(frozen=True)
class Simulated:
    """A scene, its image and what is true of it."""

    seed: int
    kind: str
    grid: Grid
    optics: GaussianPSF
    truth: Mesh
    start: Mesh
    effects: Effects
    fit_psf: bool
    image: np.ndarray


def simulated(seed: int) -> Simulated:
    """The scene of a seed."""
    rng = np.random.default_rng(seed)
    grid = Grid(SHAPE, VOXEL)
    kind = ("sphere", "ellipsoid", "bumpy cell", "two cells")[seed % 4]
    truth, start = _cells(kind, grid, rng)
    optics = GaussianPSF(tuple(s * rng.uniform(0.9, 1.15) for s in SIGMA))
    effects = drawn_effects(rng)
    fit_psf = bool(rng.random() < 0.5)
    plain = expected_image(truth, grid, optics, 1e-4, 1.0, 0.0)
    amplitude = PEAK / float(np.percentile(plain, 99.7))
    given = truth, grid, optics, 1e-4, amplitude, BACKGROUND
    expected = expected_image(*given, effects=effects, light=drawn_light(rng))
    image = rng.poisson(expected.clip(0)).astype(np.float32)
    return Simulated(seed, kind, grid, optics, truth, start, effects, fit_psf, image)


def drawn_effects(rng: np.random.Generator) -> Effects:
    """Each effect in half of the scenes, weak to strong."""

    def even(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def sign() -> float:
        return float(rng.choice([-1.0, 1.0]))

    slope = rng.normal(size=3)
    bend = rng.normal(size=5)
    fading = (
        Attenuation(per_um=sign() * even(0.01, 0.1)),
        Bleaching(per_slice=sign() * even(0.003, 0.03)),
    )[int(rng.integers(2))]
    slope, bend = (v / np.linalg.norm(v) for v in (slope, bend))
    drawn: list[Effect] = [
        PixelIntegration(),
        Background(coefficients=tuple(even(0.3, 3.0) * slope)),
        fading,
        Illumination(coefficients=tuple(even(0.03, 0.4) * bend)),
        Halo(fraction=even(0.02, 0.3), width=even(0.6, 1.6)),
        DepthPSF(variance_z=sign() * even(0.02, 0.3), variance_yx=sign() * even(0.005, 0.06)),
    ]
    return Effects.of(*(e for e in drawn if rng.random() < 0.5))


def drawn_light(rng: np.random.Generator) -> Light:
    """In half of the scenes insides shine, too: what a fit finds without being told."""
    inside = float(np.exp(rng.uniform(np.log(0.01), np.log(0.3))))
    return Light(1.0, inside if rng.random() < 0.5 else 0.0)


def _cells(kind: str, grid: Grid, rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """The true surfaces, and coarser ones a tenth smaller to start from."""
    middle = (np.asarray(grid.shape) - 1) / 2 * np.asarray(grid.voxel_size)
    middle = middle + rng.uniform(-0.1, 0.1, 3)
    if kind == "two cells":
        apart = np.array([0.0, 0.0, 2.25])
        radii = [(2.5, 2.6, 1.75) * rng.uniform(0.92, 1.05, 3) for _ in range(2)]
        bodies = [(middle - apart, radii[0], None), (middle + apart, radii[1], None)]
    else:
        radius = np.full(3, 2.7)
        if kind != "sphere":
            radius = (2.6, 2.8, 2.9) * rng.uniform(0.85, 1.1, 3)
        bumps = rng.normal(size=(6, 3)) if kind == "bumpy cell" else None
        bodies = [(middle, radius, bumps)]
    whole = [_body(*b, edge_length=0.15, scale=1.0) for b in bodies]
    coarse = [_body(*b, edge_length=0.45, scale=0.9) for b in bodies]
    return Mesh.merge(whole), Mesh.merge(coarse)


def _body(
    middle: np.ndarray,
    radii: np.ndarray,
    bumps: np.ndarray | None,
    *,
    edge_length: float,
    scale: float,
) -> Mesh:
    ball = sphere((0, 0, 0), 1.0, edge_length=edge_length / float(np.mean(radii)))
    unit = ball.vertices_numpy()
    size = np.ones(len(unit))
    if bumps is not None:
        for direction in bumps:
            along = unit @ (direction / np.linalg.norm(direction))
            size += 0.12 * np.exp(-(1 - along) / 0.25) - 0.02
    return ball.with_vertices(middle + scale * unit * radii * size[:, None])


def measured(seed: int) -> dict[str, Any]:
    """Everything about one scene, as plain values."""
    began = time.perf_counter()
    scene = simulated(seed)
    settings = FitSettings(fit_psf=scene.fit_psf, levels=NEAR_LEVELS)
    plain = _fitted(scene, Effects(), settings)
    at = time.perf_counter()
    found = recommend(scene.image, scene.grid, plain.mesh, scene.optics, settings, fitted=plain)
    seconds = time.perf_counter() - at
    everything = _everything(scene.effects, found.effects)
    sets = {"none": Effects(), "true": scene.effects, "all": everything}
    sets["recommended"] = found.effects
    fits = {k: plain if k == "none" else _fitted(scene, e, settings) for k, e in sets.items()}
    return {
        "seed": seed,
        "kind": scene.kind,
        "fit_psf": scene.fit_psf,
        "true": scene.effects.to_dict(),
        "bias": _biases(scene, settings),
        "recommended": list(found.recommended),
        "evidence": [
            [e.name, round(e.score, 2), round(e.bias_voxels, 4), round(e.cost_ms, 2)]
            for e in found.evidence
        ],
        "error": {name: _error(scene, state) for name, state in fits.items()},
        "seconds": round(seconds, 2),
        "seconds_all": round(time.perf_counter() - began, 2),
    }


def _everything(true: Effects, found: Effects) -> Effects:
    """All effects: those there as they are, the others with their defaults."""
    names = ["pixel_integration", "background", "illumination", "halo", "depth_psf"]
    fading = [n for n in (*true.names, *found.names) if n in GROUPS] or ["attenuation"]
    chosen: list[Effect | str] = []
    for name in [*names, fading[0]]:
        held = getattr(true, name)
        chosen.append(name if held is None else held)
    return Effects.of(*chosen)


def _fitted(scene: Simulated, effects: Effects, settings: FitSettings) -> FitState:
    *_, last = fit(
        scene.image, scene.grid, scene.start, scene.optics, settings=settings, effects=effects
    )
    return last


def _error(scene: Simulated, state: FitState) -> float:
    """Voxels: mean distance of the surfaces."""
    return round(surface_distance(state.mesh, scene.truth, _SAMPLES).mean / min(VOXEL), 5)


def _biases(scene: Simulated, settings: FitSettings) -> dict[str, float]:
    """Voxels, root mean square: how far the surface moves where one true effect is left out.

    Fits to the image without noise, all by the same triangles, each going on from the fit with all
    true effects, so that nothing else tells them apart.
    """
    image = _without_noise(scene)
    held = {"remesh": False, "smoothing": 4.0, "levels": (1.0,), "max_iterations": 90}
    near = settings.model_copy(update=held)
    given = image, scene.grid
    *_, first = fit(*given, scene.start, scene.optics, settings=settings, effects=scene.effects)
    *_, base = fit(*given, first.mesh, first.optics, settings=near, effects=first.effects)
    found = {}
    for name in scene.effects.names:
        rest = base.effects.without(name)
        *_, other = fit(*given, base.mesh, base.optics, settings=near, effects=rest)
        apart = other.mesh.vertices_numpy() - base.mesh.vertices_numpy()
        along = np.einsum("fd,fd->f", apart[base.mesh.faces].mean(1), base.mesh.normals())
        rms = float(np.sqrt(np.average(along**2, weights=base.mesh.areas())))
        found[name] = round(rms / min(VOXEL), 5)
    return found


def _without_noise(scene: Simulated) -> np.ndarray:
    plain = expected_image(scene.truth, scene.grid, scene.optics, 1e-4, 1.0, 0.0)
    amplitude = PEAK / float(np.percentile(plain, 99.7))
    return expected_image(
        scene.truth, scene.grid, scene.optics, 1e-4, amplitude, BACKGROUND, effects=scene.effects
    )


# ------------------------------------------------------------------------------------- figures


def grouped(names: Iterable[str]) -> set[str]:
    return {GROUPS.get(n, n) for n in names}


_CHOICES = {"none": "no", "recommended": "recommended", "true": "true", "all": "all"}


def rows(scenes: Sequence[dict[str, Any]]) -> list[Row]:
    """The figures of the scenes measured."""
    matter = found = absent = alarms = 0
    for s in scenes:
        true, told = grouped(s["true"]), grouped(s["recommended"])
        every = grouped(e[0] for e in s["evidence"])
        heavy = grouped(n for n, b in s["bias"].items() if b > MATTERS)
        matter += len(heavy)
        found += len(heavy & told)
        absent += len(every - true)
        alarms += len(told - true)
    error = {k: float(np.mean([s["error"][k] for s in scenes])) for k in scenes[0]["error"]}
    note = f"{len(scenes)} scenes"
    return [
        at_least(
            f"effects that move the shape by more than {MATTERS:g} voxel: found",
            95,
            100 * found / max(matter, 1),
            "%",
            f"{found} of {matter}; {note}",
        ),
        at_most("false alarms", 3, 100 * alarms / max(absent, 1), "%", f"{alarms} of {absent}"),
        at_most(
            "shape error, recommended over true effects",
            1.1,
            error["recommended"] / error["true"],
            "",
            "means of the scenes",
        ),
        *(
            Row(f"shape error with {said} effects", "", error[name], "voxel", None)
            for name, said in _CHOICES.items()
        ),
        Row("time of a recommendation", "", _median(scenes, "seconds"), "s", None),
    ]


def by_effect(scenes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each effect: in how many scenes it was, mattered, was found, was a false alarm."""
    names = sorted({GROUPS.get(e[0], e[0]) for s in scenes for e in s["evidence"]})
    table = []
    for name in names:
        has = [s for s in scenes if name in grouped(s["true"])]
        heavy = [s for s in has if name in grouped(n for n, b in s["bias"].items() if b > MATTERS)]
        told = [s for s in scenes if name in grouped(s["recommended"])]
        table.append(
            {
                "effect": name,
                "present": len(has),
                "matters": len(heavy),
                "found": sum(s in told for s in heavy),
                "false alarms": sum(s not in has for s in told),
                "recommended": len(told),
            }
        )
    return table


def _median(scenes: Sequence[dict[str, Any]], name: str) -> float:
    return float(np.median([s[name] for s in scenes]))


def run(count: int, results: Path, processes: int, first: int = 0) -> list[dict[str, Any]]:
    """Measure the scenes that are not in the results yet; all of them, in order."""
    done = {s["seed"]: s for s in _read(results)}
    todo = [seed for seed in range(first, first + count) if seed not in done]
    results.parent.mkdir(parents=True, exist_ok=True)
    # Before torch is loaded in the workers: each has one core.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    context = multiprocessing.get_context("spawn")
    with context.Pool(processes) as pool, results.open("a", encoding="utf-8") as out:
        for number, scene in enumerate(pool.imap_unordered(measured, todo), 1):
            done[scene["seed"]] = scene
            out.write(json.dumps(scene) + "\n")
            out.flush()
            print(f"{number}/{len(todo)} seed {scene['seed']}", file=sys.stderr, flush=True)
    return [done[s] for s in sorted(done) if first <= s < first + count]


def _read(results: Path) -> list[dict[str, Any]]:
    if not results.is_file():
        return []
    lines = results.read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines if line.strip()]


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    name = "python -m benchmarks.effects.choice"
    parser = argparse.ArgumentParser(prog=name, description=__doc__)
    parser.add_argument("--scenes", type=int, default=200, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--results", type=Path, default=Path("build/effects_choice.jsonl"))
    parser.add_argument("--real", action="store_true", help="the table for real stacks instead")
    parser.add_argument("--only", default="", metavar="NAME", help="of the real stacks")
    parser.add_argument("--data", type=Path, default=default_data_folder())
    chosen = parser.parse_args(argv)
    from ..__main__ import as_table

    if chosen.real:
        from .real import real_table

        print(real_table(chosen.data, chosen.only))
        return 0
    scenes = run(chosen.scenes, chosen.results, chosen.processes, chosen.first)
    figures = rows(scenes)
    print(as_table(figures))
    for line in by_effect(scenes):
        print("  ".join(f"{k} {v}" for k, v in line.items()))
    return 1 if any(row.passed is False for row in figures) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
